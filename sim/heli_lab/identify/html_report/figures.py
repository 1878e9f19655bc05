"""Figures of an identification."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.identify.results import Identification, Trace

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MEASURED, _PREDICTED, _RESIDUAL = "#222222", "#d1495b", "#0b5fa5"
_MAX_POINTS = 6000
"""Points of a curve, about: no more than a page can show."""
_MUST_SEE_COUNTS = 1.0


def identification_figure(trace: Trace, role: str) -> Figure:
    """Draw measured against predicted angles, with the error below each axis: six panels on one time axis.
    The title says the `role` of the flight.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 9), layout="constrained")
    panels = figure.subplots(6, 1, sharex=True, height_ratios=[2, 1, 2, 1, 2, 1])
    keep = slice(None, None, max(1, len(trace.t_s) // _MAX_POINTS))
    t_s = trace.t_s[keep]
    measured_deg, predicted_deg = np.rad2deg(trace.measured_rad[keep]), np.rad2deg(trace.predicted_rad[keep])
    label = "predicted freely, window by window"
    for index, axis in enumerate(AXES):
        above, below = panels[2 * index], panels[2 * index + 1]
        above.plot(t_s, measured_deg[:, index], color=_MEASURED, lw=1.0, label="measured")
        above.plot(t_s, predicted_deg[:, index], color=_PREDICTED, lw=0.8, label=label)
        above.set_ylabel(f"{axis} [deg]")
        error_deg = np.rad2deg(trace.residual[keep, index] * trace.sigma_rad[index])
        count_deg = np.rad2deg(trace.sigma_rad[index]) * np.sqrt(12.0)
        below.axhspan(-0.5 * count_deg, 0.5 * count_deg, color="#e5e5e5", label="half a count")
        below.plot(t_s, error_deg, color=_RESIDUAL, lw=0.6)
        below.set_ylabel("error [deg]")
        reach = max(_MUST_SEE_COUNTS * count_deg, float(np.nanmax(np.abs(error_deg), initial=0.0)) * 1.05)
        below.set_ylim(-reach, reach)
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
    """Draw every parameter as the change from its prior, in the prior's standard deviations: the prior as a
    grey band, the estimate with two standard errors as a bar.
    """
    from matplotlib.figure import Figure

    problem, fit = identification.fit.problem, identification.fit
    names = problem.names
    place = np.arange(len(names))[::-1]
    change = (fit.theta - problem.parameter_vector.mean) / problem.parameter_vector.std
    half = 2.0 * np.array(list(fit.std.values())) / problem.parameter_vector.std
    figure = Figure(figsize=(8, 1.2 + 0.28 * len(names)), layout="constrained")
    panel = figure.subplots()
    panel.axvspan(-2, 2, color="#eeeeee", label="prior, 95 %")
    label = "estimate, 95 %"
    panel.errorbar(change, place, xerr=half, fmt="o", ms=4, color=_RESIDUAL, capsize=3, label=label)
    panel.set_yticks(place, names)
    panel.set_xlabel("change from the prior, in its standard deviations")
    panel.grid(alpha=0.25)
    panel.legend(loc="best", fontsize=8)
    return figure


def figure_of_correlations(identification: Identification) -> Figure:
    """Draw the correlations of the estimates: a square of colours, numbers where they are large."""
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
                colour, text = (
                    "white" if size > 0.7 else "black",
                    f"{correlation[i, j]:.{1 + (size >= 0.95)}f}",
                )
                panel.text(j, i, text, ha="center", va="center", fontsize=6, color=colour)
    figure.colorbar(image, shrink=0.7, label="correlation")
    return figure
