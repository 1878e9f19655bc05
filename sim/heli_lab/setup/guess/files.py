"""Merge the files of one flight, and name the files that an import writes."""

from __future__ import annotations

import contextlib
import hashlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Final

from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.table import notes_path
from heli_host.data.tables import Column, Table
from heli_host.data.tables.rows import timed_rows
from heli_host.errors import FlightDataError

from heli_lab.setup.guess.signals import Clock, clock_of

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
            continue  # the first file of this name
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


def merge_tables(tables: Sequence[Table]) -> Table:
    """Merge the columns of several files of one flight, by their times or by their rows.

    A file without times is merged row by row with a file that has times and as many rows. Without any
    times, all files must have equally many rows.

    Parameters
    ----------
    tables : sequence of Table
        The files. All times start at the same moment.

    Returns
    -------
    Table
        Has the name of the first file; each column's name starts with the position of its file, as in
        ``1: time``. The notes state which files were merged row by row.

    Raises
    ------
    FlightDataError
        When a file has neither times nor as many rows as another one.
    """
    clocks = [clock_of(table.aligned()) for table in tables]
    timed = [_timed(table.aligned(), clock) for table, clock in zip(tables, clocks, strict=True)]
    aligned = [table for table, _ in timed]
    times_s = [t_s for _, t_s in timed]
    notes = [table.notes for table in tables]
    columns: dict[str, Column] = {}
    for number, table in enumerate(aligned):
        t_s = times_s[number]
        has_times = t_s is not None
        if t_s is None:
            partner = _merge_partner(number, aligned, times_s)
            t_s = times_s[partner]
            notes.append(
                f"{_file_name(tables[number])} was merged row by row with {_file_name(tables[partner])}"
            )
        for name, column in table.columns.items():
            if not has_times or name != clocks[number].column:
                # The position, not the file's name, so that the profile also fits the next flight.
                columns[f"{number + 1}: {name}"] = Column(column.values, column.unit, t_s)
    changes = tuple(change for table in aligned for change in table.changes)
    return Table(tables[0].source, columns, " / ".join(filter(None, notes)), changes=changes)


def _timed(table: Table, clock: Clock) -> tuple[Table, Floats | None]:
    """Return the rows of a table in the order of its clock, with their times [s]; None if it has no clock."""
    if not clock.column or not clock.unit:
        return table, None
    timed = timed_rows(table, clock.column, clock.unit)
    return timed.table, timed.t_s


def _merge_partner(number: int, tables: Sequence[Table], times_s: Sequence[Floats | None]) -> int:
    """Find the file with which a file without times is merged row by row; both are positions in `tables`.
    Shapes: `times_s` (n,).
    """
    rows = len(tables[number])
    no_file_has_times = all(t_s is None for t_s in times_s)
    for other, table in enumerate(tables):
        is_usable = times_s[other] is not None or no_file_has_times
        if other != number and is_usable and len(table) == rows:
            return other
    sizes = ", ".join(f"{_file_name(table)} with {len(table)}" for table in tables)
    raise FlightDataError(
        f"{_file_name(tables[number])}: it has no times, and no other file with times has its {rows} rows "
        f"({sizes})",
        "log the times with each file of one flight, or cut the files to equal lengths",
    )


def _file_name(table: Table) -> str:
    """Name of the file of a table."""
    return Path(table.source).name
