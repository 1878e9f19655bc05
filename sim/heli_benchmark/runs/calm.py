"""`python -m heli_benchmark.runs.calm [SEED...]`: which small effects are named without disturbances."""

from __future__ import annotations

import argparse
from typing import Any

from heli_benchmark.cases.calm import CalmCase, calm_case
from heli_benchmark.runs.ask import diagnosed_cases


def false_names(case: CalmCase, result: dict[str, Any]) -> list[str]:
    """Return the causes of a `result` that are not hidden in the case."""
    hidden = {id_ for id_, _ in case.effects}
    return [cause["effect"] for cause in result["causes"] if cause["effect"] not in hidden]


def unreported(case: CalmCase, result: dict[str, Any]) -> list[str]:
    """Return the hidden effects that a `result` neither names nor reports as too small to matter."""
    reported = {entry["effect"] for key in ("causes", "too_small") for entry in result[key]}
    return [id_ for id_, _ in case.effects if id_ not in reported]


def main() -> None:
    """Diagnose the cases of all seeds and print one row per case."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("seeds", nargs="*", type=int, default=list(range(7000, 7004)))
    options = parser.parse_args()
    total = quiet = reported = 0
    for case, result, spent_s in diagnosed_cases(map(calm_case, options.seeds)):
        wrong, missed = false_names(case, result), unreported(case, result)
        total, quiet, reported = total + 1, quiet + (not wrong), reported + (not missed)
        word = "WRONG" if wrong else "MISSED" if missed else "right"
        print(f"{case.name:45} {word:6} {result['verdict']:12} {spent_s:5.1f} s", flush=True)
        for cause in result["causes"]:
            state = "confirmed" if cause.get("confirmed") else "not confirmed"
            print(f"    {cause['effect']} ({cause['confidence']:.2f}, {state}): {cause['sentence']}")
        for small in result["too_small"]:
            print(f"    too small, {small['change_counts']:.3f} counts: {small['sentence']}")
    print(f"no false name: {quiet} of {total}; every hidden effect named or reported: {reported} of {total}")


if __name__ == "__main__":
    main()
