"""Torques or angles of the three axes along a validation flight, as they are stored in JSON files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_benchmark.errors import BenchmarkError

_AXES: Final = ("elevation", "pitch", "travel")
_FLIGHT: Final = re.compile(r"validation-[1-9]\d?")
_MIN_ROWS, _MAX_ROWS = 2, 100_000


@dataclass(frozen=True, eq=False)
class AxisSeries:
    """Numbers of the three axes over time."""

    t_s: Floats  # (n,): Times on the clock of the flight, rising
    values: Floats  # (n, 3): Elevation, pitch and travel

    def at(self, t_s: Floats) -> Floats:
        """Interpolate at other times, shape (m, 3); NaN outside of the times of the series. Shapes: `t_s`
        (m,).
        """
        columns = [np.interp(t_s, self.t_s, column, np.nan, np.nan) for column in self.values.T]
        return np.stack(columns, axis=1)


def flight_name(number: int) -> str:
    """Return the name of a validation flight."""
    return f"validation-{number + 1}"


def read_series(content: object, unit: str, where: str) -> dict[str, AxisSeries]:
    """Check and convert series by flight."""
    keys = ["t_s", *(f"{axis}_{unit}" for axis in _AXES)]
    if not isinstance(content, Mapping):
        raise BenchmarkError(f"{where} is not an object", "give one entry per validation flight")
    series = {}
    for name, columns in content.items():
        if not _FLIGHT.fullmatch(str(name)):
            raise BenchmarkError(
                f"{where}: unknown flight '{name}'", "name the flights validation-1 and so on"
            )
        if not isinstance(columns, Mapping) or set(columns) != set(keys):
            raise BenchmarkError(f"{where}: {name} has other keys", f"give {', '.join(keys)}")
        series[str(name)] = _checked_series([columns[key] for key in keys], f"{where}: {name}")
    return series


def _checked_series(lists: list[Any], where: str) -> AxisSeries:
    """Check and convert the lists of times, elevation, pitch and travel; `where` names them in messages."""
    remedy = f"give four lists of {_MIN_ROWS} to {_MAX_ROWS} finite numbers, with rising times"
    try:
        # Below, the type of the array shows text, truth values and nested lists.
        columns = [np.array(numbers) for numbers in lists if isinstance(numbers, list)]
        table = np.stack(columns, axis=1)
    except ValueError:
        raise BenchmarkError(f"{where} has lists of different lengths", remedy) from None
    if table.ndim != 2 or table.shape[1] != len(lists) or table.dtype.kind not in "if":
        raise BenchmarkError(f"{where} has lists without numbers", remedy)
    values: Floats = table.astype(np.float64)
    if not _MIN_ROWS <= len(values) <= _MAX_ROWS:
        raise BenchmarkError(f"{where} has {len(values)} rows", remedy)
    if not np.isfinite(values).all() or (np.diff(values[:, 0]) <= 0.0).any():
        raise BenchmarkError(f"{where} has times that do not rise, or numbers that are not finite", remedy)
    return AxisSeries(values[:, 0].copy(), values[:, 1:].copy())


def series_content(series: Mapping[str, AxisSeries], unit: str) -> dict[str, dict[str, list[float]]]:
    """Return series by flight as the content of a file; `unit` ends the keys of the axes."""
    return {
        name: {"t_s": axes.t_s.tolist()}
        | {f"{axis}_{unit}": column.tolist() for axis, column in zip(_AXES, axes.values.T, strict=True)}
        for name, axes in series.items()
    }
