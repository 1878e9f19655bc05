"""Read times that are written as clock times or as dates with a time."""

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
    Returns shape (n,).
    """
    import pandas

    text = cells.astype(str)
    samples = text.iloc[: min(len(text), 10)]
    if samples.str.match(_CLOCK).all():
        fields = (
            text.str.replace(",", ".").str.split(":", expand=True).apply(pandas.to_numeric, errors="coerce")
        )
        # Seconds per unit of each field: 3600, 60, 1 for hours, minutes, seconds.
        weights = 60.0 ** np.arange(fields.shape[1] - 1, -1, -1)
        seconds: Floats = fields.to_numpy(np.float64) @ weights
        is_known = np.isfinite(seconds)
        day_changes = np.diff(seconds[is_known], prepend=seconds[is_known][:1]) < -0.5 * _DAY_S
        seconds[is_known] += _DAY_S * np.cumsum(day_changes)
    elif samples.str.match(_DATE).all():
        # A date that begins with a year goes on with the month. Other dates begin with the day in most
        # countries.
        day_first = not samples.str.match(r"^\s*\d{4}").all()
        dates = pandas.to_datetime(
            text.str.replace(",", "."), errors="coerce", dayfirst=day_first, format="mixed", utc=True
        )
        seconds = np.asarray((dates - dates.iloc[0]).dt.total_seconds(), dtype=np.float64)
    else:
        return None
    finite_s = seconds[np.isfinite(seconds)]
    return seconds - finite_s[0] if finite_s.size else None
