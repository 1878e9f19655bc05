"""Result of each mutant, saved between runs, their table, and mutants that no test can notice."""

import json
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from tests.mutants.generate import ROOT, Mutant, mutants_of

DECLARED_TABLE: Final = Path(__file__).with_name("declared.toml")
_MIN_REASON: Final = 20


class DeclarationError(Exception):
    """A declaration has no reason, or names what is not there."""


@dataclass(frozen=True)
class Declaration:
    """One or several changes of a line that change nothing that anybody can notice."""

    file: str  # Relative to the repository
    line: str  # The source line without white space around it
    before: str  # What is replaced
    after: tuple[str, ...]  # Its replacements
    reason: str  # Why nothing can notice
    occurrence: int = 0  # How many equal lines come before it in the file
    column: int | None = None  # Column of the change; needed where the line permits the same change twice

    def covers(self, mutant: Mutant) -> bool:
        """Whether a mutant is declared by this."""
        place = (mutant.file, mutant.source_line, mutant.occurrence)
        at_column = self.column is None or self.column == mutant.column
        return (
            place == (self.file, self.line, self.occurrence)
            and at_column
            and _plain(mutant.before) == _plain(self.before)
            and _plain(mutant.after) in map(_plain, self.after)
        )


def read_declarations(path: Path = DECLARED_TABLE) -> list[Declaration]:
    """All declarations; a DeclarationError names the first that does not hold."""
    entries = tomllib.loads(path.read_text(encoding="utf-8")).get("equivalent", [])
    declarations = [
        Declaration(
            file=entry["file"],
            line=entry["line"],
            before=entry["before"],
            after=tuple(entry["after"]),
            reason=entry.get("reason", ""),
            occurrence=entry.get("occurrence", 0),
            column=entry.get("column"),
        )
        for entry in entries
    ]
    by_file: dict[str, list[Declaration]] = defaultdict(list)
    for declaration in declarations:
        by_file[declaration.file].append(declaration)
    for file, of_file in by_file.items():
        source = ROOT / file
        mutants = mutants_of(file, source.read_text(encoding="utf-8")) if source.is_file() else []
        for declaration in of_file:
            _check(declaration, mutants)
    return declarations


def _check(declaration: Declaration, mutants: list[Mutant]) -> None:
    place = f"{DECLARED_TABLE.name}: {declaration.file}: {declaration.line}"
    if len(declaration.reason) < _MIN_REASON:
        raise DeclarationError(f"{place}: the reason is missing; say why no test can notice the change")
    covered = [mutant for mutant in mutants if declaration.covers(mutant)]
    if len({mutant.column for mutant in covered}) > 1:
        columns = sorted({mutant.column for mutant in covered})
        raise DeclarationError(
            f"{place}: {declaration.before} is there more than once; give a column of {columns}"
        )
    known = {_plain(mutant.after) for mutant in covered}
    unknown = [after for after in declaration.after if _plain(after) not in known]
    if unknown:
        raise DeclarationError(
            f"{place}: no mutant changes {declaration.before} to {unknown[0]} there; "
            "correct or remove the entry"
        )


def declared(mutant: Mutant, declarations: Iterable[Declaration]) -> Declaration | None:
    """The declaration that covers a mutant."""
    return next((d for d in declarations if d.covers(mutant)), None)


def _plain(text: str) -> str:
    return " ".join(text.split())


KILLED: Final = ("failed", "timeout", "crashed", "static_assert")
SURVIVED: Final = ("survived", "unreached")
LEFT_OUT: Final = ("invalid", "same code")
"""No program, or the same program: such a mutant does not count."""
DECLARED: Final = "declared"


@dataclass(frozen=True)
class Result:
    """Result of a mutant."""

    identity: str  # Which mutant, and how a person finds it
    file: str  # Which mutant, and how a person finds it
    text: str  # Which mutant, and how a person finds it
    outcome: str  # One of the words above
    by: str  # The test that killed it, or the reason of its declaration
    spent_s: float  # CPU time of its tests
    sources: str  # Digests of the sources and of the tests that it was found with
    tests: str  # Digests of the sources and of the tests that it was found with


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
        """A result that still holds."""
        # That of a killed mutant holds as long as the sources are the same, that of a survivor as long as the
        # tests are the same, too.
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
