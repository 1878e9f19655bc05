"""Store the results of a campaign on disk: one JSON file per case, and a table with one row per case.

If the campaign is killed, neither is damaged. The JSON files are authoritative: each is written under a
temporary name and then renamed, so that a file is either complete or missing. Rows of the table are written
in parts, in the same manner. A row that was not written before a kill is made again from its JSON file. At
the end, the parts become one file.
"""

from __future__ import annotations

import importlib.util
import json
import math
import secrets
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import install_remedy

from heli_lab.apps.campaign.case import Case, Cell, JobResult, natural_order
from heli_lab.errors import CampaignError

if TYPE_CHECKING:
    import pyarrow as pa

STORED_PACKAGES: Final = ("distributed", "pyarrow")
"""Packages of the extra ``campaign`` that the other parts of the laboratory do not need."""
TABLE: Final = "cases.parquet"
RESULT_COLUMNS: Final = ("failure", "cpu_s", "seconds", "where", "key")
"""Columns that every case has in addition to its name, its settings and the results of its work."""


class Store:
    """The results of a campaign in a folder.

    Parameters
    ----------
    folder : Path
        The folder; it is created if it is missing.

    Raises
    ------
    CampaignError
        When a package of the extra ``campaign`` is not installed, or the folder cannot be written.

    Attributes
    ----------
    token : str
        Random text in the folder's ``store.txt``, by which a worker recognises that it sees the same folder.
    """

    def __init__(self, folder: Path) -> None:
        _check_packages()
        self.folder = folder
        self.cases, self._parts = folder / "cases", folder / "parts"
        try:
            for subfolder in (self.cases, self._parts):
                subfolder.mkdir(parents=True, exist_ok=True)
            token_file = folder / "store.txt"
            if not token_file.exists():
                with _appears_complete(token_file) as file:
                    file.write_text(secrets.token_hex(16))
            self.token = token_file.read_text()
        except OSError as error:
            raise CampaignError(
                f"results cannot be saved in {folder}: {error.strerror}", "give another --output"
            ) from None

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Lock the folder against other campaigns until the block ends.

        Raises
        ------
        CampaignError
            When another campaign has locked it.
        """
        # SQLite's locks exist on every system, and end with the process that holds them.
        with closing(sqlite3.connect(self.folder / "lock", timeout=0.0)) as lock:
            try:
                lock.execute("BEGIN EXCLUSIVE")
            except sqlite3.Error:
                raise CampaignError(
                    f"another campaign is writing to {self.folder}", "wait for it, or give another --output"
                ) from None
            yield

    def path(self, key: str) -> Path:
        """Return the file of the result with the given `key`."""
        return self.cases / f"{key}.json"

    def write(self, result: JobResult) -> None:
        """Write a result, unless it is stored already."""
        write_result(self.cases, result)

    def remove(self, keys: Iterable[str]) -> None:
        """Remove the results with the given `keys`."""
        for key in keys:
            self.path(key).unlink(missing_ok=True)

    def read(self, keys: Iterable[str]) -> dict[str, JobResult]:
        """Read the stored results with the given `keys`; results that are unreadable are left out."""
        stored = {path.stem for path in self.cases.glob("*.json")}
        results = {key: read_result(self.cases, key) for key in keys if key in stored}
        return {key: result for key, result in results.items() if result is not None}

    def append(self, rows: Sequence[Mapping[str, Cell]]) -> None:
        """Append `rows` to the table, as a separate file."""
        if rows:
            _write_parquet(self._parts / f"{secrets.token_hex(8)}.parquet", rows)

    def rows(self) -> list[dict[str, Any]]:
        """Read all rows of the table and its parts, one per result."""
        import pyarrow.parquet as pq

        rows: dict[str, dict[str, Any]] = {}
        for path in (self.folder / TABLE, *sorted(self._parts.glob("*.parquet"))):
            with suppress(FileNotFoundError):
                for row in pq.read_table(path).to_pylist():
                    rows[row["key"]] = {name: value for name, value in row.items() if value is not None}
        return list(rows.values())

    def write_table(self, rows: Iterable[Mapping[str, Cell]]) -> Path:
        """Write all `rows` into one table, sorted by names of cases, and remove the parts; return its
        file.
        """
        path = self.folder / TABLE
        _write_parquet(path, sorted(rows, key=lambda row: natural_order(str(row["case"]))))
        for part in self._parts.glob("*.parquet"):
            part.unlink()
        return path


def _check_packages() -> None:
    """Raise a CampaignError, before any case is run, if a package of the extra ``campaign`` is missing."""
    for name in STORED_PACKAGES:
        try:
            spec = importlib.util.find_spec(name)
        except ValueError:
            # The module was imported without a specification, as a replaced one may be.
            spec = None
        if spec is None:
            raise CampaignError(
                f"a campaign needs the Python package {name}, which is not installed",
                install_remedy("campaign"),
            )


def row_of(case: Case, result: JobResult) -> dict[str, Cell]:
    """Return the row of a case: its name, its settings, the values from its work, and its CPU time."""
    settings = {name: _cell_of_setting(value) for name, value in case.settings.items()}
    fields = {name: getattr(result, name) for name in RESULT_COLUMNS}
    return {"case": case.name, **settings, **result.row, **fields}


def write_result(folder: Path, result: JobResult) -> None:
    """Write a result into the `folder` of results as JSON, completely or not at all, unless it is stored."""
    path = folder / f"{result.key}.json"
    if read_result(folder, result.key) is None:
        with _appears_complete(path) as file:
            file.write_text(json.dumps(result.to_json(), indent=1))


def read_result(folder: Path, key: str) -> JobResult | None:
    """Read the result with the given `key` from the `folder` of results; None if there is none."""
    try:
        return JobResult.read(json.loads((folder / f"{key}.json").read_text()))
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _cell_of_setting(value: Any) -> Cell:
    """Format a setting as one cell: a list as its items, a table as JSON."""
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(str(item) for item in value)
    return json.dumps(value, sort_keys=True, default=str)


@contextmanager
def _appears_complete(path: Path) -> Iterator[Path]:
    """Lend a temporary name in place of `path`, and rename the file when the block ends.

    Under its own name, the file is thus always complete.
    """
    unfinished = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    yield unfinished
    unfinished.replace(path)


def _write_parquet(path: Path, rows: Sequence[Mapping[str, Cell]]) -> None:
    """Write rows as a table, completely or not at all."""
    import pyarrow.parquet as pq

    with _appears_complete(path) as file:
        pq.write_table(_arrow_table(rows), file)


def _arrow_table(rows: Sequence[Mapping[str, Cell]]) -> pa.Table:
    """Convert `rows` to a table with all their columns; a column of mixed types holds texts."""
    import pyarrow as pa

    columns: dict[str, list[Cell]] = {}
    for name in dict.fromkeys(name for row in rows for name in row):
        values = [row.get(name) for row in rows]
        kinds = {type(value) for value in values if value is not None}
        if kinds <= {int, float} and float in kinds:
            # A number that is not finite, such as the settling time of a step that never settles, is left
            # out.
            values = [
                float(value) if isinstance(value, int | float) and math.isfinite(value) else None
                for value in values
            ]
        elif len(kinds) > 1:
            values = [None if value is None else str(value) for value in values]
        columns[name] = values
    return pa.table(columns)
