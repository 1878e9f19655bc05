"""Summarise the table of a campaign: distributions of its columns, groups, and the worst cases."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.declaration import Fault

from heli_lab.apps.campaign.campaign import Campaign
from heli_lab.apps.campaign.draw import PREFIX
from heli_lab.apps.campaign.store import RESULT_COLUMNS

OUTCOME: Final = "outcome"
"""Column that states how a flight ended."""
COMPLETED: Final = "completed"
_FAULTS: Final = frozenset(fault.name.lower() for fault in Fault if fault)
_MAX_WORST: Final = 10
"""Largest number of worst cases that are listed."""
_MAX_GROUPS: Final = 24
"""Largest number of values for which a setting groups the cases. A seed has more: as many as there are
cases."""
_QUANTILES: Final = (0.05, 0.5, 0.95)
Row = Mapping[str, Any]


@dataclass(frozen=True)
class Column:
    """Distribution of a numeric result over the cases."""

    name: str  # Name of the column; it ends in the unit
    values: np.ndarray[tuple[int], np.dtype[np.float64]]
    """(n,): Values of the n cases that have one, in the column's unit."""
    mean: float  # mean, low, median, high: Mean, and the quantiles at 5, 50 and 95 %, in the column's unit
    low: float
    median: float
    high: float


@dataclass(frozen=True)
class Summary:
    """Summary of the results of a campaign."""

    cases: int  # Cases that have ended
    columns: tuple[Column, ...]  # Results that are numbers; true and false count as 1 and 0
    words: Mapping[str, Mapping[str, int]]
    """Columns that hold words: for each column, how often each word occurs."""
    groups: Mapping[str, Mapping[str, tuple[Row, ...]]]
    """Rows by setting and value, for settings that have several values but not a different one in each case.
    """
    worst: tuple[Row, ...]  # The worst cases, worst first
    failed: tuple[Row, ...]  # Cases without a result
    outcomes: Mapping[str, int]
    """Number of flights by how they ended, the most frequent first: ``completed``, ``not_tracked``, or
    ``aborted`` with the fault. Empty if the work does not report it."""

    @property
    def not_completed(self) -> int:
        """Flights that did not end as completed."""
        return sum(count for outcome, count in self.outcomes.items() if outcome != COMPLETED)


def summarise(campaign: Campaign, rows: Sequence[Row]) -> Summary:
    """Summarise the `rows` of a campaign's table."""
    settings = {name for case in campaign.cases for name in case.settings}
    complete = [row for row in rows if not row.get("failure")]
    not_results = {"case", OUTCOME, *RESULT_COLUMNS, *settings}
    columns, words = [], {}
    for name in dict.fromkeys(column for row in complete for column in row):
        if name in not_results or name.startswith(PREFIX):
            continue
        values = [row[name] for row in complete if row.get(name) is not None]
        if all(isinstance(value, bool | int | float) for value in values):
            columns.append(_distribution_of_column(name, values))
        else:
            words[name] = dict(Counter(str(value) or "nothing" for value in values).most_common())
    outcomes = Counter(_without_numbers(str(row[OUTCOME])) for row in complete if row.get(OUTCOME))
    return Summary(
        cases=len(rows),
        columns=tuple(columns),
        words=words,
        groups=_group_by_setting(complete, sorted(settings)),
        worst=_worst_rows(complete, campaign.worst),
        failed=tuple(row for row in rows if row.get("failure")),
        outcomes=dict(outcomes.most_common()),
    )


def _group_by_setting(rows: Sequence[Row], settings: Sequence[str]) -> dict[str, dict[str, tuple[Row, ...]]]:
    """Group rows by setting and value, for each of the `settings` that has several values, but not too
    many.
    """
    groups = {}
    for name in settings:
        by_value: dict[str, list[Row]] = {}
        for row in rows:
            by_value.setdefault(str(row.get(name, "")) or "nothing", []).append(row)
        if 1 < len(by_value) <= _MAX_GROUPS and len(by_value) < len(rows):
            groups[name] = {value: tuple(rows_of_value) for value, rows_of_value in by_value.items()}
    return groups


def _worst_rows(rows: Sequence[Row], worst: str) -> tuple[Row, ...]:
    """Return the worst rows by the column `worst`, as in `Campaign`; the worst first."""
    column = worst.removeprefix("-")
    sign = -1.0 if worst.startswith("-") else 1.0
    with_value = [row for row in rows if isinstance(row.get(column), int | float)]
    return tuple(sorted(with_value, key=lambda row: -sign * float(row[column]))[:_MAX_WORST])


def _without_numbers(outcome: str) -> str:
    """Shorten an `outcome` to its first word and the fault that it names, so that equal outcomes are counted
    together.
    """
    first_word, _, explanation = outcome.partition(":")
    fault = next((word for word in re.findall(r"\w+", explanation) if word in _FAULTS), "")
    return f"{first_word} ({fault})" if fault else first_word


def _distribution_of_column(name: str, values: Sequence[float]) -> Column:
    """Compute the distribution of the finite `values` of a column."""
    array = np.array([float(value) for value in values if math.isfinite(value)])
    if not len(array):
        return Column(name, array, mean=math.nan, low=math.nan, median=math.nan, high=math.nan)
    low, median, high = (float(quantile) for quantile in np.quantile(array, _QUANTILES))
    return Column(name, array, mean=float(array.mean()), low=low, median=median, high=high)
