"""`python -m tests.blind.taken_off_run`: listed effects off the list, and the laws in their place."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from tests.blind.choice import chosen
from tests.blind.equation_run import Row, add_rows, judged_rows

SHARE = 0.8


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and count.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of the command line's.

    Returns
    -------
    int
        Exit status: 0 when every case ran.
    """
    parser = argparse.ArgumentParser(prog="python -m tests.blind.taken_off_run", description=__doc__)
    add_rows(parser, Path("taken_off.json"))
    given = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from tests.blind.taken_off import taken_off_cases
    from tests.blind.taken_off_oracle import judged_in_place

    cases = chosen(taken_off_cases(), given)
    rows = judged_rows(cases, lambda one, two: judged_in_place(one, two, given.folder), _said, given)
    print(summary(rows))
    return 0 if all("failure" not in row for row in rows.values()) else 1


def _said(row: Row) -> str:
    if "failure" in row:
        return str(row["failure"])
    seen = list(row["told"].values())[-1]
    return (
        f"[{seen:.0f}] {row['verdict']}, {', '.join(row['causes']) or 'no cause'}: "
        f"{row['expression'] or 'no law'}; {row['axis']} off by {row['without_deg']:.3g} deg without, "
        f"{row['found_deg']:.3g} with it, {row['told_deg']:.3g} told: share {row['share']:.2f}"
        f"{'; flown: ' + row['flies'] if 'flies' in row else ''}"
    )


def summary(rows: Mapping[str, Row]) -> str:
    """Count laws that fly and take so much of the error as the goal has it; `rows` by case, as `main` writes
    them.
    """
    ended = [row for row in rows.values() if "failure" not in row]
    proposed = [row for row in ended if row["expression"]]
    flying = [row for row in proposed if row["flies"] == "completed"]
    good = [row for row in flying if row["share"] >= SHARE]
    return (
        f"effects off the list: {len(ended)}, laws proposed {len(proposed)}, that fly {len(flying)}, "
        f"and take {SHARE:.0%} of the error that the effect would {len(good)}"
    )


if __name__ == "__main__":
    sys.exit(main())
