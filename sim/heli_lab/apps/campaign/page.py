"""Write the HTML page of a campaign: distributions, groups, failures, and links to the worst cases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from heli_lab.apps.campaign.campaign import Campaign
from heli_lab.apps.campaign.store import TABLE
from heli_lab.apps.campaign.summary import Column, Row, Summary
from heli_lab.report.page import write_page
from heli_lab.report.page.drawing import Drawing

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
        works=campaign.works,
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
