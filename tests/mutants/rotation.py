"""Mutants that were killed once, and by which test; the ordinary suite repeats a few of them.

Each runs against that test only: this needs no coverage map, which costs a minute of CPU. The sources
decide which run: every change of the flight code is tried with others.
"""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from tests.mutants import session
from tests.mutants.bench_core import FOLDER, SOURCES, CoreBench
from tests.mutants.generate import ROOT, Mutant, mutants_of, sample
from tests.mutants.results import Result
from tests.mutants.tree import BUILD, digest

TABLE: Final = Path(__file__).with_name("killed.json")
_LIMIT_s: Final = 5.0
"""CPU time that a test may take; those of the table take less than a tenth of it."""
_REAL_s: Final = 120.0
_CHEAP_s: Final = 1.5
"""CPU time of a killed mutant above which the suite does not repeat it."""


def record(chosen: Iterable[Mutant], results: Iterable[Result]) -> None:
    """Add the mutants that a test killed cheaply to the table."""
    known = read()
    by_identity = {result.identity: result for result in results}
    for mutant in chosen:
        result = by_identity.get(mutant.identity)
        cheap = result is not None and result.outcome == "failed" and result.spent_s < _CHEAP_s
        if result is not None and cheap and mutant.file.startswith(FOLDER) and mutant.file.endswith(".cpp"):
            known.setdefault(mutant.file, {})[mutant.identity] = result.by
    text = json.dumps({file: dict(sorted(of.items())) for file, of in sorted(known.items())}, indent=1)
    TABLE.write_text(text + "\n", encoding="utf-8")


def read() -> dict[str, dict[str, str]]:
    """By file, by identity: the test that killed a mutant."""
    if not TABLE.exists():
        return {}
    table: dict[str, dict[str, str]] = json.loads(TABLE.read_text(encoding="utf-8"))
    return table


def rotating(count: int, seed: str) -> list[tuple[Mutant, str]]:
    """So many mutants of the table that the sources still have, and the test of each."""
    by_file: dict[str, dict[str, str]] = defaultdict(dict, read())
    mutants = [
        mutant
        for file, killed in by_file.items()
        if (ROOT / file).is_file()
        for mutant in mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))
        if mutant.identity in killed
    ]
    return [(mutant, by_file[mutant.file][mutant.identity]) for mutant in sample(mutants, seed, count)]


def run(count: int, seed: str) -> int:
    """Repeat so many mutants; 1 if a test does not notice its mutant any more."""
    session.preload()
    bench = CoreBench(BUILD / f"rotating-{digest(*SOURCES)[:8]}", [])
    survived = 0
    for mutant, test in rotating(count, seed):
        outcome = session.run_tests(bench.build(mutant), {test: _LIMIT_s}, _REAL_s)
        print(f"{outcome.reason or 'survived'} {mutant}  ({test})", flush=True)
        if not outcome.killed_by:
            survived += 1
            print(
                f"error: {test} does not notice {mutant}; run make mutants FILES={mutant.file}",
                file=sys.stderr,
            )
    return int(survived > 0)
