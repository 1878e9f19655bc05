"""`python -m heli_benchmark.runs.removed_effects`: does a discovered equation replace a removed effect?"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from heli_benchmark.cases.selection import chosen
from heli_benchmark.runs.equations import EquationRow, add_rows, judge_rows

SHARE = 0.8
"""Share of the error reduction of the removed effect that its equation must reach."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and count."""
    parser = argparse.ArgumentParser(
        prog="python -m heli_benchmark.runs.removed_effects", description=__doc__
    )
    add_rows(parser, Path("removed_effects.json"))
    options = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_benchmark.cases.removed_effects import removed_effect_cases
    from heli_benchmark.runs.removed_effect_reference import judge_replacement

    cases = chosen(removed_effect_cases(), options)
    rows = judge_rows(
        cases, lambda case, flights: judge_replacement(case, flights, options.folder), _describe_row, options
    )
    print(removed_effect_summary(rows))
    return 0 if all("failure" not in row for row in rows.values()) else 1


def _describe_row(row: EquationRow) -> str:
    """Return one line: visibility of the effect, verdict, equation, and errors of three fits."""
    if "failure" in row:
        return str(row["failure"])
    visibility_std = list(row["visibility"].values())[-1]
    return (
        f"[{visibility_std:.0f}] {row['verdict']}, {', '.join(row['causes']) or 'no cause'}: "
        f"{row['expression'] or 'no equation'}; {row['axis']} off by {row['without_deg']:.3g} deg without, "
        f"{row['found_deg']:.3g} with it, {row['informed_deg']:.3g} with the effect: share {row['share']:.2f}"
        f"{'; flown: ' + row['flies'] if 'flies' in row else ''}"
    )


def removed_effect_summary(rows: Mapping[str, EquationRow]) -> str:
    """Count equations that fly and explain `SHARE` of the error; `rows` are by case, as in the file."""
    completed = [row for row in rows.values() if "failure" not in row]
    proposed = [row for row in completed if row["expression"]]
    flying = [row for row in proposed if row["flies"] == "completed"]
    explaining = [row for row in flying if row["share"] >= SHARE]
    return (
        f"effects removed: {len(completed)}, equations proposed {len(proposed)}, flown {len(flying)}, "
        f"explain {SHARE:.0%} of the error of the effect {len(explaining)}"
    )


if __name__ == "__main__":
    sys.exit(main())
