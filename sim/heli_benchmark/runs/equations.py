"""`python -m heli_benchmark.runs.equations`: count how many unlisted equations a diagnosis discovers."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from heli_host.data.flight import Flight

from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.cases.selection import add_choice, chosen
from heli_benchmark.scoring.judge import MIN_VISIBILITY_STD

MIN_CORRELATION, MAX_ERROR_RATIO = 0.9, 1.3
"""Limits within which an equation counts as right: its correlation with the true torque, and the error of a
free run with it relative to a fit with the true equation."""
EquationRow = dict[str, Any]
"""Results of a case for JSON; ``failure`` if an error ended it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and count the results."""
    parser = argparse.ArgumentParser(prog="python -m heli_benchmark.runs.equations", description=__doc__)
    add_rows(parser, Path("equations.json"))
    parser.add_argument("--nothing", action="store_true", help="run cases without an unlisted equation")
    parser.add_argument("--seen", action="store_true", help="diagnose only visible equations")
    options = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_benchmark.cases.disturbed import disturbed_cases
    from heli_benchmark.cases.unlisted_equations import equation_cases
    from heli_benchmark.runs.equation_reference import judge_equation

    cases = [case for case in disturbed_cases() if not case.unlisted] if options.nothing else equation_cases()
    rows = judge_rows(chosen(cases, options), judge_equation, _describe_row, options)
    print(equation_summary(rows))
    return 0 if all("failure" not in row for row in rows.values()) else 1


def add_rows(parser: argparse.ArgumentParser, json_file: Path) -> None:
    """Add to a `parser` the options of `judge_rows` and `chosen`; `json_file` is the default output."""
    add_choice(parser)
    parser.add_argument("--keep", action="store_true", help="use flights that exist")
    parser.add_argument("--json", type=Path, default=json_file)
    parser.set_defaults(visibilities=False)


def judge_rows(
    cases: Sequence[DisturbedCase],
    judge: Callable[[DisturbedCase, tuple[Flight, Flight]], EquationRow],
    describe: Callable[[EquationRow], str],
    options: argparse.Namespace,
) -> dict[str, EquationRow]:
    """Judge the cases that the JSON file lacks, and write it after each."""
    from heli_benchmark.runs.case import prepare

    rows: dict[str, EquationRow] = json.loads(options.json.read_text()) if options.json.exists() else {}
    for case in cases:
        if case.name in rows:
            continue
        started_s = time.process_time()
        try:
            prepared = prepare(case, options.folder, keep=options.keep)
            reference = prepared.reference
            row: EquationRow = {"visibility": reference if isinstance(reference, dict) else {}}
            if options.seen and not is_visible(row):
                print(f"{case.name}: not visible, {row['visibility']}", flush=True)
                continue
            row |= judge(case, prepared.flights)
        except Exception as error:  # noqa: BLE001 - an error in one case must not end the others
            row = {"failure": f"{type(error).__name__}: {error}"}
        row["cpu_seconds"] = time.process_time() - started_s
        rows[case.name] = row
        options.json.write_text(json.dumps(rows, indent=1, default=float) + "\n")
        print(f"{case.name}: {describe(row)}", flush=True)
    return rows


def is_visible(row: EquationRow) -> bool:
    """Return whether the equation of a case, by its `row`, is visible enough to count."""
    visibilities_std = [std for name, std in row["visibility"].items() if name.startswith("off-")]
    return min(visibilities_std, default=0.0) >= MIN_VISIBILITY_STD


def _describe_row(row: EquationRow) -> str:
    """Return one line: visibility of each cause, verdict, equation and how well it agrees with the truth."""
    if "failure" in row:
        return str(row["failure"])
    visibilities = ", ".join(f"{name} {z:.0f}" for name, z in row["visibility"].items())
    expression = row["expression"] or "no equation"
    numbers = ""
    if "correlation" in row:
        numbers = f"; correlation {row['correlation']:.3f}, error {row['error_ratio']:.2f} of informed"
    return (
        f"[{visibilities}] {row['verdict']}, {', '.join(row['causes']) or 'no cause'}: {expression}{numbers}"
    )


def equation_summary(rows: dict[str, EquationRow]) -> str:
    """Count the hidden equations that were proposed, and the equations that were proposed without a
    reason.
    """
    equations = [
        row
        for name, row in rows.items()
        if name.startswith("law-") and "failure" not in row and is_visible(row)
    ]
    others = [row for name, row in rows.items() if not name.startswith("law-") and "failure" not in row]
    proposed = [row for row in equations if row["expression"]]
    correlated = [row for row in equations if row.get("correlation", 0.0) >= MIN_CORRELATION]
    accurate = [row for row in equations if row.get("error_ratio", 99.0) <= MAX_ERROR_RATIO]
    return (
        f"visible equations: {len(equations)}, proposed {len(proposed)}, "
        f"correlation of {MIN_CORRELATION} and more {len(correlated)}, "
        f"error within {MAX_ERROR_RATIO} of informed {len(accurate)}; proposed where none is hidden: "
        f"{sum(bool(row['expression']) for row in others)} of {len(others)}"
    )


if __name__ == "__main__":
    sys.exit(main())
