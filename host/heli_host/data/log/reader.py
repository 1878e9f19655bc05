"""Reads logs, complete, cut short or damaged, into arrays: every tick of a whole chunk, never a wrong one.

Angles are computed from the exact counts, after the counts were compared with the logged angles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from heli_host.data.files import read_file
from heli_host.data.flight import OWN_COLUMNS, Flight, FlightEvent, check_flight
from heli_host.data.log.scan import MAX_LOG_BYTES, Scan
from heli_host.data.log.schema import TICK_TOPIC, MessageLayout, raw_ticks
from heli_host.data.log.table import read_csv
from heli_host.declaration import AXES, CHANNELS, Axis, ChannelSpec
from heli_host.errors import FlightDataError, LogError, TruncatedLog, file_remedy
from heli_host.link.channels import ENCODERS, is_whole, rad_per_count

_ROUNDING_SHARE = 2.0**-23
"""Largest rounding error of single precision, as a share of the value."""
_MAX_SHOWN_CHARACTERS = 24
"""Length to which a note shortens the text of a damaged parameter, which may contain anything."""
_BY_FIELD = {spec.field: spec for spec in CHANNELS}
_ANGLES = tuple(spec.column for spec in CHANNELS if spec.axis is not None)


@dataclass(frozen=True)
class Log:
    """Content of a log."""

    path: Path  # Path of the log
    ticks: NDArray[Any]  # (n,): One record per tick, with the fields of the schema in the log
    layout: MessageLayout
    events: tuple[dict[str, Any], ...]
    """Event messages in order of time: ``t_s``, ``tick``, ``name``, ``message``, ``level``."""
    link: tuple[dict[str, Any], ...]  # Link counters, about once per second
    metadata: Mapping[str, Mapping[str, str]]
    """Named records: ``session``, ``parameters``, ``plan``, ``result`` ...; the later of two values counts.
    """
    notes: tuple[str, ...]  # Defects of the file, such as a missing end or damaged chunks
    complete: bool  # Whether the log was closed

    @property
    def parameters(self) -> dict[str, float]:
        """The board's parameters by name; a damaged value raises `LogError`."""
        try:
            return {name: float(value) for name, value in self.metadata.get("parameters", {}).items()}
        except ValueError as error:
            raise LogError(
                f"{self.path} contains a parameter that is not a number", "copy it again"
            ) from error

    @property
    def law_signals(self) -> dict[str, str]:
        """Names that a control law gave to its signals, by channel; empty if no such law flew."""
        named = self.metadata.get("law", {})
        reserved_names = {*OWN_COLUMNS, *(spec.column for spec in CHANNELS)}
        return {
            channel: name
            for channel, name in named.items()
            if channel in _BY_FIELD and name.isidentifier() and name not in reserved_names
        }

    @property
    def raw(self) -> NDArray[np.int32]:
        """Telemetry channels exactly as the board sent them, shape (n, channels)."""
        return raw_ticks(self.ticks)

    @property
    def ticks_lost(self) -> int:
        """Ticks missing between the first and the last; a restart of the board does not count."""
        step = np.diff(self.ticks["tick"]).view(np.int32).astype(np.int64)
        return int(np.sum(step[step > 0] - 1))

    def flight(self) -> Flight:
        """Return the log as a flight."""
        ticks = self.ticks
        if len(ticks) == 0:
            raise TruncatedLog(
                f"{self.path} holds no ticks",
                "record again: the board sent nothing, or the host stopped immediately",
            )
        columns = self._columns_by_name()
        session = self.metadata.get("session", {})
        meta = {**session, **{f"result.{k}": v for k, v in self.metadata.get("result", {}).items()}}
        if self.notes:
            meta["notes"] = "\n".join(self.notes)
        if self.law_signals:
            meta["law_signals"] = ", ".join(self.law_signals.values())
        return Flight(
            t_s=np.ascontiguousarray(ticks["t_s"]),
            **{name: column for name, column in columns.items() if name in OWN_COLUMNS},
            extra={
                name: column.astype(np.float64) for name, column in columns.items() if name not in OWN_COLUMNS
            },
            state_names=self.layout.names("STATE"),
            fault_names=self.layout.names("FAULT"),
            events=tuple(
                FlightEvent(float(event["t_s"]), str(event["name"]), str(event["message"]))
                for event in self.events
            ),
            parameters=self.parameters,
            plan="\n".join(self.metadata.get("plan", {}).values()),
            meta=meta,
        )

    def _columns_by_name(self) -> dict[str, NDArray[Any]]:
        """Return each field except the times, in its unit, by its column name in tables; the counts of an
        encoder are included under the name of the field.
        """
        count_rad = rad_per_count(self.parameters)
        columns: dict[str, NDArray[Any]] = {}
        named = self.law_signals
        for field_name in self.ticks.dtype.names or ():
            spec = _BY_FIELD.get(field_name)
            if spec is not None:
                columns[named.get(spec.column, spec.column)] = self._channel_in_unit(spec, count_rad)
                if spec.axis is not None:
                    columns[spec.field] = self.ticks[field_name]
            elif field_name not in ("t_s", "tick", *_ANGLES):
                columns[field_name] = np.ascontiguousarray(self.ticks[field_name])
        return columns

    def _channel_in_unit(self, spec: ChannelSpec, count_rad: NDArray[np.float64]) -> NDArray[Any]:
        """Return a channel in its unit, shape (n,); an angle from its counts. Shapes: `count_rad` (3,)."""
        logged: NDArray[Any] = self.ticks[spec.field]
        if spec.axis is None and is_whole(spec):
            return np.ascontiguousarray(logged)
        if spec.axis is None:
            values = logged.astype(np.float64)
            exact = np.rint(values / spec.scale) * spec.scale
            # Single precision rounded the values; this restores them. A value further from the grid is from a
            # log with a finer scale, and stays.
            return np.where(np.abs(exact - values) <= _ROUNDING_SHARE * np.abs(values), exact, values)
        if np.isnan(count_rad[spec.axis]):
            return np.asarray(self.ticks[spec.column], np.float64)
        return np.asarray(logged * count_rad[spec.axis])


