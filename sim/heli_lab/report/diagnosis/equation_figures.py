"""Figures of a proposed equation, and of the regions in which a model fails."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from heli_lab.explain.discover.notation import latex
from heli_lab.explain.discover.proposal import ProposedTerm
from heli_lab.explain.evaluate.regions import FailingRegions, RegionTest
from heli_lab.explain.search.splines import QUANTITIES
from heli_lab.explain.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.explain.wording import display_unit
from heli_lab.report.diagnosis.figures import bin_means, thinned

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MISSING, _TERM, _OUTLINE = "#8d959e", "#0b5fa5", "#111111"
_POINTS: Final = 4000
"""Dots of a scatter plot: more hide each other."""
_MEANS: Final = 24
"""Means over equal parts of the dots: fewer hide a bend, more show noise."""


def figure_of_equation(proposed: ProposedTerm) -> Figure:
    """Draw the equation of a `proposed` term along a flight, together with the missing torque.

    The panels show both over time, against each other, and over the first quantity of the equation.
    """
    from matplotlib.figure import Figure

    trace = proposed.trace
    figure = Figure(figsize=(11, 6.6))
    grid = figure.add_gridspec(2, 2, left=0.08, right=0.98, bottom=0.08, top=0.88, hspace=0.32, wspace=0.22)
    time_panel, scatter_panel, quantity_panel = (
        figure.add_subplot(cell) for cell in (grid[0, :], grid[1, 0], grid[1, 1])
    )
    missing_mNm, term_mNm = 1e3 * trace.missing_Nm, 1e3 * trace.term_Nm
    std_mNm = 1e3 * trace.std_Nm
    time_panel.fill_between(
        trace.t_s, missing_mNm - 2 * std_mNm, missing_mNm + 2 * std_mNm, color=_MISSING, alpha=0.25, lw=0
    )
    time_panel.plot(
        trace.t_s,
        missing_mNm,
        color=_MISSING,
        lw=0.9,
        label="missing without the equation, with two standard errors",
    )
    time_panel.plot(trace.t_s, term_mNm, color=_TERM, lw=1.3, label="equation")
    time_panel.set_xlabel(f"time in {trace.label} [s]")
    time_panel.set_ylabel(f"torque about {trace.axis} [mN m]")
    time_panel.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=8, frameon=False)
    thinned_rows = thinned(len(term_mNm), _POINTS)
    scatter_panel.plot(
        term_mNm[thinned_rows], missing_mNm[thinned_rows], ".", color=_MISSING, ms=2.5, alpha=0.6
    )
    span = np.array([min(term_mNm.min(), missing_mNm.min()), max(term_mNm.max(), missing_mNm.max())])
    scatter_panel.plot(span, span, color=_TERM, lw=1.2)
    correlation = np.corrcoef(term_mNm, missing_mNm)[0, 1] if term_mNm.std() > 0 else 0.0
    scatter_panel.set_xlabel(f"equation [mN m]; correlation {correlation:.2f}")
    scatter_panel.set_ylabel("missing without it [mN m]")
    factor, unit = display_unit(trace.unit)
    quantity_panel.plot(
        factor * trace.value[thinned_rows], missing_mNm[thinned_rows], ".", color=_MISSING, ms=2.5, alpha=0.6
    )
    quantity_panel.plot(factor * trace.value[thinned_rows], term_mNm[thinned_rows], ".", color=_TERM, ms=2.0)
    quantity_panel.set_xlabel(f"{trace.on.replace('_', ' ')} [{unit}]")
    quantity_panel.set_ylabel("torque [mN m]")
    for panel in (time_panel, scatter_panel, quantity_panel):
        panel.grid(alpha=0.25)
    flight_text = (
        "a flight that no fit used" if proposed.discovery.held_out is not None else "the fitted flight"
    )
    figure.suptitle(f"${latex(proposed.equation, proposed.numbers)}$   on {flight_text}", fontsize=11)
    return figure


def figure_of_failing_regions(all_regions: Sequence[FailingRegions], models: Sequence[str]) -> Figure:
    """Draw the fitted flights in the plane of each axis, coloured by the missing torque; cells in which a
    model fails are outlined.
    """
    from matplotlib.figure import Figure

    height = 0.8 + 4.1 * len(all_regions)
    figure = Figure(figsize=(11, height))
    rows = figure.subplots(len(all_regions), len(models), sharex="row", sharey="row", squeeze=False)
    figure.subplots_adjust(0.075, 0.55 / height, 0.9, 1.0 - 0.85 / height, wspace=0.1, hspace=0.34)
    for regions, panels in zip(all_regions, rows, strict=True):
        _regions_row(figure, panels, regions, models)
    figure.suptitle(
        f"{100 * FALSE_DISCOVERY_RATE:.0f} % of the outlined cells may be by chance",
        y=1.0 - 0.2 / height,
        fontsize=11,
    )
    return figure


def _regions_row(
    figure: Figure, panels: Sequence[Axes], regions: FailingRegions, models: Sequence[str]
) -> None:
    """Draw the plane of one axis for each model, with a colour bar of the missing torque."""
    torques = np.concatenate([np.abs(flight.torque_Nm) for flight in regions.before.flights])
    color_limit_mNm = 1e3 * float(np.quantile(torques, 0.98)) or 1.0
    (x_factor, x_unit), (y_factor, y_unit) = (
        _display_factor_and_unit(regions.x),
        _display_factor_and_unit(regions.y),
    )
    points = None
    for panel, test, model in zip(panels, (regions.before, regions.after), models, strict=False):
        for flight in test.flights:
            panel.plot(
                x_factor * flight.x, y_factor * flight.y, color="#d7dbe0", lw=0.4, zorder=1, rasterized=True
            )
            points = panel.scatter(
                x_factor * flight.x,
                y_factor * flight.y,
                c=1e3 * flight.torque_Nm,
                s=5,
                cmap="coolwarm",
                vmin=-color_limit_mNm,
                vmax=color_limit_mNm,
                zorder=2,
                lw=0,
            )
        _outline_failing_cells(panel, regions, test)
        panel.set_title(f"{regions.axis}: {model}", fontsize=10, loc="left")
        panel.set_xlabel(f"{regions.x.replace('_', ' ')} [{x_unit}]")
        panel.grid(alpha=0.2)
    panels[0].set_ylabel(f"{regions.y.replace('_', ' ')} [{y_unit}]")
    if points is not None:
        box = panels[-1].get_position()
        colorbar = figure.colorbar(points, cax=figure.add_axes((0.915, box.y0, 0.015, box.height)))
        colorbar.set_label(f"missing torque about {regions.axis} [mN m]", fontsize=9)


def figure_of_unknown_torque(regions: FailingRegions) -> Figure:
    """Draw the torque that the model after the extension lacks, over the first quantity of `regions`.

    The torque is that about the axis of the regions.
    """
    from matplotlib.figure import Figure

    flights = regions.after.flights
    factor, unit = _display_factor_and_unit(regions.x)
    quantity = factor * np.concatenate([flight.x for flight in flights])
    torque_mNm = 1e3 * np.concatenate([flight.torque_Nm for flight in flights])
    thinned_rows = thinned(len(quantity), _POINTS)
    figure = Figure(figsize=(11, 3.6))
    panel = figure.subplots()
    figure.subplots_adjust(0.08, 0.16, 0.98, 0.9)
    panel.plot(
        quantity[thinned_rows], torque_mNm[thinned_rows], ".", ms=2.5, color="#b4b9bf", rasterized=True
    )
    panel.plot(*bin_means(quantity, torque_mNm, _MEANS), "o", ms=5, color=_OUTLINE, label="means")
    panel.set_title(
        f"unknown: torque about {regions.axis} that the model with all named causes lacks",
        fontsize=10.5,
        loc="left",
    )
    panel.set_xlabel(f"{regions.x.replace('_', ' ')} [{unit}]")
    panel.set_ylabel(f"torque about {regions.axis} [mN m]")
    panel.grid(alpha=0.25)
    panel.legend(loc="best", fontsize=9)
    return figure


def _outline_failing_cells(panel: Axes, regions: FailingRegions, test: RegionTest) -> None:
    """Draw lines between cells that fail and cells that do not."""
    (x_factor, _), (y_factor, _) = _display_factor_and_unit(regions.x), _display_factor_and_unit(regions.y)
    # A frame of cells that do not fail, so that each cell has neighbours.
    x, y, fails = x_factor * regions.x_edges, y_factor * regions.y_edges, np.pad(test.fails, 1)
    for i in range(len(x)):
        for j in range(len(y)):
            if j + 1 < len(y) and fails[i, j + 1] != fails[i + 1, j + 1]:
                panel.plot([x[i], x[i]], [y[j], y[j + 1]], color=_OUTLINE, lw=1.8, zorder=3)
            if i + 1 < len(x) and fails[i + 1, j] != fails[i + 1, j + 1]:
                panel.plot([x[i], x[i + 1]], [y[j], y[j]], color=_OUTLINE, lw=1.8, zorder=3)


def _display_factor_and_unit(quantity: str) -> tuple[float, str]:
    """Return the factor from the SI unit of a quantity to its display unit, and that unit."""
    return display_unit(QUANTITIES[quantity][1])
