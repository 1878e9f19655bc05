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
from typing import NamedTuple

from heli_lab.apps.campaign import Campaign, Store, campaign_results
from heli_lab.apps.campaign import Case as CampaignCase

from heli_benchmark.cases.clean import Case, add_choice, chosen, clean_cases, matches
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.goals import confusion, draw, further_counts, goals, reliability, text
from heli_benchmark.judge import Row
from heli_benchmark.runs.case import REFITS, WORK, cause_visibility, code_of_rows

_PROCESSES = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and report; with `zoo` first, judge the import of logs instead."""
    words = sys.argv[1:] if arguments is None else list(arguments)
    if words[:1] == ["zoo"]:
        from heli_benchmark.zoo.run import main as judge_zoo

        return judge_zoo(words[1:])
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
    options = parser.parse_args(words)
    if options.read:
        return _print_earlier_results(options)
    cases = chosen(_alternate_clean_and_disturbed(), options)
    if not cases:
        print(f"error: no case is called {', '.join(options.only)}; sim/heli_benchmark/cases has their names")
        return 2
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        # Cases run side by side: threads that wait for each other took 2.5 times the CPU time.
        os.environ.setdefault(name, "1")
    if options.flights:
        return _print_visibilities(cases, options)
    rows: list[Row] = []
    for row in _print_progress(_run_cases(cases, options), len(cases)):
        rows = sorted((*rows, row), key=lambda scored: scored.case)
        # After each case, so that a stopped run keeps its results.
        options.json.write_text(json.dumps(_report_content(rows), indent=1) + "\n")
    print(text(rows))
    figure = options.json.with_suffix(".png")
    draw(reliability(rows), figure)
    print(f"\n{options.json} has the results, {figure} the calibration")
    return 0 if len(rows) == len(cases) else 1  # a failed case has no row


def _alternate_clean_and_disturbed() -> list[Case]:
    """Alternate clean and disturbed cases, so that the first are a fair sample of all."""
    pairs = zip_longest(clean_cases(), disturbed_cases())
    return [case for pair in pairs for case in pair if case is not None]


def _print_earlier_results(options: argparse.Namespace) -> int:
    """Print the results of an earlier run with the present scoring."""
    try:
        row_contents = json.loads(options.json.read_text())["cases"]
    except FileNotFoundError:
        print(f"{options.json} does not exist; run without --read first")
        return 2
    rows = [Row.read(content) for content in row_contents if matches(content["case"], options.only)]
    print(text(rows))
    return 0


def _print_visibilities(cases: Sequence[Case], options: argparse.Namespace) -> int:
    """Fly all cases, and print for each how visible its causes are, in standard deviations."""
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(cause_visibility, case, options.folder, options.keep) for case in cases]
        for case, job in zip(cases, jobs, strict=True):
            causes = ", ".join(
                f"{name} {'-' if z is None else f'{z:.1f}'}" for name, z in job.result().items()
            )
            print(f"{case.name}: {causes or 'nothing'}", flush=True)
    return 0


class _CaseResult(NamedTuple):
    """Result of a case: a row, or the reason why the case has none."""

    row: Row | None
    failure: str = ""


def _run_cases(cases: Sequence[Case], options: argparse.Namespace) -> Iterator[_CaseResult]:
    """Run all cases, and yield their results."""
    folder = options.folder.resolve()
    settings = {"folder": str(folder), "keep": options.keep, "refits": options.budget}
    campaign_cases = {
        case.name: CampaignCase(case.name, WORK, {"case": case.name, **settings}) for case in cases
    }
    store, code = Store(folder / "campaign"), code_of_rows()
    keys = {case.key(code): case.name for case in campaign_cases.values()}
    # An earlier result is used only if the same code made it. With --keep, each case is run again: it then
    # reads the files of its earlier run, whatever code made them.
    is_repeated = (lambda _: True) if options.keep else (lambda result: bool(result.failure))
    stored = {} if options.keep else store.read(keys)
    for result in stored.values():
        if not result.failure:
            yield _CaseResult(Row.read(result.detail))
    campaign = Campaign("blind", tuple(campaign_cases.values()))
    try:
        for result in campaign_results(
            campaign, store, processes=options.processes, code=code, is_repeated=is_repeated
        ):
            if result.failure:
                yield _CaseResult(row=None, failure=f"{result.name}: {result.failure}")
            else:
                yield _CaseResult(Row.read(result.detail))
    except KeyboardInterrupt:
        print("stopped; the same command continues")
        raise SystemExit(130) from None


def _print_progress(results: Iterable[_CaseResult], count: int) -> Iterator[Row]:
    """Print one line per result, with the time that the remaining ones of `count` need; yield the rows."""
    started_s = time.monotonic()
    for number, (row, failure) in enumerate(results, 1):
        left_s = (time.monotonic() - started_s) / number * (count - number)
        progress = f"{number}/{count}, {left_s / 60.0:.0f} min left"
        if row is None:
            print(f"[{progress}] {failure}", flush=True)
            continue
        judgement = "failed" if row.failure else ("right" if row.right else "WRONG")
        causes = ", ".join(row.named) or row.failure or "no cause"
        print(
            f"[{progress}] {row.case}: {judgement}; {row.verdict}: {causes}; {row.seconds:.0f} s", flush=True
        )
        yield row


def _report_content(rows: Sequence[Row]) -> dict[str, object]:
    """Return the content of the JSON file: counts over all cases, then each row with its judgement."""
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
