"""The results of a campaign in a folder: one JSON file per case, and a table with one row per case.

A killed campaign damages no result: each file is written under a temporary name and then renamed, so that it
is either complete or missing. The table is made again from the JSON files.
"""

from __future__ import annotations

import importlib.util
import json
import math
import secrets
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any, Final

from heli_host.errors import install_remedy

from heli_lab.apps.campaign.cases import Case, Cell, JobResult, natural_order
from heli_lab.errors import CampaignError

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
        self.cases = folder / "cases"
        token_file = folder / "store.txt"
        try:
            self.cases.mkdir(parents=True, exist_ok=True)
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
        with closing(sqlite3.connect(self.folder / "lock", timeout=0.0, check_same_thread=False)) as lock:
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

    def rows(self) -> list[dict[str, Any]]:
        """Read the rows of the table, one per result; a cell without a value is left out."""
        import pyarrow.parquet as pq

        rows = pq.read_table(self.folder / TABLE).to_pylist()
        return [{name: value for name, value in row.items() if value is not None} for row in rows]

    def write_table(self, rows: Iterable[Mapping[str, Cell]]) -> Path:
        """Write all `rows` into one table, sorted by names of cases; return its file."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        ordered = sorted(rows, key=lambda row: natural_order(str(row["case"])))
        names = dict.fromkeys(name for row in ordered for name in row)
        path = self.folder / TABLE
        with _appears_complete(path) as file:
            columns = {name: _column_values([row.get(name) for row in ordered]) for name in names}
            pq.write_table(pa.table(columns), file)
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
    if read_result(folder, result.key) is None:
        with _appears_complete(folder / f"{result.key}.json") as file:
            file.write_text(json.dumps(result.to_json(), indent=1))


def read_result(folder: Path, key: str) -> JobResult | None:
    """Read the result with the given `key` from the `folder` of results; None if there is none."""
    try:
        return JobResult.read(json.loads((folder / f"{key}.json").read_text()))
    except (OSError, ValueError, KeyError, TypeError):
        return None  # a missing or damaged file: the job runs again


@contextmanager
def _appears_complete(path: Path) -> Iterator[Path]:
    """Lend a temporary name in place of `path`, and rename the file when the block ends."""
    unfinished = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    yield unfinished
    unfinished.replace(path)


def _cell_of_setting(value: Any) -> Cell:
    """Format a setting as one cell: a list as its items, a table as JSON."""
    if value is None or isinstance(value, str | int | float | bool):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(str(item) for item in value)
    return json.dumps(value, sort_keys=True, default=str)


def _column_values(values: Sequence[Cell]) -> list[Cell]:
    """Make the values of a column equal in type: numbers stay numbers, other mixed types become texts."""
    # A number that is not finite, such as the settling time of a step that never settles, is left out.
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {int, float} and float in kinds:
        return [
            float(value) if isinstance(value, int | float) and math.isfinite(value) else None
            for value in values
        ]
    if len(kinds) > 1:
        return [None if value is None else str(value) for value in values]
    return list(values)
