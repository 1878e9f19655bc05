"""Mutants that no test can notice, each with the reason: ``declared.toml``."""

from __future__ import annotations

import tomllib
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from tests.mutants.generate import ROOT, Mutant, mutants_of

TABLE: Final = Path(__file__).with_name("declared.toml")
_MIN_REASON: Final = 20


class DeclarationError(Exception):
    """A declaration has no reason, or names what is not there."""


@dataclass(frozen=True)
class Declaration:
    """One or several changes of a line that change nothing that anybody can notice.

    Parameters
    ----------
    file : str
        Relative to the repository.
    line : str
        The source line without white space around it.
    before : str
        What is replaced.
    after : tuple of str
        Its replacements.
    reason : str
        Why nothing can notice.
    occurrence : int
        How many equal lines come before it in the file.
    column : int, optional
        Column of the change; needed where the line permits the same change twice.
    """

    file: str
    line: str
    before: str
    after: tuple[str, ...]
    reason: str
    occurrence: int = 0
    column: int | None = None

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


def read_declarations(path: Path = TABLE) -> list[Declaration]:
    """All declarations; a DeclarationError names the first that does not hold.

    Raises
    ------
    DeclarationError
        A line or a change is not in its file, or a reason is missing.
    """
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
    place = f"{TABLE.name}: {declaration.file}: {declaration.line}"
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
