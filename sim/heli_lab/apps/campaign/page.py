"""Summarise the table of a campaign, and write its page: distributions, groups, failures, worst cases."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.declaration import Fault
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from heli_lab.apps.campaign.cases import Campaign
from heli_lab.apps.campaign.store import RESULT_COLUMNS, TABLE
from heli_lab.apps.campaign.works import PREFIX
from heli_lab.report.page import write_page
from heli_lab.report.page.drawing import Drawing

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


_MAX_DRAWN: Final = 12
"""Largest number of histograms in the figure; the table above it has all columns."""
_HISTOGRAMS_PER_ROW: Final = 3
_MAX_MEDIANS: Final = 4
"""Largest number of columns whose medians are shown by setting."""
_TEMPLATE: Final = Path(__file__).with_name("summary.html")


def write_summary(campaign: Campaign, summary: Summary, folder: Path) -> Path:
    """Write index.html and its figure into the `folder` of the results; return the path of the page."""
    drawn = [column for column in summary.columns if len(np.unique(column.values)) > 1][:_MAX_DRAWN]
    picture = ""
    if drawn:
        picture = str(
            Drawing().add(figure_of_distributions(drawn, campaign.worst), folder / "distributions.png")
        )
    return write_page(
        folder,
        _TEMPLATE,
        number=_number_text,
        title=campaign.title,
        summary=summary,
        cases=len(campaign.cases),
        works=campaign.work_functions,
        worst_by=campaign.worst.removeprefix("-"),
        varied=_varied_settings(campaign),
        picture=picture,
        table=TABLE,
        groups=_medians_by_value(summary, drawn),
        shown=[column.name for column in drawn[:_MAX_MEDIANS]],
    )


def figure_of_distributions(columns: Sequence[Column], worst: str) -> Figure:
    """Draw histograms of some `columns`. The column that ranks the `worst` cases has another colour."""
    rows = math.ceil(len(columns) / _HISTOGRAMS_PER_ROW)
    figure = Figure(figsize=(3.3 * _HISTOGRAMS_PER_ROW, 2.4 * rows), layout="constrained")
    for number, column in enumerate(columns, 1):
        axes = figure.add_subplot(rows, _HISTOGRAMS_PER_ROW, number)
        colour = "#b3541e" if column.name == worst.removeprefix("-") else "#3b6ea5"
        bins = min(30, max(8, round(2.0 * len(column.values) ** 0.5)))
        axes.hist(column.values, bins=bins, color=colour)
        axes.axvline(column.median, color="black", linewidth=1.0)
        axes.set_xlabel(column.name)
        axes.set_ylabel("cases" if number % _HISTOGRAMS_PER_ROW == 1 else "")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _varied_settings(campaign: Campaign) -> list[str]:
    """List the settings that differ between cases."""
    first = campaign.cases[0].settings
    return [name for name in first if any(case.settings.get(name) != first[name] for case in campaign.cases)]


@dataclass(frozen=True)
class _Group:
    """Cases with one value of a setting, for the page."""

    value: str  # Value of the setting
    cases: int  # Number of cases with this value
    medians: list[float]  # Medians of the first columns over these cases


def _medians_by_value(summary: Summary, drawn: Sequence[Column]) -> dict[str, list[_Group]]:
    """Compute the medians of the first `drawn` columns for each value of each setting, by setting."""
    names = [column.name for column in drawn[:_MAX_MEDIANS]]
    return {
        setting: [
            _Group(value, len(rows), [_median(rows, name) for name in names])
            for value, rows in rows_by_value.items()
        ]
        for setting, rows_by_value in summary.groups.items()
    }


def _median(rows: Sequence[Row], name: str) -> float:
    """Compute the median of the numbers in column `name`; nan if there is none."""
    values = [float(row[name]) for row in rows if isinstance(row.get(name), int | float)]
    return float(np.median(values)) if values else math.nan


def _number_text(value: Any) -> str:
    """Format a cell for the page; a missing or infinite number becomes a dash."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–" if value is None else str(value)
    return f"{value:.4g}" if math.isfinite(value) else "–"
