"""Files that ``heli-host import`` writes: their names, their origin, and the lines of a profile."""

from __future__ import annotations

import contextlib
import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Final

from heli_host.data.flight import Flight
from heli_host.data.log.table import notes_path
from heli_host.errors import FlightDataError

_DIGEST_NOTE: Final = "digest"
"""Name of the note of a flight that holds the digest of its source."""
_DIGEST_LENGTH: Final = 12


def digest(paths: Sequence[Path]) -> str:
    """Digest the content of the files of one flight, `paths`; a folder counts with all its files."""
    digest_of_all = hashlib.sha256()
    for path in paths:
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.is_file():
                with file.open("rb") as opened:
                    digest_of_all.update(hashlib.file_digest(opened, "sha256").digest())
    return digest_of_all.hexdigest()[:_DIGEST_LENGTH]


def output_names(paths: Sequence[Path]) -> list[str]:
    """Name the flights of the files `paths`: by the file, and by its folder too if names are equal."""
    stems = [_stem(path) for path in paths]
    counts = Counter(stems)
    names = [
        f"{path.resolve().parent.name}-{stem}" if counts[stem] > 1 else stem
        for path, stem in zip(paths, stems, strict=True)
    ]
    first_paths: dict[str, Path] = {}
    for path, name in zip(paths, names, strict=True):
        other = first_paths.setdefault(name, path)
        if other is path:
            continue
        if other.resolve() == path.resolve():
            raise FlightDataError(f"{path} is given twice", "give each file once")
        raise FlightDataError(
            f"{other} and {path} would both be written to {name}.csv",
            "import them one after the other, each with its own --output",
        )
    return names


def _stem(path: Path) -> str:
    """Name of a file without its ending, and without ``.gz``."""
    return path.name.removesuffix(".gz").rpartition(".")[0] or path.name


@dataclass(frozen=True)
class Target:
    """Files into which the flights of one source are imported."""

    folder: Path  # Folder of the files
    name: str  # Name of the files, without number and ending
    sha: str  # Digest of the source, from `digest`

    def path(self, number: int | None) -> Path:
        """Path of the flight, or of its part with this `number`."""
        return self.folder / (f"{self.name}.csv" if number is None else f"{self.name}-{number}.csv")

    def with_digest(self, flight: Flight) -> Flight:
        """Return the flight with the digest of its source in its notes."""
        return replace(flight, meta={**flight.meta, _DIGEST_NOTE: self.sha})

    def refuse_to_replace_another(self) -> None:
        """Refuse to overwrite flights that were imported from another source."""
        for target in (self.path(None), self.path(1)):
            known = _digest_in(target)
            if known is not None and known != self.sha:
                raise FlightDataError(
                    f"{target} was imported from another file",
                    "give another folder with --output, or move that file",
                )


def _digest_in(path: Path) -> str | None:
    """Read the digest of its source from an imported flight at `path`."""
    try:
        # Tables of older versions hold their notes in their first lines.
        with path.open(encoding="utf-8", errors="replace") as file:
            lines = list(takewhile(lambda line: line.startswith("#"), file))
        with contextlib.suppress(FileNotFoundError):
            lines += notes_path(path).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return None
    for line in lines:
        key, _, value = line.lstrip("# ").partition(":")
        if key.strip() == _DIGEST_NOTE:
            return value.strip()
    return ""


def entry_lines(text: str) -> dict[str, int]:
    """Find the line of each entry in the `text` of a profile."""
    lines: dict[str, int] = {}
    section = ""
    for number, line in enumerate(text.splitlines(), 1):
        if line.startswith("["):
            section = line.strip("[] ") + "."
            # Entries with default values are not written; they belong below this line.
            defaults = ("sign", "unit", "column", "offset_deg", "offset_V", "delay_s", "clip_V")
            lines |= {f"{section}{name}": number for name in defaults}
        elif "=" in line and not line.startswith("#"):
            lines[section + line.partition("=")[0].strip()] = number
    return lines
