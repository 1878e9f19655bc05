"""Reading of a flight from a log or a table."""

from __future__ import annotations

from pathlib import Path

from heli_host.data.flight import Flight, check
from heli_host.data.log.reader import read_log
from heli_host.data.log.table import read_csv
from heli_host.errors import FlightDataError

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
        check(flight, str(path), allow_gaps=allow_gaps)
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
