"""Golden results of the diagnosis: ``python -m tests.field.golden [PATTERN...]`` compares with them.

The diagnosis of every practice, field and measured case is reduced to its verdict, its causes with sizes and
log-likelihood ratios, and the prediction errors. A change of names or structure must not change them. A
change of the method must say why it does; ``--record`` writes the new results. ``golden.json`` holds results
only, no row of a flight.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from fnmatch import fnmatchcase
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Final

from heli_benchmark.runs.case import REFITS
from heli_lab.diagnose import diagnose, to_json
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.field.cases import NO_DATA, ask, cases
from tests.measured.pairs import MEASURED, PAIRS, RIG, flights
from tests.running.alone import one_thread_each

FILE: Final = Path(__file__).with_name("golden.json")
LOG_LIKELIHOOD_NATS: Final = 0.1
"""Tolerance of log-likelihood ratios, nats. A search converges to 0.02 nats: libraries that round differently
may end one step earlier."""
SIZE_STD: Final = 0.02
"""Tolerance of a parameter, in its standard errors. 0.1 nats may be as much as 0.45 of them."""
RATIO: Final = 0.01
"""Tolerance of confidences and of prediction error ratios."""


def golden_result(result: Mapping[str, Any]) -> dict[str, Any]:
    """Reduce a diagnosis to what must stay the same."""
    # `result`: A diagnosis as JSON.
    # Returns: ``verdict``, ``causes`` by effect, and ``error_ratios`` by horizon (s) and axis.
    causes = {
        cause["effect"]: {
            "confidence": cause["confidence"],
            "log_likelihood_ratio_nats": cause["evidence"]["log_likelihood_ratio_train"],
            "held_out_log_likelihood_ratio_nats": cause["evidence"]["log_likelihood_ratio_held_out"],
            "parameters": {
                name: [number["value"], number["std"]] for name, number in cause["parameters"].items()
            },
        }
        for cause in result["causes"]
    }
    ratios = {
        f"{horizon} s": {axis: error["ratio"] for axis, error in entry["axis"].items()}
        for horizon, entry in result["gain"]["horizons"].items()
    }
    return {"verdict": result["verdict"], "causes": causes, "error_ratios": ratios}


def differences(golden: Mapping[str, Any], result: Mapping[str, Any]) -> Iterator[str]:
    """Compare a result with the golden one, both as `golden_result` reduces them."""
    # `golden`, `result`: The recorded and the new result.
    # Yields: One line for each difference beyond the tolerances.
    if golden["verdict"] != result["verdict"]:
        yield f"verdict {result['verdict']}, was {golden['verdict']}"
    if list(golden["causes"]) != list(result["causes"]):
        yield f"causes {', '.join(result['causes'])}; were {', '.join(golden['causes'])}"
        return
    for effect, before in golden["causes"].items():
        after = result["causes"][effect]
        for key in ("log_likelihood_ratio_nats", "held_out_log_likelihood_ratio_nats"):
            if not _near(before[key], after[key], LOG_LIKELIHOOD_NATS):
                yield f"{effect}: {key} {after[key]}, was {before[key]}"
        if not _near(before["confidence"], after["confidence"], RATIO):
            yield f"{effect}: confidence {after['confidence']}, was {before['confidence']}"
        if list(before["parameters"]) != list(after["parameters"]):
            yield f"{effect}: parameters {list(after['parameters'])}, were {list(before['parameters'])}"
            continue
        for name, (value, std) in before["parameters"].items():
            new_value, new_std = after["parameters"][name]
            if not _near(value, new_value, SIZE_STD * std) or not _near(std, new_std, RATIO * std):
                yield f"{effect}: {name} {new_value} ± {new_std}, was {value} ± {std}"
    for horizon, axes in golden["error_ratios"].items():
        for axis, ratio in axes.items():
            if not _near(ratio, result["error_ratios"][horizon][axis], RATIO):
                yield f"error ratio {horizon}, {axis}: {result['error_ratios'][horizon][axis]}, was {ratio}"


def _near(before: float | None, after: float | None, tolerance: float) -> bool:
    if before is None or after is None:
        return before is after
    return abs(before - after) <= tolerance


def runs() -> dict[str, Callable[[], dict[str, Any]]]:
    """All cases that are there: by name, a function that diagnoses the case and returns its golden result."""
    functions: dict[str, Callable[[], dict[str, Any]]] = {
        case.name: partial(_simulated, case.name) for case in cases()
    }
    if MEASURED.exists():
        for pair in PAIRS:
            functions[f"measured/{pair}"] = partial(_measured, pair, exchanged=False)
            functions[f"measured/{pair}-back"] = partial(_measured, pair, exchanged=True)
    return functions


def _simulated(name: str) -> dict[str, Any]:
    (case,) = (case for case in cases() if case.name == name)
    return golden_result(ask(case, REFITS)["result"])


def _measured(pair: str, *, exchanged: bool) -> dict[str, Any]:
    train, held_out = flights(pair, exchanged)
    labels = list(PAIRS[pair])[:: -1 if exchanged else 1]
    return golden_result(
        to_json(diagnose(MultibodyModel(), load_rig(RIG), [train], [held_out], labels=labels))
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Diagnose and compare, or record."""
    parser = argparse.ArgumentParser(prog="python -m tests.field.golden", description=__doc__)
    parser.add_argument("patterns", nargs="*", default=["*"], help="names of cases, wildcards allowed")
    parser.add_argument("--record", action="store_true", help="write the results into golden.json")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args(arguments)
    chosen = {
        name: function
        for name, function in runs().items()
        if any(fnmatchcase(name, pattern) for pattern in options.patterns)
    }
    if not chosen:
        print(NO_DATA)
        return 0
    one_thread_each()
    golden: dict[str, Any] = json.loads(FILE.read_text()) if FILE.exists() else {}
    differing = 0
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        results = {name: pool.submit(function) for name, function in chosen.items()}
        for name, future in results.items():
            result = future.result()
            if options.record:
                golden[name] = result
                FILE.write_text(json.dumps(golden, indent=1, default=float) + "\n")
                print(f"{name}: recorded", flush=True)
                continue
            lines = list(differences(golden[name], result))
            differing += bool(lines)
            print(f"{name}: {'differs' if lines else 'the same'}", *lines, sep="\n  ", flush=True)
    return 1 if differing else 0


if __name__ == "__main__":
    sys.exit(main())
