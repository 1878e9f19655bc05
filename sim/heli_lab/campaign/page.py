"""The page of a campaign: distributions, groups, failures, and links to the worst cases."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from heli_lab.campaign.campaign import Campaign
from heli_lab.campaign.store import TABLE
from heli_lab.campaign.summary import Column, Row, Summary
from heli_lab.page import write_page
from heli_lab.page.drawing import Drawing

_MAX_DRAWN: Final = 12
"""Histograms of one picture; the table above it has all columns."""
_IN_A_ROW: Final = 3
_TEMPLATE: Final = Path(__file__).with_name("summary.html")


def write_summary(campaign: Campaign, summary: Summary, folder: Path) -> Path:
    """Write index.html and its picture into the `folder` of the results; return the page."""
    drawn = [column for column in summary.columns if len(np.unique(column.values)) > 1][:_MAX_DRAWN]
    picture = ""
    if drawn:
        picture = str(
            Drawing().add(figure_of_distributions(drawn, campaign.worst), folder / "distributions.png")
        )
    return write_page(
        folder,
        _TEMPLATE,
        number=_number,
        title=campaign.title,
        summary=summary,
        cases=len(campaign.cases),
        works=campaign.works,
        worst_by=campaign.worst.removeprefix("-"),
        varied=_varied(campaign),
        picture=picture,
        table=TABLE,
        groups=_groups(summary, drawn),
        shown=[column.name for column in drawn[:4]],
    )


def figure_of_distributions(columns: Sequence[Column], worst: str) -> Figure:
    """Draw histograms of some `columns`. The column that ranks the `worst` cases has another colour."""
    rows = math.ceil(len(columns) / _IN_A_ROW)
    figure = Figure(figsize=(3.3 * _IN_A_ROW, 2.4 * rows), layout="constrained")
    for place, column in enumerate(columns, 1):
        axes = figure.add_subplot(rows, _IN_A_ROW, place)
        colour = "#b3541e" if column.name == worst.removeprefix("-") else "#3b6ea5"
        bins = min(30, max(8, round(2.0 * len(column.values) ** 0.5)))
        axes.hist(column.values, bins=bins, color=colour)
        axes.axvline(column.median, color="black", linewidth=1.0)
        axes.set_xlabel(column.name)
        axes.set_ylabel("cases" if place % _IN_A_ROW == 1 else "")
        axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=4))
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def _varied(campaign: Campaign) -> list[str]:
    """Settings that differ between cases."""
    first = campaign.cases[0].settings
    return [name for name in first if any(case.settings.get(name) != first[name] for case in campaign.cases)]


def _groups(
    summary: Summary, drawn: Sequence[Column]
) -> list[tuple[str, list[tuple[str, int, list[float]]]]]:
    """Medians of the first columns by each setting: setting, then value, number of cases and medians."""
    names = [column.name for column in drawn[:4]]
    return [
        (setting, [(value, len(rows), [_median(rows, name) for name in names]) for value, rows in by.items()])
        for setting, by in summary.groups.items()
    ]


def _median(rows: Sequence[Row], name: str) -> float:
    values = [float(row[name]) for row in rows if isinstance(row.get(name), int | float)]
    return float(np.median(values)) if values else math.nan


def _number(value: Any) -> str:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return "–" if value is None else str(value)
    return f"{value:.4g}" if math.isfinite(value) else "–"
