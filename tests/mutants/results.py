"""Result of each mutant, saved between runs, and their table."""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

KILLED: Final = ("failed", "timeout", "crashed", "static_assert")
SURVIVED: Final = ("survived", "unreached")
LEFT_OUT: Final = ("invalid", "same code")
"""No program, or the same program: such a mutant does not count."""
DECLARED: Final = "declared"


@dataclass(frozen=True)
class Result:
    """Result of a mutant.

    Parameters
    ----------
    identity, file, text : str
        Which mutant, and how a person finds it.
    outcome : str
        One of the words above.
    by : str
        The test that killed it, or the reason of its declaration.
    spent_s : float
        CPU time of its tests.
    sources, tests : str
        Digests of the sources and of the tests that it was found with.
    """

    identity: str
    file: str
    text: str
    outcome: str
    by: str
    spent_s: float
    sources: str
    tests: str


class Results:
    """Results in a file of the build folder; a line each, so that a run that is stopped loses none."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[str, Result] = {}
        if path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                result = Result(**json.loads(line))
                self._known[result.identity] = result

    def known(self, identity: str, sources: str, tests: str) -> Result | None:
        """A result that still holds.

        That of a killed mutant holds as long as the sources are the same, that of a survivor as long as the
        tests are the same, too.
        """
        result = self._known.get(identity)
        if result is None or result.sources != sources:
            return None
        holds = result.outcome in (*KILLED, *LEFT_OUT) or result.tests == tests
        return result if holds else None

    def add(self, result: Result) -> None:
        """Keep a result."""
        self._known[result.identity] = result
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(result)) + "\n")


def table(results: Iterable[Result]) -> str:
    """Killed, declared and survived per file, then every survivor."""
    by_file: dict[str, Counter[str]] = defaultdict(Counter)
    every = list(results)
    for result in every:
        by_file[result.file][kind_of(result)] += 1
    total: Counter[str] = sum(by_file.values(), Counter())
    rows = [f"{'file':<48}{'killed':>8}{'declared':>10}{'survived':>10}"]
    rows += [_row(file, counts) for file, counts in sorted(by_file.items())]
    rows += [_row("all", total)]
    left_out = total["left out"]
    if left_out:
        rows += [f"not counted: {left_out} that do not compile or compile to the same code"]
    counted = sum(total[kind] for kind in ("killed", "declared", "survived"))
    if counted:
        share = (total["killed"] + total["declared"]) / counted
        rows += [f"killed or declared: {100 * share:.1f} % of {counted}"]
    survivors = [result for result in every if result.outcome in SURVIVED]
    rows += [f"{result.outcome}: {result.text}  [{result.identity}]" for result in survivors]
    return "\n".join(rows)


def kind_of(result: Result) -> str:
    """``killed``, ``declared``, ``survived`` or ``left out``."""
    if result.outcome in KILLED:
        return "killed"
    if result.outcome in SURVIVED:
        return "survived"
    return "declared" if result.outcome == DECLARED else "left out"


def _row(name: str, counts: Counter[str]) -> str:
    return f"{name:<48}{counts['killed']:>8}{counts['declared']:>10}{counts['survived']:>10}"
