"""A campaign's table in numbers: how its columns are distributed, and where it is worst."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.declaration import Fault

from heli_lab.campaign.campaign import Campaign
from heli_lab.campaign.draw import PREFIX
from heli_lab.campaign.store import RESULT_COLUMNS

OUTCOME: Final = "outcome"
"""Column that states how a flight ended."""
COMPLETED: Final = "completed"
_FAULTS: Final = frozenset(fault.name.lower() for fault in Fault if fault)
_WORST: Final = 10
_MAX_GROUPS: Final = 24
"""Values of a setting beyond which it groups nothing: a seed has as many as there are cases."""
_QUANTILES: Final = (0.05, 0.5, 0.95)
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """Distribution of a numeric result over the cases.

    Parameters
    ----------
    name : str
        Name of the column; it ends in the unit.
    values : ndarray (n,)
        Values of the n cases that have one, in the column's unit.
    mean, low, median, high : float
        Mean, and the quantiles at 5, 50 and 95 %, in the column's unit.
    """

    name: str
    values: np.ndarray[tuple[int], np.dtype[np.float64]]
    mean: float
    low: float
    median: float
    high: float


@dataclass(frozen=True)
class Summary:
    """Summary of the results of a campaign.

    Parameters
    ----------
    cases : int
        Cases that have ended.
    columns : tuple of Column
        Results that are numbers; a result that is true or false is 1 or 0.
    words : Mapping of str to Mapping of str to int
        Columns that hold words: for each column, how often each word occurs.
    groups : Mapping of str to Mapping of str to tuple of Row
        Rows by setting and value, for settings that have several values but not a different one in each case.
    worst : tuple of Row
        The worst cases, worst first.
    failed : tuple of Row
        Cases without a result.
    outcomes : Mapping of str to int
        Number of flights by how they ended, the most frequent first: ``completed``, ``not_tracked``, or
        ``aborted`` with the fault. Empty if the work does not report it.
    """

    cases: int
    columns: tuple[Column, ...]
    words: Mapping[str, Mapping[str, int]]
    groups: Mapping[str, Mapping[str, tuple[Row, ...]]]
    worst: tuple[Row, ...]
    failed: tuple[Row, ...]
    outcomes: Mapping[str, int]

    @property
    def not_completed(self) -> int:
        """Flights that did not end as completed."""
        return sum(count for outcome, count in self.outcomes.items() if outcome != COMPLETED)


def summarise(campaign: Campaign, rows: Sequence[Row]) -> Summary:
    """Summarise the table of a campaign, its `rows`."""
    settings = {name for case in campaign.cases for name in case.settings}
    good = [row for row in rows if not row.get("failure")]
    names = [
        name
        for name in dict.fromkeys(n for row in good for n in row)
        if name not in {"case", OUTCOME, *RESULT_COLUMNS, *settings} and not name.startswith(PREFIX)
    ]
    columns, words = [], {}
    for name in names:
        values = [row[name] for row in good if row.get(name) is not None]
        if all(isinstance(value, bool | int | float) for value in values):
            columns.append(_column(name, values))
        else:
            counted = Counter(str(value) or "nothing" for value in values)
            words[name] = dict(counted.most_common())
    groups = {}
    for name in sorted(settings):
        by_value: dict[str, list[Row]] = {}
        for row in good:
            by_value.setdefault(str(row.get(name, "")) or "nothing", []).append(row)
        if 1 < len(by_value) <= _MAX_GROUPS and len(by_value) < len(good):
            groups[name] = {value: tuple(some) for value, some in by_value.items()}
    by = campaign.worst.removeprefix("-")
    sign = -1.0 if campaign.worst.startswith("-") else 1.0
    ranked = sorted(
        (row for row in good if isinstance(row.get(by), int | float)), key=lambda row: -sign * float(row[by])
    )
    failed = tuple(row for row in rows if row.get("failure"))
    ends = Counter(_kind(str(row[OUTCOME])) for row in good if row.get(OUTCOME))
    return Summary(
        len(rows), tuple(columns), words, groups, tuple(ranked[:_WORST]), failed, dict(ends.most_common())
    )


def _kind(outcome: str) -> str:
    """Return an outcome without its numbers: its first word, and the fault that it names."""
    first, _, rest = outcome.partition(":")
    fault = next((word for word in re.findall(r"\w+", rest) if word in _FAULTS), "")
    return f"{first} ({fault})" if fault else first


def _column(name: str, values: Sequence[float]) -> Column:
    array = np.array([float(value) for value in values if math.isfinite(value)])
    if not len(array):
        return Column(name, array, *[math.nan] * 4)
    return Column(name, array, float(array.mean()), *map(float, np.quantile(array, _QUANTILES)))
