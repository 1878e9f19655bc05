"""A table from any file that may hold a flight."""

from __future__ import annotations

from pathlib import Path

from heli_host.data.tables.table import Table
from heli_host.errors import FlightDataError

KINDS = (
    ".csv .txt .tsv .dat .lvm (.gz), .mat, .parquet, .mcap, .bag, .db3, .xlsx, or the folder of a ROS 2 bag"
)
"""Kinds of files that can be read, for messages."""


def read_table(path: Path) -> Table:
    """Read the file at `path`, of any kind of `KINDS`, as its name says."""
    name = path.name.lower().removesuffix(".gz")
    if path.is_dir() or name.endswith((".bag", ".db3", ".mcap")):
        from heli_host.data.tables.bags import read_bag

        return read_bag(path)
    if name.endswith(".mat"):
        from heli_host.data.tables.matlab import read_mat

        return read_mat(path)
    if name.endswith((".parquet", ".pq")):
        from heli_host.data.tables.frames import read_parquet

        return read_parquet(path)
    if name.endswith(".xlsx"):
        from heli_host.data.tables.frames import read_excel

        return read_excel(path)
    if name.endswith((".csv", ".txt", ".tsv", ".dat", ".log", ".asc", ".lvm")):
        from heli_host.data.tables.text import read_text

        return read_text(path)
    raise FlightDataError(f"{path}: this kind of file cannot be imported", f"give {KINDS}")
