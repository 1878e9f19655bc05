"""`python -m heli_benchmark`: run all cases; print results, misses, calibration and goals."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import zip_longest
from multiprocessing import get_context
from pathlib import Path

from heli_lab.campaign import Campaign, Store, campaign_results
from heli_lab.campaign import Case as CampaignCase

from heli_benchmark.cases.clean import Case, clean_cases
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.cases.selection import add_choice, chosen, is_wanted
from heli_benchmark.runs.ask import REFITS
from heli_benchmark.runs.case import WORK, cause_visibility, code_of_rows
from heli_benchmark.scoring.goals import further_counts, goals
from heli_benchmark.scoring.judge import Row
from heli_benchmark.scoring.reliability import draw, reliability
from heli_benchmark.scoring.summary import confusion, text

_PROCESSES = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and report.

    Parameters
    ----------
    arguments : sequence of str, optional
        Arguments instead of those of the command line.

    Returns
    -------
    int
        Exit status: 0 if all cases ran.
    """
    parser = argparse.ArgumentParser(prog="python -m heli_benchmark", description=__doc__)
    add_choice(parser)
    parser.add_argument("--keep", action="store_true", help="use results of any version of the code")
    parser.add_argument("--budget", type=int, default=REFITS, help="maximum number of refits of a search")
    parser.add_argument("--processes", type=int, default=_PROCESSES)
    parser.add_argument("--json", type=Path, default=Path("blind.json"))
    parser.add_argument("--read", action="store_true", help="print the results of the JSON file, run nothing")
    parser.add_argument(
        "--flights", action="store_true", help="only fly, and print how visible each cause is"
    )
    given = parser.parse_args(arguments)
    if given.read:
        return _read(given)
    cases = chosen(_mixed(), given)
    if not cases:
        print(f"error: no case is called {', '.join(given.only)}; sim/heli_benchmark/cases has their names")
        return 2
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        # Cases run side by side: threads that wait for each other took 2.5 times the CPU time.
        os.environ.setdefault(name, "1")
    if given.flights:
        return _flown(cases, given)
    rows: list[Row] = []
    for row in _printed(_done(cases, given), len(cases)):
        rows = sorted((*rows, row), key=lambda scored: scored.case)
        # After each case, so that a stopped run keeps its results.
        given.json.write_text(json.dumps(_report(rows), indent=1) + "\n")
    print(text(rows))
    print(f"\n{given.json} has the results, {_drawn(rows, given.json)} the calibration")
    return 0 if len(rows) == len(cases) else 1


def _mixed() -> list[Case]:
    """Alternate clean and disturbed cases, so that the first are a fair sample of all."""
    both = zip_longest(clean_cases(), disturbed_cases())
    return [case for pair in both for case in pair if case is not None]


def _read(given: argparse.Namespace) -> int:
    """Print the results of an earlier run with the present scoring."""
    try:
        kept = json.loads(given.json.read_text())["cases"]
    except FileNotFoundError:
        print(f"{given.json} does not exist; run without --read first")
        return 2
    rows = [Row.read(content) for content in kept if is_wanted(content["case"], given.only)]
    print(text(rows))
    return 0


def _flown(cases: Sequence[Case], given: argparse.Namespace) -> int:
    """Make all flights, and print the visibility of each cause."""
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(cause_visibility, case, given.folder, given.keep) for case in cases]
        for case, job in zip(cases, jobs, strict=True):
            causes = ", ".join(
                f"{name} {'-' if z is None else f'{z:.1f}'}" for name, z in job.result().items()
            )
            print(f"{case.name}: {causes or 'nothing'}", flush=True)
    return 0


def _drawn(rows: Sequence[Row], beside: Path) -> Path:
    path = beside.with_suffix(".png")
    draw(reliability(rows), path)
    return path


def _done(cases: Sequence[Case], given: argparse.Namespace) -> Iterator[tuple[Row | None, str]]:
    """Yield rows as they arrive, those of an earlier run first; or None and the failure."""
    folder = given.folder.resolve()
    settings = {"folder": str(folder), "keep": given.keep, "refits": given.budget}
    named = {case.name: CampaignCase(case.name, WORK, {"case": case.name, **settings}) for case in cases}
    store, code = Store(folder / "campaign"), code_of_rows()
    keys = {case.key(code): case.name for case in named.values()}
    # An earlier result is used only if the same code made it.
    again = (lambda _: True) if given.keep else (lambda answer: bool(answer.failure))
    known = {} if given.keep else store.read(keys)
    for answer in known.values():
        if not answer.failure:
            yield Row.read(answer.detail), ""
    campaign = Campaign("blind", tuple(named.values()))
    try:
        for result in campaign_results(campaign, store, processes=given.processes, code=code, again=again):
            yield (
                (None, f"{result.name}: {result.failure}")
                if result.failure
                else (Row.read(result.detail), "")
            )
    except KeyboardInterrupt:
        print("stopped; the same command continues")
        raise SystemExit(130) from None


def _printed(done: Iterable[tuple[Row | None, str]], count: int) -> Iterator[Row]:
    started_s = time.monotonic()
    for number, (row, failure) in enumerate(done, 1):
        left_s = (time.monotonic() - started_s) / number * (count - number)
        progress = f"{number}/{count}, {left_s / 60.0:.0f} min left"
        if row is None:
            print(f"[{progress}] {failure}", flush=True)
            continue
        word = "failed" if row.failure else ("right" if row.right else "WRONG")
        named = ", ".join(row.named) or row.failure or "no cause"
        print(f"[{progress}] {row.case}: {word}; {row.verdict}: {named}; {row.seconds:.0f} s", flush=True)
        yield row


def _report(rows: Sequence[Row]) -> dict[str, object]:
    return {
        "goals": goals(rows),
        "further": further_counts(rows),
        "reliability": reliability(rows),
        "confusion": confusion(rows),
        "cases": [
            {
                **asdict(row),
                "right": row.right,
                "false_names": row.false_names,
                "named_correctly": row.named_correctly,
                "missed": row.missed,
                "counts": row.counts,
                "borderline": row.is_borderline,
            }
            for row in rows
        ],
    }


if __name__ == "__main__":
    sys.exit(main())
