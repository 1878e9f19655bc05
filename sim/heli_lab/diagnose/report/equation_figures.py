"""Figures of a proposed equation, and of the regions in which a model fails."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from heli_lab.diagnose.discover import ProposedTerm, latex
from heli_lab.diagnose.evaluate import FailingRegions, RegionTest
from heli_lab.diagnose.search import QUANTITIES
from heli_lab.diagnose.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.diagnose.wording import SHOWN

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MISSING, _TERM, _OUTLINE = "#8d959e", "#0b5fa5", "#111111"
_POINTS: Final = 4000


def figure_of_equation(proposed: ProposedTerm) -> Figure:
    """Draw the equation of a `proposed` term along a flight: the missing torque and the torque of the
    equation over time, against each other, and against the first quantity of the equation.
    """
    from matplotlib.figure import Figure

    trace = proposed.trace
    figure = Figure(figsize=(11, 6.6))
    grid = figure.add_gridspec(2, 2, left=0.08, right=0.98, bottom=0.08, top=0.88, hspace=0.32, wspace=0.22)
    over, against, curve = (figure.add_subplot(cell) for cell in (grid[0, :], grid[1, 0], grid[1, 1]))
    missing, term = 1e3 * trace.missing_Nm, 1e3 * trace.term_Nm
    std = 1e3 * trace.std_Nm
    over.fill_between(trace.t_s, missing - 2 * std, missing + 2 * std, color=_MISSING, alpha=0.25, lw=0)
    over.plot(
        trace.t_s,
        missing,
        color=_MISSING,
        lw=0.9,
        label="missing without the equation, with two standard errors",
    )
    over.plot(trace.t_s, term, color=_TERM, lw=1.3, label="equation")
    over.set_xlabel(f"time in {trace.label} [s]")
    over.set_ylabel(f"torque about {trace.axis} [mN m]")
    over.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=8, frameon=False)
    keep = slice(None, None, max(1, len(term) // _POINTS))
    against.plot(term[keep], missing[keep], ".", color=_MISSING, ms=2.5, alpha=0.6)
    span = np.array([min(term.min(), missing.min()), max(term.max(), missing.max())])
    against.plot(span, span, color=_TERM, lw=1.2)
    correlation = np.corrcoef(term, missing)[0, 1] if term.std() > 0 else 0.0
    against.set_xlabel(f"equation [mN m]; correlation {correlation:.2f}")
    against.set_ylabel("missing without it [mN m]")
    factor, unit = SHOWN.get(trace.unit, (1.0, trace.unit))
    curve.plot(factor * trace.value[keep], missing[keep], ".", color=_MISSING, ms=2.5, alpha=0.6)
    curve.plot(factor * trace.value[keep], term[keep], ".", color=_TERM, ms=2.0)
    curve.set_xlabel(f"{trace.on.replace('_', ' ')} [{unit}]")
    curve.set_ylabel("torque [mN m]")
    for panel in (over, against, curve):
        panel.grid(alpha=0.25)
    where = "a flight that no fit used" if proposed.discovery.held_out is not None else "the fitted flight"
    figure.suptitle(f"${latex(proposed.equation, proposed.numbers)}$   on {where}", fontsize=11)
    return figure


def figure_of_failing_regions(regions: FailingRegions) -> Figure:
    """Draw the fitted flights in the plane of `regions`, coloured by the missing torque, before and after;
    cells in which the model fails are outlined.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.9))
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    figure.subplots_adjust(0.075, 0.12, 0.9, 0.86, wspace=0.1)
    every = np.concatenate([np.abs(flight.torque_Nm) for flight in regions.before.flights])
    most = 1e3 * float(np.quantile(every, 0.98)) or 1.0
    points = None
    for panel, test, when in zip(panels, (regions.before, regions.after), ("before", "after"), strict=True):
        for flight in test.flights:
            (fx, _), (fy, _) = _shown(regions.x), _shown(regions.y)
            panel.plot(fx * flight.x, fy * flight.y, color="#d7dbe0", lw=0.4, zorder=1)
            points = panel.scatter(
                fx * flight.x,
                fy * flight.y,
                c=1e3 * flight.torque_Nm,
                s=5,
                cmap="coolwarm",
                vmin=-most,
                vmax=most,
                zorder=2,
                lw=0,
            )
        _outline(panel, regions, test)
        caption = (
            f"fails in the outlined region, {100 * test.share:.0f} % of the time"
            if test.fails.any()
            else "fails in no cell"
        )
        panel.set_title(f"{when}: {caption}; {_mNm(test.rms_Nm)} mN m rms", fontsize=10)
        panel.set_xlabel(f"{regions.x.replace('_', ' ')} [{_shown(regions.x)[1]}]")
        panel.grid(alpha=0.2)
    panels[0].set_ylabel(f"{regions.y.replace('_', ' ')} [{_shown(regions.y)[1]}]")
    if points is not None:
        bar = figure.colorbar(points, cax=figure.add_axes((0.915, 0.12, 0.015, 0.74)))
        bar.set_label(f"torque about {regions.axis} that the model lacks [mN m]")
    figure.suptitle(
        f"where the model fails; {100 * FALSE_DISCOVERY_RATE:.0f} % of the outlined cells may be by chance",
        fontsize=11,
    )
    return figure


def _outline(panel: Axes, regions: FailingRegions, test: RegionTest) -> None:
    """Lines between cells that fail and cells that do not."""
    (fx, _), (fy, _) = _shown(regions.x), _shown(regions.y)
    x, y, fails = fx * regions.x_edges, fy * regions.y_edges, np.pad(test.fails, 1)
    for i in range(len(x)):
        for j in range(len(y)):
            if j + 1 < len(y) and fails[i, j + 1] != fails[i + 1, j + 1]:
                panel.plot([x[i], x[i]], [y[j], y[j + 1]], color=_OUTLINE, lw=1.8, zorder=3)
            if i + 1 < len(x) and fails[i + 1, j] != fails[i + 1, j + 1]:
                panel.plot([x[i], x[i + 1]], [y[j], y[j]], color=_OUTLINE, lw=1.8, zorder=3)


def _mNm(torque_Nm: float) -> str:
    return f"{1e3 * torque_Nm:.0f}" if torque_Nm >= 0.01 else f"{1e3 * torque_Nm:.1f}"


def _shown(quantity: str) -> tuple[float, str]:
    unit = QUANTITIES[quantity][1]
    return SHOWN.get(unit, (1.0, unit))
