"""`python -m heli_benchmark zoo`: draw cases, import them, and print the scores."""

from __future__ import annotations

import argparse
import collections
import json
import os
import shutil
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Final

from heli_host.data.flight import Flight

from heli_benchmark.zoo.draw import draw_case
from heli_benchmark.zoo.flights import RECIPES, kept_flight
from heli_benchmark.zoo.judge import CONFIRMED, DOUBTED, REFUSED, RIGHT, SCORES, SILENT, Score, judge_import

_FOLDER: Final = Path("build") / "zoo"
_FINE: Final = (RIGHT, CONFIRMED, DOUBTED, REFUSED)


def main(arguments: Sequence[str]) -> int:
    """Judge the cases of a seed; 1 if one of them is silently wrong."""
    parser = argparse.ArgumentParser(prog="python -m heli_benchmark zoo", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=48)
    parser.add_argument("--case", type=int, nargs="*", help="only the cases with these numbers")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep the files of the cases in this folder")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=_FOLDER, help="keep the flights in this folder")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all scores into this file")
    options = parser.parse_args(arguments)
    numbers = options.case if options.case else list(range(options.count))
    for recipe in RECIPES:
        kept_flight(recipe, options.folder)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        # Cases run side by side: threads that wait for each other take several times the CPU time.
        os.environ.setdefault(name, "1")
    scores: list[Score] = []
    with ProcessPoolExecutor(options.processes, mp_context=get_context("spawn")) as pool:
        jobs = [pool.submit(score_case, options.seed, n, options.folder, options.keep) for n in numbers]
        for job in jobs:
            score = job.result()
            scores.append(score)
            if score.score not in _FINE or options.case:
                print(case_text(score), flush=True)
            if options.json is not None:
                # After each case, so that a stopped run keeps its results.
                options.json.write_text(json.dumps([asdict(each) for each in scores], indent=1) + "\n")
    print(score_table(scores))
    return 1 if any(score.score == SILENT for score in scores) else 0


def score_case(seed: int, number: int, folder: Path, keep: Path | None = None) -> Score:
    """Draw and judge one case; keep its files in the folder `keep`, if given."""
    flights = [kept_flight(recipe, folder) for recipe in RECIPES]
    return score_drawn(seed, number, flights, keep)


def score_drawn(seed: int, number: int, flights: Sequence[Flight], keep: Path | None = None) -> Score:
    """Judge one case of flights that were flown before; keep its files in the folder `keep`, if given."""
    case = draw_case(seed, number, RECIPES, flights)
    if keep is None:
        with tempfile.TemporaryDirectory() as temporary:
            return judge_import(case, Path(temporary))
    shutil.rmtree(keep / case.name, ignore_errors=True)
    return judge_import(case, keep / case.name)


def case_text(score: Score) -> str:
    """Describe a judged case, with the command that repeats it."""
    seed, number = score.name.split("-")
    return (
        f"{score.score.upper()}: {score.detail}\n"
        f"  {'; '.join(score.traits)}\n"
        f"  python -m heli_benchmark zoo --seed {seed} --case {number} --keep DIR\n"
    )


def score_table(scores: Sequence[Score]) -> str:
    """Count the scores."""
    counts = collections.Counter(score.score for score in scores)
    lines = [f"{counts[name]:5d}  {name}" for name in SCORES]
    share = sum(counts[name] for name in (RIGHT, CONFIRMED, REFUSED)) / max(1, len(scores))
    lines.append(
        f"{len(scores):5d}  cases; {100.0 * share:.0f} % right without a correction, or refused rightly"
    )
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
