"""Figures of a proposed law, and of where a model fails."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from heli_lab.diagnose.equation_discovery import ProposedTerm
from heli_lab.diagnose.equation_discovery.notation import latex
from heli_lab.diagnose.failing_regimes import FailingRegimes, Regimes
from heli_lab.diagnose.spline_term import QUANTITIES
from heli_lab.diagnose.thresholds import FALSE_DISCOVERY_RATE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MISSING, _LAW, _OUTLINE = "#8d959e", "#0b5fa5", "#111111"
_POINTS: Final = 4000
_SHOWN: Final = {"rad": (180.0 / np.pi, "deg"), "rad/s": (180.0 / np.pi, "deg/s")}


def figure_of_equation(proposed: ProposedTerm) -> Figure:
    """Draw a proposed law along a flight that had no part in its choice, where there is one: the torque that
    the model lacks without it, and the law's; one against the other; both against the law's first quantity.
    """
    from matplotlib.figure import Figure

    seen = proposed.reference
    figure = Figure(figsize=(11, 6.6))
    grid = figure.add_gridspec(2, 2, left=0.08, right=0.98, bottom=0.08, top=0.88, hspace=0.32, wspace=0.22)
    over, against, curve = (figure.add_subplot(cell) for cell in (grid[0, :], grid[1, 0], grid[1, 1]))
    missing, equation = 1e3 * seen.missing_Nm, 1e3 * seen.law_Nm
    std = 1e3 * seen.std_Nm
    over.fill_between(seen.t_s, missing - 2 * std, missing + 2 * std, color=_MISSING, alpha=0.25, lw=0)
    over.plot(seen.t_s, missing, color=_MISSING, lw=0.9, label="missing without the law, and twice its error")
    over.plot(seen.t_s, equation, color=_LAW, lw=1.3, label="the law")
    over.set_xlabel(f"time in {seen.label} [s]")
    over.set_ylabel(f"torque about {seen.axis} [mN m]")
    over.legend(loc="lower right", bbox_to_anchor=(1.0, 0.99), ncols=2, fontsize=8, frameon=False)
    keep = slice(None, None, max(1, len(equation) // _POINTS))
    against.plot(equation[keep], missing[keep], ".", color=_MISSING, ms=2.5, alpha=0.6)
    span = np.array([min(equation.min(), missing.min()), max(equation.max(), missing.max())])
    against.plot(span, span, color=_LAW, lw=1.2)
    correlation = np.corrcoef(equation, missing)[0, 1] if equation.std() > 0 else 0.0
    against.set_xlabel(f"the law [mN m]; correlation {correlation:.2f}")
    against.set_ylabel("missing without it [mN m]")
    factor, unit = _SHOWN.get(seen.unit, (1.0, seen.unit))
    curve.plot(factor * seen.value[keep], missing[keep], ".", color=_MISSING, ms=2.5, alpha=0.6)
    curve.plot(factor * seen.value[keep], equation[keep], ".", color=_LAW, ms=2.0)
    curve.set_xlabel(f"{seen.on.replace('_', ' ')} [{unit}]")
    curve.set_ylabel("torque [mN m]")
    for panel in (over, against, curve):
        panel.grid(alpha=0.25)
    where = "a flight that no fit saw" if proposed.discovery.held_out is not None else "the flight fitted"
    figure.suptitle(f"${latex(proposed.equation, proposed.numbers)}$   on {where}", fontsize=11)
    return figure


def figure_of_failing_regimes(regions: FailingRegimes) -> Figure:
    """Draw the course of the flights fitted in the plane of the two quantities that matter most, coloured by
    what the model lacks, before and after; cells in which it fails are outlined.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4.9))
    panels = figure.subplots(1, 2, sharex=True, sharey=True)
    figure.subplots_adjust(0.075, 0.12, 0.9, 0.86, wspace=0.1)
    every = np.concatenate([np.abs(moment.torque_Nm) for moment in regions.before.moments])
    most = 1e3 * float(np.quantile(every, 0.98)) or 1.0
    points = None
    for panel, regimes, when in zip(
        panels, (regions.before, regions.after), ("before", "after"), strict=True
    ):
        for moment in regimes.moments:
            (fx, _), (fy, _) = _shown(regions.x), _shown(regions.y)
            panel.plot(fx * moment.x, fy * moment.y, color="#d7dbe0", lw=0.4, zorder=1)
            points = panel.scatter(
                fx * moment.x,
                fy * moment.y,
                c=1e3 * moment.torque_Nm,
                s=5,
                cmap="coolwarm",
                vmin=-most,
                vmax=most,
                zorder=2,
                lw=0,
            )
        _outline(panel, regions, regimes)
        caption = (
            f"fails in the outlined regime, {100 * regimes.share:.0f} % of the time"
            if regimes.fails.any()
            else "fails nowhere that shows"
        )
        panel.set_title(f"{when}: {caption}; {_mNm(regimes.rms_Nm)} mN m rms", fontsize=10)
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


def _outline(panel: Axes, regions: FailingRegimes, regimes: Regimes) -> None:
    """Lines between cells that fail and cells that do not."""
    (fx, _), (fy, _) = _shown(regions.x), _shown(regions.y)
    x, y, fails = fx * regions.x_edges, fy * regions.y_edges, np.pad(regimes.fails, 1)
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
    return _SHOWN.get(unit, (1.0, unit))
