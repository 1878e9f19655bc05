"""Measures how often causes of a given confidence are right: ``python -m tests.diagnose.confidence``.

Each seed gives a rig within its tolerances, random torques about all axes, and two flights of 18 s and 14 s.
One or two effects of random size are hidden, or an effect that the catalogue lacks, or an event that happens
in the first flight only. Without a hidden effect, hardly any cause is named. Each seed is diagnosed with the
second flight held out, and from the first flight alone; with ``--reverse`` also with the first held out.

The limits for causes that are not confirmed, in `heli_lab.explain.thresholds`, come from `DEVELOPMENT` and
`FRESH`; the seeds `JUDGING` judge them. Results are appended to a file, and a run continues where the
last one stopped.
"""

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final
from unittest.mock import patch

import numpy as np
from heli_benchmark.effects.disturbances import STRENGTHS_Nm
from heli_benchmark.goals import BINS
from heli_benchmark.task import PARTS

from tests.diagnose.calibration import LACKING, DURATIONS_s, kept_rows
from tests.running.alone import one_thread_each

ROOT: Final = Path(__file__).resolve().parents[2]
KINDS: Final = ("event", "one", "lacking", "two", "lacking and one")
LISTED: Final = (
    "rotor_lag",
    "input_delay",
    "thrust_asymmetry",
    "supply_sag",
    "inflow_damping",
    "coulomb_friction.elevation",
    "coulomb_friction.travel",
    "cable_spring.elevation",
    "cable_spring.travel",
    "travel_drag_quadratic",
    "gyroscopic_torque",
    "rotor_reaction_torque",
    "backlash.pitch",
    "edgewise_flow",
    "zero_offset.pitch",
    "supply_fade",
)
UNLISTED: Final = tuple(effect.partition("=")[0] for effect in LACKING if "rotor_lag" not in effect)
"""Effects of which the catalogue may lack one: those of the calibration, without the rotors' lag."""
EVENTS: Final = ("thrust_step.front", "thrust_step.back", "counterweight_shift")
CORRELATION_TIMES_s: Final = (0.3, 0.6, 1.2, 5.0)
SIZES: Final = (0.7, 3.0)
"""Range of the factor on the typical size, drawn log-uniformly: smaller effects are not named."""
DEVELOPMENT: Final = (9300, 9301, 9302, 9304, 9305, 9307, 9309, 9310, 9312, 9314, 9315)
"""Seeds of the calibration, the first three with ``--reverse``."""
FRESH: Final = range(9600, 9635)
"""Seeds that were added to the calibration with a later version of the search."""
JUDGING: Final = range(9400, 9500)


@dataclass(frozen=True)
class Case:
    """Two flights in which effects are hidden."""

    # `seed`: Seed of rig, effects and flights.
    # `kind`: One of `KINDS`.
    # `hidden`: Values of each hidden effect's parameters, by id.
    # `removed`: Effect that the catalogue lacks; empty for none.
    # `disturbances`: The same of the random torques.

    seed: int
    kind: str
    hidden: Mapping[str, Mapping[str, float]]
    removed: str
    disturbances: Mapping[str, Mapping[str, float]]


def case(seed: int) -> Case:
    """Draw the case of a `seed`."""
    from heli_sim.model.effect import AXES
    from heli_sim.model.effects import catalogue

    kinds, rng, kind = catalogue(), np.random.default_rng([seed, 20]), KINDS[seed % len(KINDS)]
    strength, time_s = STRENGTHS_Nm[int(rng.integers(3))], float(rng.choice(CORRELATION_TIMES_s))
    removed = str(rng.choice(UNLISTED)) if "lacking" in kind else ""
    others = [name for name in LISTED if name != removed]
    count = 2 if kind == "two" else int(kind in ("one", "lacking and one"))
    names = [str(name) for name in rng.choice(others, count, replace=False)]
    if removed:
        names.append(removed)
    if kind == "event":
        names.append(str(rng.choice(EVENTS)))

    def sized(name: str) -> dict[str, float]:
        """Draw the parameters of an effect: its size, and the moment of an event."""
        low, high = np.log(SIZES)
        factor = float(np.exp(rng.uniform(low, high)))
        spec = kinds[name]
        values = {**spec.typical, **{size: factor * spec.typical[size] for size in spec.size}}
        return values | {key: float(rng.uniform(8.0, 12.0)) for key in values if key.endswith("_at_s")}

    torques = {
        f"random_torque.{axis}": {f"random_torque_{axis}_Nm": size, f"random_torque_{axis}_s": time_s}
        for axis, size in zip(AXES, strength, strict=True)
    }
    return Case(seed, kind, {name: sized(name) for name in names}, removed, torques)


