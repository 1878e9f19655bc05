"""Diagnoses of the practice and field cases: ``python -m tests.field``."""

import argparse
import json
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from heli_benchmark.cases.clean import matches
from heli_benchmark.runs.case import REFITS

from tests.field.cases import DATA, NO_DATA, Case, ask, cases, judged
from tests.running.alone import one_thread_each


def main(arguments: Sequence[str] | None = None, data: Path = DATA) -> int:
    """Ask and print."""
    parser = argparse.ArgumentParser(prog="python -m tests.field", description=__doc__)
    parser.add_argument("only", nargs="*", help="names of cases, wildcards allowed; all without")
    parser.add_argument("--budget", type=int, default=REFITS, help="most refits of a search")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path, help="file for all answers")
    given = parser.parse_args(arguments)
    there = cases(data)
    if not there:
        print(NO_DATA)
        return 0
    chosen = [case for case in there if _wanted(case, given.only)]
    if not chosen:
        print(
            f"no case is called {', '.join(given.only)}; there are {', '.join(case.name for case in there)}"
        )
        return 2
    one_thread_each()
    answers: dict[str, Any] = {}
    right = 0
    spent_s = 0.0
    # Fresh processes: each pays for itself, and its CPU time is its own.
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        for case, answer in zip(chosen, pool.map(ask, chosen, [given.budget] * len(chosen)), strict=True):
            row = judged(case, answer)
            print(row.line(), flush=True)
            answers[case.name] = answer
            right += row.right
            spent_s += row.cpu_s
            if given.json:
                given.json.write_text(json.dumps(answers, indent=1, default=float) + "\n")
    print(f"\n{right} of {len(chosen)} right, {spent_s:.0f} s of CPU")
    return 0 if right == len(chosen) else 1


def _wanted(case: Case, patterns: Sequence[str]) -> bool:
    return any(matches(name, patterns) for name in (case.name, case.folder.name))


if __name__ == "__main__":
    sys.exit(main())
