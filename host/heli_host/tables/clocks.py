"""Times that are written as clocks or dates."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from heli_host.arrays import Floats

if TYPE_CHECKING:
    import pandas

_CLOCK: Final = r"^\s*(?:\d{1,3}:)?\d{1,2}:\d{1,2}(?:[.,]\d+)?\s*$"
_DATE: Final = r"^\s*\d{1,4}[-./]\d{1,2}[-./]\d{1,4}[T\s]+\d{1,2}:\d{2}"
_DAY_S: Final = 86400.0


def seconds_of(cells: pandas.Series) -> Floats | None:
    """Read `cells` such as `13:47:20.125`, `47:20,125` or `2024-01-04 12:58:31.2` as seconds from the first.

    Returns
    -------
    ndarray (n,) or None
        Seconds, nan where a cell is none; None where the cells are no times. A clock that passes midnight
        goes on.
    """
    import pandas

    text = cells.astype(str)
    first = text.iloc[: min(len(text), 10)]
    if first.str.match(_CLOCK).all():
        parts = (
            text.str.replace(",", ".").str.split(":", expand=True).apply(pandas.to_numeric, errors="coerce")
        )
        weights = 60.0 ** np.arange(parts.shape[1] - 1, -1, -1)
        seconds: Floats = parts.to_numpy(np.float64) @ weights
        known = np.isfinite(seconds)
        falls = np.diff(seconds[known], prepend=seconds[known][:1]) < -0.5 * _DAY_S
        seconds[known] += _DAY_S * np.cumsum(falls)
    elif first.str.match(_DATE).all():
        # A year that comes first is followed by the month; else most of the world begins with the day.
        day_first = not first.str.match(r"^\s*\d{4}").all()
        dates = pandas.to_datetime(
            text.str.replace(",", "."), errors="coerce", dayfirst=day_first, format="mixed", utc=True
        )
        seconds = np.asarray((dates - dates.iloc[0]).dt.total_seconds(), dtype=np.float64)
    else:
        return None
    known_s = seconds[np.isfinite(seconds)]
    return seconds - known_s[0] if known_s.size else None
