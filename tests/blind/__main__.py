"""`make blind`: every case, told as it goes; then confusion table, misses, reliability and goals."""

from __future__ import annotations

import argparse
import json
import queue
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from itertools import zip_longest
from multiprocessing import get_context
from pathlib import Path

from heli_lab.campaign import Campaign, JobResult, Store, run_campaign
from heli_lab.campaign import Case as CampaignCase
from heli_lab.campaign.run import State

from tests.blind.cases import Case, every_case
from tests.blind.choice import add_choice, chosen, is_wanted
from tests.blind.disturbed_cases import disturbed_cases
from tests.blind.goals import further, goals
from tests.blind.judge import Row
from tests.blind.reliability import draw, reliability
from tests.blind.run import REFITS, WORK, code_of_rows, seen
from tests.blind.summary import confusion, text
from tests.running.alone import one_thread_each

_PROCESSES = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and report.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of the command line's.

    Returns
    -------
    int
        Exit status: 0 when every case ran.
    """
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    add_choice(parser)
    parser.add_argument("--keep", action="store_true", help="take results there, whatever code made them")
    parser.add_argument("--budget", type=int, default=REFITS, help="most refits of a search")
    parser.add_argument("--processes", type=int, default=_PROCESSES)
    parser.add_argument("--json", type=Path, default=Path("blind.json"))
    parser.add_argument("--read", action="store_true", help="run nothing, tell what the JSON file holds")
    parser.add_argument("--flights", action="store_true", help="only fly, and tell what can be seen")
    given = parser.parse_args(arguments)
    if given.read:
        return _read(given)
    cases = chosen(_mixed(), given)
    if not cases:
        print(f"no case is called {', '.join(given.only)}; cases.py and weather_cases.py have their names")
        return 2
    one_thread_each()
    if given.flights:
        return _flown(cases, given)
    rows: list[Row] = []
    for row in _told(_done(cases, given), len(cases)):
        rows = sorted((*rows, row), key=lambda one: one.case)
        # After each case, so that a run that is stopped leaves what it knows.
        given.json.write_text(json.dumps(_report(rows), indent=1) + "\n")
    print(text(rows))
    print(f"\n{given.json} has all of it, {_drawn(rows, given.json)} the reliability")
    return 0 if len(rows) == len(cases) else 1


def _mixed() -> list[Case]:
    """Clean cases and windy ones in turn, so that the first of them are a fair sample of all."""
    both = zip_longest(every_case(), disturbed_cases())
    return [case for pair in both for case in pair if case is not None]


def _read(given: argparse.Namespace) -> int:
    """Tell what an earlier run found, with the judging of today."""
    try:
        kept = json.loads(given.json.read_text())["cases"]
    except FileNotFoundError:
        print(f"{given.json} is not there; run without --read first")
        return 2
    rows = [Row.read(one) for one in kept if is_wanted(one["case"], given.only)]
    print(text(rows))
    return 0


def _flown(cases: Sequence[Case], given: argparse.Namespace) -> int:
    """Make all flights, and tell by how much each cause stands out."""
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(seen, case, given.folder, given.keep) for case in cases]
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
    """Rows as they come, those of an earlier run first; None and why there is none."""
    folder = given.folder.resolve()
    settings = {"folder": str(folder), "keep": given.keep, "refits": given.budget}
    named = {case.name: CampaignCase(case.name, WORK, {"case": case.name, **settings}) for case in cases}
    store, code = Store(folder / "campaign"), code_of_rows()
    keys = {case.key(code): case.name for case in named.values()}
    # What was judged once is taken from there only by code that would judge the same.
    again = (lambda _: True) if given.keep else (lambda answer: bool(answer.failure))
    ended: queue.SimpleQueue[JobResult | BaseException | None] = queue.SimpleQueue()

    def work() -> None:
        def say(state: State) -> None:
            if state.newest is not None:
                ended.put(state.newest)

        try:
            campaign = Campaign("blind", tuple(named.values()))
            run_campaign(campaign, store, processes=given.processes, code=code, again=again, say=say)
            ended.put(None)
        except BaseException as error:  # noqa: BLE001 - raised again where it is waited for
            ended.put(error)

    known = {} if given.keep else store.read(keys)
    for answer in known.values():
        if not answer.failure:
            yield Row.read(answer.detail), ""
    threading.Thread(target=work, daemon=True).start()
    try:
        while (one := ended.get()) is not None:
            if isinstance(one, BaseException):
                raise one
            whole = store.read([one.key]).get(one.key, one)
            yield (None, f"{one.name}: {one.failure}") if one.failure else (Row.read(whole.detail), "")
    except KeyboardInterrupt:
        print("stopped; the same command goes on where this one was")
        raise SystemExit(130) from None


def _told(done: Iterable[tuple[Row | None, str]], count: int) -> Iterator[Row]:
    started_s = time.monotonic()
    for number, (row, failure) in enumerate(done, 1):
        left_s = (time.monotonic() - started_s) / number * (count - number)
        left = f"{number}/{count}, {left_s / 60.0:.0f} min left"
        if row is None:
            print(f"[{left}] {failure}", flush=True)
            continue
        word = "died" if row.failure else ("right" if row.right else "WRONG")
        said = ", ".join(row.named) or row.failure or "no cause"
        print(f"[{left}] {row.case}: {word}; {row.verdict}: {said}; {row.seconds:.0f} s", flush=True)
        yield row


def _report(rows: Sequence[Row]) -> dict[str, object]:
    return {
        "goals": goals(rows),
        "further": further(rows),
        "reliability": reliability(rows),
        "confusion": confusion(rows),
        "cases": [
            {
                **asdict(row),
                "right": row.right,
                "false_names": row.false_names,
                "found": row.found,
                "missed": row.missed,
                "fair": row.fair,
                "apart": row.apart,
            }
            for row in rows
        ],
    }


if __name__ == "__main__":
    sys.exit(main())
