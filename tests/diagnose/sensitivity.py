"""How much the thresholds of a diagnosis matter: ``python -m tests.diagnose.sensitivity [NAME...]``.

Each constant whose source is judgement is set to half and to double, one at a time, and the diagnosis of a
fixed development set is repeated. The table shows on how many flights the verdict or the named causes change.
The development set is simulated here, and judges nothing: effects alone, two together, one that no catalogue
has, and none; some under disturbances.

Results are appended to a file, and a run continues where the last one stopped.
"""

import argparse
import importlib.util
import json
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from tests.running.alone import one_thread_each

ROOT: Final = Path(__file__).resolve().parents[2]
MODULE: Final = "heli_lab.explain.thresholds"
FACTORS: Final = (0.5, 2.0)
SMALL_s: Final = (18.0, 14.0)
WHOLE_s: Final = (34.0, 26.0)


@dataclass(frozen=True)
class Case:
    """A pair of flights in which something is hidden."""

    # `effects`: As ``--effect`` has them.
    # `durations_s`: Flight to fit, held-out flight.
    # `is_unlisted`: Whether a torque that no catalogue has is hidden too.

    effects: tuple[str, ...]
    durations_s: tuple[float, float] = SMALL_s
    is_unlisted: bool = False


DISTURBANCES: Final = (
    "random_torque.elevation=0.012",
    "random_torque.pitch=0.004",
    "random_torque.travel=0.008",
)
CASES: Final = {
    "nothing": Case(()),
    "small lag": Case(("rotor_lag=0.02",)),
    "small delay": Case(("input_delay=0.006",)),
    "small cable": Case(("cable_spring.travel=0.002",)),
    "lag and cable": Case(("rotor_lag=0.04", "cable_spring.travel=0.02")),
    "dry friction": Case(("coulomb_friction.travel=0.003",)),
    "unlisted": Case((), is_unlisted=True),
    "disturbances": Case(DISTURBANCES, WHOLE_s),
    "disturbances and lag": Case((*DISTURBANCES, "rotor_lag=0.04"), WHOLE_s),
    "disturbances and cable": Case((*DISTURBANCES, "cable_spring.travel=0.03"), WHOLE_s),
    "random torque": Case(("random_torque.travel=0.02",), WHOLE_s),
}
"""Effects with sizes close to the detection limit, because thresholds do not change clear cases."""


def scaled(value: Any, factor: float) -> Any:
    """Return half or double of a constant, as the constant's type allows.

    An integer stays an integer of at least 1, and a share of at most 1 stays one. A range (a pair about 1)
    becomes narrower or wider.

    >>> scaled(3, 0.5), scaled(3, 2.0), scaled(0.8, 2.0), scaled((0.2, 5.0), 2.0)
    (1, 6, 1.0, (0.1, 10.0))
    """
    if isinstance(value, tuple):
        low, high = value
        return (low / factor, high * factor)
    if isinstance(value, int):
        return max(1, int(value * factor))
    return min(value * factor, 1.0) if 0.0 < value <= 1.0 else value * factor


def load_thresholds(changed: dict[str, float]) -> Any:
    """Load the module of thresholds with some constants scaled, before the diagnosis imports it."""
    if MODULE in sys.modules:
        raise RuntimeError("the thresholds are loaded already; change them in a process of their own")
    path = ROOT / "sim" / Path(*MODULE.split(".")).with_suffix(".py")
    spec = importlib.util.spec_from_file_location(MODULE, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[MODULE] = module
    spec.loader.exec_module(module)
    for name, factor in changed.items():
        setattr(module, name, scaled(getattr(module, name), factor))
    return module


def verdicts(cases: dict[str, Case]) -> dict[str, list[str]]:
    """Diagnose cases with the loaded thresholds; return the verdict and the names of the causes of each."""
    from heli_lab.diagnose import diagnose, to_json
    from heli_sim.model import MultibodyModel
    from heli_sim.rig import load_rig

    from tests.diagnose.hidden import flights

    results = {}
    for name, case in cases.items():
        fit, held_out = flights(*case.effects, unlisted=case.is_unlisted, seconds=case.durations_s)
        result = to_json(diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out]))
        results[name] = [result["verdict"], *sorted(cause["effect"] for cause in result["causes"])]
    return results


def in_a_process(changed: dict[str, float], names: Sequence[str]) -> dict[str, list[str]]:
    """Call `verdicts` in a separate process, in which the thresholds can still be changed."""
    command = [
        sys.executable,
        "-m",
        "tests.diagnose.sensitivity",
        "--worker",
        json.dumps([changed, list(names)]),
    ]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if process.returncode:
        return {name: ["failed", process.stderr.strip().splitlines()[-1]] for name in names}
    answer: dict[str, list[str]] = json.loads(process.stdout.splitlines()[-1])
    return answer


def judged() -> Iterator[tuple[str, Any]]:
    """Yield name and value of the constants that are judgement."""
    from heli_lab.explain import thresholds

    for row in thresholds.table():
        if row.source is thresholds.JUDGEMENT:
            yield row.name, row.value


def measure(names: Sequence[str], cases: Sequence[str], path: Path) -> Iterator[dict[str, Any]]:
    """Yield a row per constant and factor; rows that the file has are not measured again."""
    rows = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    known = {(row["name"], row["factor"]): row for row in rows}
    with path.open("a") as file:
        base = known.get(("", 1.0)) or {"name": "", "factor": 1.0, "verdicts": in_a_process({}, cases)}
        for name, factor in [("", 1.0), *((name, factor) for name in names for factor in FACTORS)]:
            row = known.get((name, factor))
            if row is None:
                results = base["verdicts"] if not name else in_a_process({name: factor}, cases)
                row = {"name": name, "factor": factor, "verdicts": results}
                print(json.dumps(row), file=file, flush=True)
            flipped = [case for case in row["verdicts"] if row["verdicts"][case] != base["verdicts"][case]]
            yield {**row, "flipped": flipped}


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="constants; all of judgement if none is given")
    parser.add_argument("--cases", nargs="*", default=list(CASES), choices=list(CASES))
    parser.add_argument("--output", "-o", type=Path, default=ROOT / "build" / "sensitivity.jsonl")
    parser.add_argument("--worker", help=argparse.SUPPRESS)
    chosen = parser.parse_args(arguments)
    one_thread_each()
    if chosen.worker:
        changed, names = json.loads(chosen.worker)
        load_thresholds(changed)
        print(json.dumps(verdicts({name: CASES[name] for name in names})))
        return 0
    all_names = dict(judged())
    if unknown := set(chosen.names) - set(all_names):
        parser.error(f"no constant of judgement is called {', '.join(sorted(unknown))}")
    chosen.output.parent.mkdir(parents=True, exist_ok=True)
    print(f"{'constant':34}{'factor':>7}  verdicts that change")
    for row in measure(chosen.names or list(all_names), chosen.cases, chosen.output):
        print(
            f"{row['name'] or '(as they are)':34}{row['factor']:7}  {', '.join(row['flipped']) or '-'}",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
