"""Measurements behind two thresholds of a diagnosis: ``python -m tests.diagnose.calibration``.

`CONFIDENCE_FACTOR_UNEXPLAINED`: a listed effect and one that the catalogue lacks are hidden in two flights.
The share of true names among those that an unexplained diagnosis gives is the factor.

`RANDOM_TORQUE_MIN_CORRELATION_s`: an axis has a random torque, or a dry friction that the catalogue lacks.
The table shows the estimated correlation time of the axis' disturbance.

All flights are simulated here from development seeds, which judge nothing. Results are appended to a file,
and a run continues where the last one stopped.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypeVar

from tests.running.alone import one_thread_each

ROOT: Final = Path(__file__).resolve().parents[2]
DURATIONS_s: Final = (18.0, 14.0)
LISTED: Final = ("coulomb_friction.elevation=0.03", "supply_sag=0.02", "cable_spring.elevation=0.05")
LACKING: Final = (
    "rotor_lag=0.08",
    "cable_spring.travel=0.04",
    "thrust_asymmetry=0.05",
    "travel_drag_quadratic=0.07",
    "gyroscopic_torque=0.03",
    "axis_tilt=0.03",
    "coulomb_friction.travel=0.02",
    "backlash.elevation=0.01",
    "encoder_eccentricity.travel=0.02",
    "periodic_torque.elevation=0.05",
    "inflow_damping=0.1",
)
RANDOM: Final = {"elevation": 0.03, "pitch": 0.005, "travel": 0.02}
"""Typical random torque about each axis, N m."""
FRICTION_Nm: Final = {"elevation": 0.03, "pitch": 0.01, "travel": 0.02}
"""Typical dry friction about each axis."""


_Key = TypeVar("_Key", str, int)


@dataclass(frozen=True)
class Case:
    """Two flights in which effects are hidden."""

    # `hidden`: Values of each hidden effect's parameters, by id.
    # `removed`: Effect that is removed from the catalogue; empty for none.
    # `seed`: Seed of the first flight.
    # `axis`: Axis of the correlation time; empty for none.

    hidden: Mapping[str, Mapping[str, float]]
    removed: str
    seed: int
    axis: str = ""


def cases() -> dict[str, Case]:
    """Return all cases by name; each is a development case."""
    return {**_pairs_with_a_lacking_effect(), **_cases_of_correlation_times()}


def _pairs_with_a_lacking_effect() -> dict[str, Case]:
    """Return cases with an effect that the catalogue lacks, each together with two listed effects in turn."""
    named = {}
    for number, lacking in enumerate(LACKING):
        for listed_number in (number % len(LISTED), (number + 1) % len(LISTED)):
            listed = LISTED[listed_number]
            hidden = dict(_sized(effect) for effect in (listed, lacking))
            seed = 6000 + 10 * number + listed_number
            named[f"{listed} & {lacking}"] = Case(hidden, lacking.partition("=")[0], seed)
    return named


def _cases_of_correlation_times() -> dict[str, Case]:
    """Return cases with a random torque, or with dry friction that the catalogue lacks, about each axis."""
    named = {}
    for number, axis in enumerate(RANDOM):
        torque, friction = f"random_torque.{axis}", f"coulomb_friction.{axis}"
        first_seed = 6200 + 4 * number
        for seed, correlation_s in enumerate((0.1, 0.5), first_seed):
            sizes = {f"random_torque_{axis}_Nm": RANDOM[axis], f"random_torque_{axis}_s": correlation_s}
            named[f"{torque} {correlation_s:g} s"] = Case({torque: sizes}, "", seed, axis)
        for seed, factor in enumerate((1.0, 2.0), first_seed + 2):
            size = {f"coulomb_friction_{axis}_Nm": factor * FRICTION_Nm[axis]}
            named[f"{friction} {factor:g}"] = Case({friction: size}, friction, seed, axis)
    return named


def _sized(effect: str) -> tuple[str, dict[str, float]]:
    """Return the id of an effect such as ``axis_tilt=0.03``, and its first parameter by full name."""
    from heli_sim.model.effects import catalogue

    id_, _, value = effect.partition("=")
    spec = catalogue()[id_]
    return id_, {spec.full(spec.numbers[0].name): float(value)}


def diagnosed(case: Case) -> dict[str, Any]:
    """Simulate and diagnose a case: the verdict, the named causes, the correlation time of its axis."""
    from heli_lab.diagnose import diagnose, to_json
    from heli_sim.model import MultibodyModel
    from heli_sim.model.effects import catalogue
    from heli_sim.rig import load_rig

    from tests.identify.made import flown, thinned

    nominal, kinds = load_rig("makki2024"), dict(catalogue())
    rig = nominal.replace(thrust_gain=0.62, friction_travel=0.05)
    model = MultibodyModel(
        tuple(kinds[id_].make({**kinds[id_].typical, **sizes}) for id_, sizes in case.hidden.items())
    )
    flights = [
        thinned(flown(rig, case.seed + 500 * number, duration_s, model), 2)
        for number, duration_s in enumerate(DURATIONS_s)
    ]
    kinds.pop(case.removed, None)
    result = to_json(diagnose(MultibodyModel(), nominal, flights[:1], flights[1:], kinds=kinds))
    axis = result["disturbances"].get(case.axis, {})
    return {
        "verdict": result["verdict"],
        "causes": [cause["effect"] for cause in result["causes"]],
        "correlation_time_s": axis.get("correlation_time_s"),
    }


def names_in_unexplained(rows: Mapping[str, Mapping[str, Any]]) -> tuple[int, int]:
    """Count true names, and all names, that unexplained diagnoses give."""
    known, right, every = cases(), 0, 0
    for name, row in rows.items():
        if row["verdict"] == "unexplained":
            right += sum(cause in known[name].hidden for cause in row["causes"])
            every += len(row["causes"])
    return right, every


def kept_rows(
    path: Path, keys: Iterable[_Key], measured: Callable[[_Key], dict[str, Any]]
) -> Iterator[tuple[_Key, dict[str, Any]]]:
    """Yield each key with its row; rows in the file at `path` are not measured again, others are appended."""
    lines = path.read_text().splitlines() if path.exists() else []
    known = dict(json.loads(line) for line in lines)
    with path.open("a") as file:
        for key in keys:
            row = known.get(key) or measured(key)
            if key not in known:
                print(json.dumps([key, row]), file=file, flush=True)
            yield key, row


def measure(path: Path, names: Sequence[str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the row of each case; those in the file at `path` are not measured again."""
    return kept_rows(path, names, lambda name: diagnosed(cases()[name]))


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="cases; all if none is given")
    parser.add_argument("--output", "-o", type=Path, default=ROOT / "build" / "calibration.jsonl")
    chosen = parser.parse_args(arguments)
    if unknown := set(chosen.names) - set(cases()):
        parser.error(f"no case is called {', '.join(sorted(unknown))}")
    one_thread_each()
    chosen.output.parent.mkdir(parents=True, exist_ok=True)
    rows = {}
    for name, row in measure(chosen.output, chosen.names or list(cases())):
        rows[name] = row
        time_s = row["correlation_time_s"]
        correlation = "" if time_s is None else f"  correlation time {time_s:.3f} s"
        print(f"{name:58} {row['verdict']:12} {', '.join(row['causes'])}{correlation}", flush=True)
    right, every = names_in_unexplained(rows)
    print(f"names in unexplained diagnoses: {right} of {every} are true")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
