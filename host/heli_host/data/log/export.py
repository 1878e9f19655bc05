"""Flights for other programs: MATLAB, Parquet; `heli_host.data.log.table` writes the tables."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from heli_host.data.flight import Flight
from heli_host.errors import LogWriteError, install_remedy
from heli_host.output_files import WRITER, replacing, write_bytes


def export_mat(flight: Flight, path: str | Path) -> None:
    """Write a MATLAB file (version 5): a column vector per column, a struct of parameters, plan and notes."""
    from scipy.io import savemat

    content: dict[str, object] = {
        name: column.astype(np.float64) for name, column in flight.columns().items() if len(name) <= _MAT_NAME
    }
    content["parameters"] = {
        name: value for name, value in flight.parameters.items() if len(name) <= _MAT_NAME
    }
    content["plan"] = flight.plan
    content["notes"] = "\n".join(f"{name}: {value}" for name, value in flight.meta.items())
    content["events"] = "\n".join(f"{event.t_s:.3f} s {event.name}: {event.text}" for event in flight.events)
    buffer = io.BytesIO()
    savemat(buffer, content, do_compression=True, oned_as="column")
    # The first 116 bytes contain the date. Without the date, the same flight gives the same bytes.
    data = b"MATLAB 5.0 MAT-file, written by heli_host".ljust(116) + buffer.getvalue()[116:]
    try:
        write_bytes(path, data)
    except OSError as error:
        raise LogWriteError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error


def export_parquet(flight: Flight, path: str | Path) -> None:
    """Write a Parquet file: one column each, with parameters, plan and notes in its metadata."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError as error:
        raise LogWriteError("writing Parquet needs pyarrow", install_remedy("export")) from error
    table = pyarrow.table({name: np.ascontiguousarray(column) for name, column in flight.columns().items()})
    notes = {f"parameter.{name}": repr(value) for name, value in flight.parameters.items()}
    notes |= {"plan": flight.plan, **flight.meta, "writer": WRITER}
    table = table.replace_schema_metadata(notes)
    try:
        with replacing(path) as unfinished:
            pyarrow.parquet.write_table(table, str(unfinished))
    except OSError as error:
        raise LogWriteError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error


_MAT_NAME = 63
"""Longest name that MATLAB takes."""