def diagnosed(drawn: Case, reverse: bool) -> dict[str, Any]:
    """Simulate a case and diagnose it: by direction, the verdict and the causes with their evidence."""
    from heli_lab.explain import diagnose, run
    from heli_sim.model import MultibodyModel
    from heli_sim.model.effects import catalogue
    from heli_sim.rig import load_rig

    from tests.identify.made import flown, perturbed, thinned

    kinds, rig = dict(catalogue()), perturbed(drawn.seed)

    def model(flight: int) -> MultibodyModel:
        """Return the model that flies; an event happens in the first flight only."""
        hidden = {} if drawn.kind == "event" and flight else drawn.hidden
        return MultibodyModel(
            tuple(
                kinds[id_].make({**kinds[id_].typical, **sizes})
                for id_, sizes in {**hidden, **drawn.disturbances}.items()
            )
        )

    first, second = (
        thinned(flown(rig, 2 * drawn.seed + i, duration_s, model(i)), 4)
        for i, duration_s in enumerate(DURATIONS_s)
    )
    offered = {id_: kind for id_, kind in kinds.items() if id_ != drawn.removed}
    roles = {"forward": ([first], [second]), "alone": ([first], [])}
    if reverse:
        roles["reverse"] = ([second], [first])
    results = {}
    # Equation and next flight take three quarters of the time, and do not enter the confidence of a cause.
    with (
        patch.object(run, "propose_experiment", return_value=None),
        patch.object(run, "_propose_equation", return_value=None),
    ):
        for role, flights in roles.items():
            result = diagnose(MultibodyModel(), load_rig("makki2024"), *flights, kinds=offered, refits=80)
            before = {cause.effect: cause.confidence for cause in result.assessment.verdict.causes}
            results[role] = [
                {
                    "effect": cause.effect,
                    "ambiguous_with": cause.ambiguous_with,
                    "verdict": result.label,
                    "confirmed": cause.effect not in result.replication.unconfirmed,
                    "why_not": result.replication.causes[cause.effect].why_not,
                    "if_confirmed": before[cause.effect],
                    "confidence": cause.confidence,
                }
                for cause in result.verdict.causes
            ]
    return results


def is_right(drawn: Case, effect: str, ambiguous_with: Sequence[str]) -> bool:
    """Whether a named cause is hidden, or is one of two of which one is hidden."""
    parts = PARTS.get(effect, ())
    named_effects = {effect, *ambiguous_with}
    return (
        effect in drawn.hidden
        or bool(parts and {*parts} <= {*drawn.hidden})
        or (len(named_effects) == 2 and bool(named_effects & {*drawn.hidden}))
    )


def table(answers: Sequence[tuple[float, bool]]) -> Iterator[str]:
    """Compare confidences with the share that is right, bin by bin, with its 95 % interval (Clopper and
    Pearson).
    """
    from scipy.stats import binomtest

    for low, high in pairwise(BINS):
        inside = [(sure, right) for sure, right in answers if low <= sure < high]
        if inside:
            right = sum(right for _, right in inside)
            interval = binomtest(right, len(inside)).proportion_ci(0.95, method="exact")
            yield (
                f"{low:.2f} to {high:.2f}: mean {np.mean([sure for sure, _ in inside]):.2f}, "
                f"{right} of {len(inside)} right, {right / len(inside):.2f} "
                f"({interval.low:.2f} to {interval.high:.2f})"
            )


def measure(path: Path, seeds: Sequence[int], reverse: bool) -> Iterator[tuple[Case, dict[str, Any]]]:
    """Yield each case and its results; those in the file at `path` are not measured again."""
    for seed, results in kept_rows(path, seeds, lambda seed: diagnosed(case(seed), reverse)):
        yield case(seed), results


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "seeds", nargs="*", type=int, help="seeds of the cases; those of development if none is given"
    )
    parser.add_argument("--reverse", action="store_true", help="also exchange the two flights")
    parser.add_argument("--output", "-o", type=Path, default=ROOT / "build" / "confidence.jsonl")
    chosen = parser.parse_args(arguments)
    one_thread_each()
    chosen.output.parent.mkdir(parents=True, exist_ok=True)
    # Confidence of each cause, and whether the cause is right.
    by_confirmation: dict[bool, list[tuple[float, bool]]] = {True: [], False: []}
    if_confirmed: list[tuple[float, bool]] = []
    for drawn, results in measure(chosen.output, chosen.seeds or list(DEVELOPMENT), chosen.reverse):
        for role, causes in results.items():
            for cause in causes:
                right = is_right(drawn, cause["effect"], cause["ambiguous_with"])
                by_confirmation[cause["confirmed"]].append((cause["confidence"], right))
                if not cause["confirmed"]:
                    if_confirmed.append((cause["if_confirmed"], right))
                print(
                    f"{drawn.seed} {drawn.kind:15} {role:8} {cause['effect']:28} {cause['confidence']:.3f} "
                    f"{'right' if right else 'wrong'}  {cause['why_not'] or 'confirmed'}",
                    flush=True,
                )
    for confirmed, answers in by_confirmation.items():
        print("confirmed" if confirmed else "not confirmed")
        print(*table(answers), sep="\n")
    print("not confirmed, by the confidence with confirmation")
    print(*table(if_confirmed), sep="\n")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
