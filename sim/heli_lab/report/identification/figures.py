"""Draw the figures of an identification: predicted flights, parameters and their correlations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from heli_host.data.flight import broken_at_gaps
from heli_sim.model.parts import AXES

from heli_lab.fit.identification import Identification, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MEASURED, _PREDICTED, _RESIDUAL = "#222222", "#d1495b", "#0b5fa5"
_MAX_POINTS = 6000
"""Points of a curve, about: no more than a page can show."""
_MIN_AXIS_COUNTS = 1.0
"""Smallest range of an error axis to either side, in encoder counts, so that the grey band stays visible."""


def identification_figure(trace: Trace, role: str) -> Figure:
    """Draw measured and predicted angles, with the error below each axis: six panels on one time axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    panels = figure.subplots(6, 1, sharex=True, height_ratios=[2, 1, 2, 1, 2, 1])
    keep = slice(None, None, max(1, len(trace.t_s) // _MAX_POINTS))
    t_s = trace.t_s[keep]
    measured_deg, predicted_deg = np.rad2deg(trace.measured_rad[keep]), np.rad2deg(trace.predicted_rad[keep])
    label = "predicted freely, window by window"
    for index, axis in enumerate(AXES):
        above, below = panels[2 * index], panels[2 * index + 1]
        measured, predicted = measured_deg[:, index], predicted_deg[:, index]
        above.plot(*broken_at_gaps(t_s, measured), color=_MEASURED, lw=1.0, label="measured")
        above.plot(*broken_at_gaps(t_s, predicted), color=_PREDICTED, lw=0.8, label=label)
        above.set_ylabel(f"{axis} [deg]")
        error_deg = np.rad2deg(trace.residual[keep, index] * trace.sigma_rad[index])
        count_deg = np.rad2deg(trace.sigma_rad[index]) * np.sqrt(12.0)
        below.axhspan(-0.5 * count_deg, 0.5 * count_deg, color="#e5e5e5", label="half a count")
        below.plot(*broken_at_gaps(t_s, error_deg), color=_RESIDUAL, lw=0.6)
        below.set_ylabel("error [deg]")
        largest_deg = float(np.nanmax(np.abs(error_deg), initial=0.0))
        limit_deg = max(_MIN_AXIS_COUNTS * count_deg, largest_deg * 1.05)
        below.set_ylim(-limit_deg, limit_deg)
        for panel in (above, below):
            panel.grid(alpha=0.25)
            for window in trace.windows:
                panel.axvline(trace.t_s[window.start], color="#bbbbbb", lw=0.4)
    drawn = [*panels[0].get_lines()[:2], *panels[1].patches[:1]]
    panels[0].legend(handles=drawn, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8, ncols=3)
    panels[-1].set_xlabel("time [s]; thin lines: where a window begins and the state is free")
    panels[0].set_title(f"{trace.label} ({role})", loc="left", fontsize=11)
    return figure


def figure_of_parameters(identification: Identification) -> Figure:
    """Draw each parameter's change from its prior mean, in standard deviations of the prior.

    A grey band shows the prior; a bar shows the estimate with two standard errors.
    """
    from matplotlib.figure import Figure

    problem, fit = identification.fit.problem, identification.fit
    names = problem.names
    # The first parameter is at the top.
    y_position = np.arange(len(names))[::-1]
    change = (fit.theta - problem.parameter_vector.mean) / problem.parameter_vector.std
    half_interval = 2.0 * np.array(list(fit.std.values())) / problem.parameter_vector.std
    figure = Figure(figsize=(8, 1.2 + 0.28 * len(names)), layout="constrained")
    panel = figure.subplots()
    panel.axvspan(-2, 2, color="#eeeeee", label="prior, 95 %")
    label = "estimate, 95 %"
    panel.errorbar(
        change, y_position, xerr=half_interval, fmt="o", ms=4, color=_RESIDUAL, capsize=3, label=label
    )
    panel.set_yticks(y_position, names)
    panel.set_xlabel("change from the prior, in its standard deviations")
    panel.grid(alpha=0.25)
    panel.legend(loc="best", fontsize=8)
    return figure


def figure_of_correlations(identification: Identification) -> Figure:
    """Draw the correlation matrix of the estimates in colours; large correlations are also printed."""
    from matplotlib.figure import Figure

    names, correlation = identification.fit.problem.names, identification.fit.correlation
    height = 2.5 + 0.32 * len(names)
    figure = Figure(figsize=(height + 0.8, height), layout="constrained")
    panel = figure.subplots()
    image = panel.imshow(correlation, vmin=-1, vmax=1, cmap="RdBu_r")
    panel.set_xticks(range(len(names)), names, rotation=90, fontsize=8)
    panel.set_yticks(range(len(names)), names, fontsize=8)
    for i in range(len(names)):
        for j in range(len(names)):
            size = abs(correlation[i, j])
            if i != j and size > 0.5:
                # White is legible on dark colours; a second digit distinguishes 0.95 from 1.
                colour = "white" if size > 0.7 else "black"
                digits = 2 if size >= 0.95 else 1
                text = f"{correlation[i, j]:.{digits}f}"
                panel.text(j, i, text, ha="center", va="center", fontsize=6, color=colour)
    figure.colorbar(image, shrink=0.7, label="correlation")
    return figure
