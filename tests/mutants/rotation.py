"""Mutants with the test that must notice each; the ordinary suite repeats a few of them.

``killed.json`` lists generated mutants that a test killed; ``mistakes.toml`` those that people chose, most of
them in the drivers. Each runs against its test only: this needs no coverage map, which costs a minute of CPU.
The sources decide which run: every change of the firmware is tried with others.
"""

import json
import sys
import tempfile
import tomllib
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Final

from tests.mutants import session
from tests.mutants.build_core import FOLDER, CoreBench
from tests.mutants.build_due import DueBench
from tests.mutants.generate import BUILD, ROOT, Mutant, mutants_of, sample
from tests.mutants.results import Result

KILLED_TABLE: Final = Path(__file__).with_name("killed.json")
MISTAKES_TABLE: Final = Path(__file__).with_name("mistakes.toml")
_LIMIT_s: Final = {FOLDER: 5.0, "": 60.0}
"""CPU time that a test may take here, and on the emulated Due; those of the tables take less than a tenth."""
_REAL_s: Final = 300.0
_CHEAP_s: Final = 1.5
"""CPU time of a killed mutant above which the suite does not repeat it."""


def record(chosen: Iterable[Mutant], results: Iterable[Result]) -> None:
    """Add the mutants that a test killed cheaply to the table."""
    known = read_killed()
    by_identity = {result.identity: result for result in results}
    for mutant in chosen:
        result = by_identity.get(mutant.identity)
        cheap = result is not None and result.outcome == "failed" and result.spent_s < _CHEAP_s
        if result is not None and cheap and mutant.file.startswith(FOLDER) and mutant.file.endswith(".cpp"):
            known.setdefault(mutant.file, {})[mutant.identity] = result.by
    text = json.dumps({file: dict(sorted(of.items())) for file, of in sorted(known.items())}, indent=1)
    KILLED_TABLE.write_text(text + "\n", encoding="utf-8")


def read_killed() -> dict[str, dict[str, str]]:
    """By file, by identity: the test that killed a mutant."""
    table: dict[str, dict[str, str]] = json.loads(KILLED_TABLE.read_text(encoding="utf-8"))
    return table


def killed(count: int, seed: str) -> list[tuple[Mutant, str]]:
    """So many mutants of ``killed.json`` whose line and test are still there, and the test of each."""
    by_file: dict[str, dict[str, str]] = defaultdict(dict, read_killed())
    mutants = [
        mutant
        for file, identities in by_file.items()
        if (ROOT / file).is_file()
        for mutant in mutants_of(file, (ROOT / file).read_text(encoding="utf-8"))
        if exists(identities.get(mutant.identity, ""))
    ]
    return [(mutant, by_file[mutant.file][mutant.identity]) for mutant in sample(mutants, seed, count)]


def mistakes(count: int | None, seed: str) -> list[tuple[Mutant, str]]:
    """So many mistakes of ``mistakes.toml`` and the test of each, at least one of each file; None: all."""
    # A ValueError names a text that a file does not have exactly once.
    rows: dict[Mutant, str] = {}
    for entry in tomllib.loads(MISTAKES_TABLE.read_text(encoding="utf-8"))["mistake"]:
        text = (ROOT / entry["file"]).read_text(encoding="utf-8")
        for before, after in entry["changes"]:
            mutant = _mistake(entry["file"], text, before, after)
            rows[mutant] = entry["test"]
    if count is None:
        return list(rows.items())
    drawn = sample(list(rows), seed, None)
    first_of_files = {mutant.file: mutant for mutant in reversed(drawn)}
    others = [mutant for mutant in drawn if mutant not in first_of_files.values()]
    chosen = [*first_of_files.values(), *others][: max(count, len(first_of_files))]
    return [(mutant, rows[mutant]) for mutant in chosen]


def exists(test: str) -> bool:
    """Whether a test is still there; without it, pytest would fail as if the mutant had been noticed."""
    file, _, name = test.partition("::")
    path = ROOT / file
    return (
        bool(name) and path.is_file() and f"def {name.partition('[')[0]}(" in path.read_text(encoding="utf-8")
    )


def _mistake(file: str, text: str, before: str, after: str) -> Mutant:
    if text.count(before) != 1:
        raise ValueError(f"{MISTAKES_TABLE.name}: {file} has {text.count(before)} of {before!r}; correct it")
    start = text.index(before)
    line = text.count("\n", 0, start) + 1
    last_line = line + before.count("\n")
    source_line = text.splitlines()[line - 1].strip()
    return Mutant(
        file=file,
        line=line,
        last_line=last_line,
        source_line=source_line,
        occurrence=0,
        column=0,
        kind="mistake",
        before=before,
        after=after,
        start=start,
    )


def repeat(rows: Iterable[tuple[Mutant, str]], on_due: bool) -> int:
    """Run each mutant against its test, and print the outcome; 1 if a test does not notice its mutant."""
    session.preload()
    BUILD.mkdir(parents=True, exist_ok=True)
    survived = 0
    with tempfile.TemporaryDirectory(prefix="repeat-", dir=BUILD) as work:
        bench = (DueBench if on_due else CoreBench)(Path(work), [])
        for mutant, test in rows:
            limit_s = _LIMIT_s["" if on_due else FOLDER]
            outcome = session.run_tests(bench.build(mutant), {test: limit_s}, _REAL_s)
            print(f"{outcome.reason or 'survived'} {mutant}  ({test})", flush=True)
            if not outcome.killed_by:
                survived += 1
                print(
                    f"error: {test} does not notice {mutant}; correct the test or the table", file=sys.stderr
                )
    return int(survived > 0)
