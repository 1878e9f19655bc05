"""`python -m tests.blind.equation_run`: laws on no list, how many are found, and how well."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from heli_host.flight import Flight

from tests.blind.choice import add_choice, chosen
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.judge import SEEN

CORRELATES, NEAR_TOLD = 0.9, 1.3
Row = dict[str, Any]
"""What is known of a case, for JSON; ``failure`` where it died."""


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
    parser = argparse.ArgumentParser(prog="python -m tests.blind.equation_run", description=__doc__)
    add_rows(parser, Path("laws.json"))
    parser.add_argument("--nothing", action="store_true", help="cases without a law instead")
    parser.add_argument("--seen", action="store_true", help="diagnose only laws that can be seen")
    given = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from tests.blind.disturbed_cases import disturbed_cases
    from tests.blind.equation_cases import equation_cases
    from tests.blind.equation_oracle import judged_law

    every = [one for one in disturbed_cases() if not one.unlisted] if given.nothing else equation_cases()
    rows = judged_rows(chosen(every, given), judged_law, _said, given)
    print(summary(rows))
    return 0 if all("failure" not in row for row in rows.values()) else 1


def add_rows(parser: argparse.ArgumentParser, json_file: Path) -> None:
    """Add the options that `judged_rows` and `chosen` read; `json_file` is kept unless another is named."""
    add_choice(parser)
    parser.add_argument("--keep", action="store_true", help="take flights that are there")
    parser.add_argument("--json", type=Path, default=json_file)
    parser.set_defaults(seen=False)


def judged_rows(
    cases: Sequence[DisturbedCase],
    judge: Callable[[DisturbedCase, tuple[Flight, Flight]], Row],
    said: Callable[[Row], str],
    given: argparse.Namespace,
) -> dict[str, Row]:
    """Judge those cases that the JSON file does not have, and write it after each.

    Parameters
    ----------
    cases : sequence of DisturbedCase
        The cases.
    judge : callable
        A row of a case and its flights.
    said : callable
        A row in a line.
    given : argparse.Namespace
        Options ``json``, ``folder`` and ``keep``; with ``seen`` cases that do not count are left out.

    Returns
    -------
    dict of Row
        All that the file has now, by case.
    """
    from tests.blind.run import prepare

    rows: dict[str, Row] = json.loads(given.json.read_text()) if given.json.exists() else {}
    for case in cases:
        if case.name in rows:
            continue
        started_s = time.process_time()
        try:
            ready = prepare(case, given.folder, keep=given.keep)
            row: Row = {"told": dict(ready.told) if isinstance(ready.told, dict) else {}}
            if given.seen and not is_seen(row):
                print(f"{case.name}: cannot be seen, {row['told']}", flush=True)
                continue
            row |= judge(case, ready.flights)
        except Exception as error:  # noqa: BLE001 - a case that dies must not end the others
            row = {"failure": f"{type(error).__name__}: {error}"}
        row["cpu_seconds"] = time.process_time() - started_s
        rows[case.name] = row
        given.json.write_text(json.dumps(rows, indent=1, default=float) + "\n")
        print(f"{case.name}: {said(row)}", flush=True)
    return rows


def is_seen(row: Row) -> bool:
    """Whether the law of a case stands out so far that it counts."""
    return min((z for what, z in row["told"].items() if what.startswith("off-")), default=0.0) >= SEEN


def _said(row: Row) -> str:
    if "failure" in row:
        return str(row["failure"])
    seen = ", ".join(f"{name} {z:.0f}" for name, z in row["told"].items())
    law = row["expression"] or "no law"
    numbers = ""
    if "correlation" in row:
        numbers = f"; correlation {row['correlation']:.3f}, error {row['error_ratio']:.2f} of told"
    return f"[{seen}] {row['verdict']}, {', '.join(row['causes']) or 'no cause'}: {law}{numbers}"


def summary(rows: dict[str, Row]) -> str:
    """Count how many laws are found, and how many are proposed where there is none.

    Parameters
    ----------
    rows : dict
        Rows by case, as `main` writes them.
    """
    equations = [
        row for name, row in rows.items() if name.startswith("law-") and "failure" not in row and is_seen(row)
    ]
    others = [row for name, row in rows.items() if not name.startswith("law-") and "failure" not in row]
    proposed = [row for row in equations if row["expression"]]
    good = [row for row in equations if row.get("correlation", 0.0) >= CORRELATES]
    near = [row for row in equations if row.get("error_ratio", 99.0) <= NEAR_TOLD]
    return (
        f"visible laws: {len(equations)}, proposed {len(proposed)}, "
        f"correlation of {CORRELATES} and more {len(good)}, "
        f"error within {NEAR_TOLD} of told {len(near)}; laws proposed where there is none: "
        f"{sum(bool(row['expression']) for row in others)} of {len(others)}"
    )


if __name__ == "__main__":
    sys.exit(main())
