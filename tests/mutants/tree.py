"""A copy of the firmware's sources in which one file at a time has a mutant, and what includes that file."""

from __future__ import annotations

import contextlib
import hashlib
import re
import shutil
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Final

from tests.mutants.generate import ROOT, Mutant

BUILD: Final = ROOT / "build" / "mutants"
_INCLUDE: Final = re.compile(r'^\s*#\s*include\s*"([^"]+)"', re.MULTILINE)


class BuildError(Exception):
    """The compiler or the linker refuses what it is given."""


class Tree:
    """A copy of ``firmware/core`` and ``firmware/due``.

    Parameters
    ----------
    folder : Path
        Where the copy is made.
    others : tuple of str
        Further folders of the repository whose sources include the copied ones; these are not copied.
    """

    def __init__(self, folder: Path, others: tuple[str, ...] = ()) -> None:
        self.folder = folder
        self._others = others
        shutil.rmtree(folder, ignore_errors=True)
        for part in ("core", "due"):
            shutil.copytree(ROOT / "firmware" / part, folder / "firmware" / part)

    @contextlib.contextmanager
    def holding(self, mutant: Mutant) -> Iterator[None]:
        """The tree with a mutant in it, until the end of the block."""
        path = self.folder / mutant.file
        text = path.read_text(encoding="utf-8")
        path.write_text(mutant.apply(text), encoding="utf-8")
        try:
            yield
        finally:
            path.write_text(text, encoding="utf-8")

    def path(self, source: str) -> Path:
        """Where a source is that is compiled: copied ones in the tree, others in the repository."""
        copied = self.folder / source
        return copied if copied.exists() else ROOT / source

    def dependents(self, file: str) -> list[str]:
        """Sources that have to be compiled again when a file changes."""
        return [
            source for source in self.includes if source.endswith(".cpp") and file in self._closure(source)
        ]

    @cached_property
    def includes(self) -> dict[str, set[str]]:
        """Which files of the repository each source includes itself."""
        folders = ("firmware/core", "firmware/due", *self._others)
        paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.[ch]pp"))]
        names = {path.relative_to(ROOT).as_posix() for path in paths}
        includes: dict[str, set[str]] = {}
        for name in names:
            places = [Path(name).parent.as_posix(), *folders]
            included = _INCLUDE.findall((ROOT / name).read_text(encoding="utf-8"))
            includes[name] = {p for part in included for p in (f"{at}/{part}" for at in places) if p in names}
        return includes

    def _closure(self, source: str) -> set[str]:
        seen, waiting = {source}, [source]
        while waiting:
            new = self.includes[waiting.pop()] - seen
            seen |= new
            waiting += new
        return seen


def digest(*folders: str) -> str:
    """Digest of the sources, tests and tables of folders or files."""
    content = hashlib.sha256()
    for folder in folders:
        place = ROOT / folder
        paths = [place] if place.is_file() else sorted(path for path in place.rglob("*") if path.is_file())
        for path in paths:
            if path.suffix != ".pyc":
                content.update(path.relative_to(ROOT).as_posix().encode())
                content.update(path.read_bytes())
    return content.hexdigest()[:16]
