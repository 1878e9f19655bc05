"""Parts of flights: the beginning and the rest of a flight, and two folds of several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from heli_lab.identify import Record
from heli_lab.identify.thresholds import MIN_SEGMENT_S


def split(record: Record, seconds: float) -> tuple[Record, Record]:
    """Return the first `seconds` of free flight of a `record`, and the rest; pieces of the rest that are too
    short are dropped.
    """
    remaining = round(seconds / record.step_s)
    first, rest = [], []
    for start, stop in record.segments:
        cut = min(stop, start + remaining)
        remaining -= cut - start
        first += [(start, cut)] if cut > start else []
        rest += [(cut, stop)] if stop > cut else []
    min_rows = round(MIN_SEGMENT_S / record.step_s)
    rest = [(start, stop) for start, stop in rest if stop - start >= min_rows] or rest
    return replace(record, segments=tuple(first)), replace(record, segments=tuple(rest))


def two_folds(records: Sequence[Record]) -> tuple[tuple[Record, ...], tuple[Record, ...]]:
    """Divide flights (`records`) into two folds: the first half of the flights and the second, or the halves
    of the free flight of one.
    """
    if len(records) > 1:
        middle = (len(records) + 1) // 2
        return tuple(records[:middle]), tuple(records[middle:])
    first, second = split(records[0], 0.5 * records[0].used_s)
    return (first,), (second,)