def read_log(path: str | Path) -> Log:
    """Read a log."""
    path = Path(path)
    try:
        data = read_file(path, MAX_LOG_BYTES)
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    magic = bytes(MCAP0_MAGIC)
    # A file that ends within the magic bytes counts as cut short, not as another format.
    if data[: len(magic)] != magic[: len(data)]:
        raise LogError(f"{path} is not an MCAP file", "give a log written by heli-host")
    scan = Scan(path, memoryview(data))
    scan.run()
    if scan.layout is None:
        raise _no_ticks_error(path, len(data), is_complete=scan.closed)
    ticks = np.concatenate(scan.ticks) if scan.ticks else np.zeros(0, scan.layout.dtype)
    notes = scan.notes
    for name in _damaged_encoder_parameters(ticks, scan.metadata.get("parameters", {})):
        damaged_text = scan.metadata["parameters"].pop(name)[:_MAX_SHOWN_CHARACTERS]
        notes.append(
            f"{name} {damaged_text} is damaged and was left out: it does not convert the logged counts to "
            "the logged angles"
        )
    return Log(
        path=path,
        ticks=ticks,
        layout=scan.layout,
        events=tuple(sorted(scan.events, key=lambda event: float(event["t_s"]))),
        link=tuple(scan.link),
        metadata=scan.metadata,
        notes=tuple(notes),
        complete=scan.closed,
    )


def _no_ticks_error(path: Path, size: int, *, is_complete: bool) -> LogError:
    """Return the error for a file of `size` bytes without a schema of ticks."""
    if is_complete:
        return LogError(
            f"{path} has no topic {TICK_TOPIC}",
            "give a log written by heli-host; this MCAP file is from another program",
        )
    return TruncatedLog(
        f"{path} is cut short within its first {size} bytes" if size else f"{path} is an empty file",
        "record the flight again: it contains no data",
    )


def _damaged_encoder_parameters(ticks: NDArray[Any], parameters: Mapping[str, str]) -> list[str]:
    """Return the names of encoder parameters that do not convert the counts to the logged angles."""
    names: list[str] = []
    for axis, channel in zip(Axis, ENCODERS, strict=True):
        spec = CHANNELS[channel]
        name = f"{AXES[axis]}_counts_per_rev"
        text = parameters.get(name)
        if text is None:
            continue
        try:
            count_rad = rad_per_count({name: float(text)})[axis]
        except ValueError:
            names.append(name)
            continue
        angles_rad = ticks[spec.column].astype(np.float64)
        error_rad = np.abs(ticks[spec.field] * count_rad - angles_rad)
        if not np.all((error_rad <= _ROUNDING_SHARE * np.abs(angles_rad)) | np.isnan(angles_rad)):
            names.append(name)
    return names


_ENDINGS = (".mcap", ".csv", ".csv.gz")


def read_flight(path: str | Path, *, allow_gaps: bool = False) -> Flight:
    """Read a log or a table.

    Parameters
    ----------
    path : str or Path
        ``.mcap`` (this package's logs, complete or cut short), ``.csv`` or ``.csv.gz`` (at least the
        columns ``t_s, front_V, back_V, elevation_rad, pitch_rad, travel_rad``; lines that start with
        ``#`` are notes).
    allow_gaps : bool
        Accept missing rows; `Flight.gaps` then gives their places.

    Raises
    ------
    FlightDataError
        If the table lacks a column, holds something that is not a number, does not rise in time, has a
        gap, is in degrees or milliseconds, or is too short. The message names the file, the column and
        the row.
    LogError
        If the log is not one of this package, or nothing of it can be read.
    """
    path = Path(path)
    name = path.name.lower()
    if name.endswith(".mcap"):
        flight = read_log(path).flight()
        check_flight(flight, str(path), allow_gaps=allow_gaps)
        return flight
    if name.endswith((".csv", ".csv.gz")):
        return read_csv(path, allow_gaps=allow_gaps)
    raise FlightDataError(*_cause_and_remedy(path))


def _cause_and_remedy(path: Path) -> tuple[str, str]:
    """What is wrong with a path that has no ending of a flight, and what to do."""
    if path.is_dir():
        flights = sorted(entry.name for entry in path.iterdir() if entry.name.endswith(_ENDINGS))
        example = f", such as {path / flights[0]}" if flights else ""
        return f"{path} is a folder, not a flight", f"give a file{example}"
    if not path.exists():
        existing_paths = [f"{path}{ending}" for ending in _ENDINGS if Path(f"{path}{ending}").exists()]
        return f"cannot read {path}: there is no such file", (
            f"did you mean {existing_paths[0]}?" if existing_paths else "check the path"
        )
    return f"{path} is not a flight", f"give a file that ends in {', '.join(_ENDINGS[:-1])} or {_ENDINGS[-1]}"
