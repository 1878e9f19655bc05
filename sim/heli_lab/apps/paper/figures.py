"""Draw the figures of the paper: 15 to 19 of bench tests, 21 to 25 of closed-loop flights."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.data.response import rms
from heli_sim.bench import ThrustCurve
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig

from heli_lab.apps.paper.experiments import ELEVATION_STEPS, PaperFlight
from heli_lab.apps.paper.lumped import CASES, analytic, response_deg
from heli_lab.apps.paper.tables import TESTS_OF_TABLE, Table
from heli_lab.fit.identification import Trace, trace
from heli_lab.fit.problem import Problem
from heli_lab.fit.records import Record
from heli_lab.fit.shooting import solve

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


MEASURED_COLOUR: Final = "#222222"
MODEL_COLOUR: Final = "#d1495b"
PRINTED_COLOUR: Final = "#0b5fa5"
GREY_COLOUR: Final = "#8a8a8a"
_AXIS_OF_TABLE: Final = {3: "pitch", 4: "elevation", 5: "travel"}
_ELEVATION, _PITCH, _TRAVEL = range(3)
"""Columns of the angles."""
_PANEL_SIZE: Final = (6.4, 3.4)
_SINGLE_WINDOW_s: Final = 1000.0
"""Length of a window that contains any test as a whole."""
FONT_SIZE: Final = 8


def finish(panel: Axes, y_label: str, x_label: str = "", ncols: int = 1) -> None:
    """Add the labels `x_label` and `y_label` of the axes, a grid, and a legend of `ncols` columns to a panel
    whose curves are drawn. Without an `x_label`, the panel keeps the one that it has.
    """
    panel.set(xlabel=x_label or panel.get_xlabel(), ylabel=y_label)
    panel.grid(alpha=0.25)
    panel.legend(fontsize=FONT_SIZE, ncols=ncols)


def thrust_figure(curve: ThrustCurve) -> Figure:
    """Draw Fig. 15: thrust over voltage with the fitted line."""
    from matplotlib.figure import Figure

    line = curve.line()
    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    panel = figure.subplots()
    for index, (name, marker) in enumerate((("front", "o"), ("back", "x"))):
        volts, thrust_N = curve.volts_V[:, index], curve.thrust_N[:, index]
        label = f"{name} motor, simulated scale"
        panel.plot(volts, thrust_N, marker, color=MEASURED_COLOUR, mfc="none", label=label)
    volts = np.linspace(0.0, float(curve.volts_V.max()), 200)
    fitted_N = np.maximum(0.0, line.gain_N_per_V * (volts - line.dead_zone_V))
    fitted = f"fit: F = {line.gain_N_per_V:.4f} (V - {line.dead_zone_V:.3f})"
    panel.plot(volts, fitted_N, color=MODEL_COLOUR, label=fitted)
    panel.plot(volts, 0.5839 * (volts - 1.0), "--", color=PRINTED_COLOUR, lw=1.0, label="(31) as printed")
    finish(panel, "thrust [N]", "voltage of the motor [V]")
    figure.suptitle("Thrust against voltage (after Fig. 15)")
    return figure


def bench_figure(table: Table, records: Sequence[Record], rig: Rig) -> Figure:
    """Draw one of Figs. 16 to 18: both bench tests of a table, measured, and simulated with (30)."""
    from matplotlib.figure import Figure

    tests, axis = TESTS_OF_TABLE[table.number], _AXIS_OF_TABLE[table.number]
    figure = Figure(figsize=(_PANEL_SIZE[0], 2.0 * _PANEL_SIZE[1]), layout="constrained")
    panels = figure.subplots(2, 1)
    for panel, test, record in zip(panels, tests, records, strict=True):
        run = _simulate_whole_test(table, record, rig)
        column = AXES.index(axis)
        measured_deg, predicted_deg = np.rad2deg(run.measured_rad), np.rad2deg(run.predicted_rad)
        panel.plot(run.t_s, measured_deg[:, column], color=MEASURED_COLOUR, label="measured")
        panel.plot(run.t_s, predicted_deg[:, column], "--", color=MODEL_COLOUR, label="(30), identified")
        if axis == "travel":
            panel.plot(run.t_s, measured_deg[:, _PITCH], color=GREY_COLOUR, lw=0.8, label="pitch, measured")
        error_deg = np.rad2deg(run.measured_rad[:, column] - run.predicted_rad[:, column])
        rms_deg = float(np.sqrt(np.mean(error_deg**2)))
        panel.set_title(
            f"{test.panel} {test.name}: error {rms_deg:.3f} deg rms over the whole run", fontsize=9
        )
        finish(panel, f"{axis} angle [deg]")
    panels[-1].set_xlabel("time [s]")
    figure.suptitle(f"Measured and simulated at the {axis} axis (after Fig. {tests[0].figure})")
    return figure


def sensitivity_figure(rig: Rig) -> Figure:
    """Draw Fig. 19: step responses of elevation with changed or neglected parameters."""
    from matplotlib.figure import Figure

    test, t_s = ELEVATION_STEPS[0], np.arange(0.0, 20.0, 0.02)
    base = analytic(rig)
    figure = Figure(figsize=(7.4, 4.6), layout="constrained")
    panel = figure.subplots()
    colours = (MEASURED_COLOUR, MODEL_COLOUR, PRINTED_COLOUR, "#157a4a", "#c98a00", "#6b3fa0")
    for case, colour in zip(CASES, colours, strict=True):
        changed = base | {name: factor * base[name] for name, factor in case.changes.items()}
        width = 1.8 if not case.changes else 1.1
        elevation_deg = response_deg(changed, test, t_s)
        # Without an upper stop, some responses grow without limit. The panel ends at 60 deg, so that lines up
        # to 90 deg leave it.
        visible_deg = np.where(elevation_deg < 90.0, elevation_deg, np.nan)
        panel.plot(t_s, visible_deg, color=colour, lw=width, label=case.label)
    panel.set_ylim(-30.0, 60.0)
    panel.axhspan(rig["elevation_max"].value, 60.0, color="#eeeeee", label="beyond the upper stop")
    finish(
        panel,
        "elevation angle [deg]",
        f"time since the step to {test.front_V:g} V on each motor [s]",
        ncols=2,
    )
    figure.suptitle("Effect of parameter variations on the elevation dynamics (after Fig. 19)")
    return figure


def _simulate_whole_test(table: Table, record: Record, rig: Rig) -> Trace:
    """Simulate a whole test open loop with the coefficients identified for its table."""
    fit = table.fit
    labels = [fitted.label for fitted in fit.problem.records]
    index = labels.index(record.label)
    values = {
        parameter.quantity: float(value)
        for parameter, value in zip(fit.problem.free, fit.theta, strict=True)
        if parameter.record in (None, index)
    }
    problem = Problem(fit.problem.model, rig, [record], free=[], window_s=_SINGLE_WINDOW_s, values=values)
    return trace(solve(problem))


_COLOURS: Final = (PRINTED_COLOUR, MODEL_COLOUR)
_WIDTH, _HEIGHT = 7.0, 2.7
_LEVEL_TOLERANCE_DEG: Final = 0.5
"""Error of the elevation below which a take-off has reached its setpoint [deg]."""
_TAKEN_OFF_DEG: Final = -1.0
"""Setpoint of the elevation from which on a take-off is nearly over [deg]."""
_TAKE_OFF_SETTLE_S: Final = 1.0
"""Time after a take-off that is left out too [s]."""


def hover_figure(flights: Sequence[PaperFlight]) -> Figure:
    """Draw Fig. 21: pitch, elevation and travel over time at hover."""
    figure, panels = _figure_with_panels(3, "Pitch, elevation and travel while hovering (after Fig. 21)")
    for panel, axis in zip(panels, (_PITCH, _ELEVATION, _TRAVEL), strict=True):
        # The plan gives no pitch: the travel loop does.
        _draw_angle(panel, flights, axis, desired=axis != _PITCH)
    return figure


def response_figure(flights: Sequence[PaperFlight], path: str, number: int) -> Figure:
    """Draw Fig. 22 or 24, its `number`: travel and elevation along a `path`, which the title names."""
    figure, panels = _figure_with_panels(2, f"Response during flight along the {path} (after Fig. {number})")
    for letter, panel, axis in zip("ab", panels, (_TRAVEL, _ELEVATION), strict=True):
        _draw_angle(panel, flights, axis, desired=True)
        panel.set_title(f"({letter}) {AXES[axis]} angle", fontsize=9)
    return figure


def performance_figure(flights: Sequence[PaperFlight], path: str, number: int) -> Figure:
    """Draw Fig. 23 or 25, its `number`: tracking errors of travel and elevation along a `path`, which the
    title names.
    """
    figure, panels = _figure_with_panels(
        2, f"Tracking performance along the {path} (after Fig. {number})", "; take-off left out"
    )
    for letter, panel, axis in zip("ab", panels, (_TRAVEL, _ELEVATION), strict=True):
        for flight, colour in zip(flights, _COLOURS, strict=False):
            is_airborne = flight.flight.t_s > take_off_end_s(flight)
            t_s, error_deg = flight.flight.t_s[is_airborne], flight.error_deg[is_airborne, axis]
            label = f"{flight.label}: {rms(error_deg):.2f} deg rms"
            panel.plot(t_s, error_deg, color=colour, lw=0.9, label=label)
        panel.axhline(0.0, color=GREY_COLOUR, lw=0.8)
        panel.set_title(f"({letter}) {AXES[axis]}", fontsize=9)
        finish(panel, "error [deg]")
    return figure


def take_off_end_s(flight: PaperFlight) -> float:
    """Return the end of a take-off [s]: one second after elevation first reaches its setpoint."""
    near_setpoint = np.abs(flight.error_deg[:, 0]) < _LEVEL_TOLERANCE_DEG
    after_take_off = near_setpoint & (flight.desired_deg[:, 0] > _TAKEN_OFF_DEG)
    rows = np.flatnonzero(after_take_off)
    return float(flight.flight.t_s[rows[0]]) + _TAKE_OFF_SETTLE_S if rows.size else 0.0


def _figure_with_panels(count: int, title: str, note: str = "") -> tuple[Figure, list[Axes]]:
    """Make a figure of `count` panels with a shared time axis; return the figure and its panels, the top one
    first.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, count * _HEIGHT), layout="constrained")
    panels = list(figure.subplots(count, 1, sharex=True))
    panels[-1].set_xlabel(f"time since the loops closed on the table [s]{note}")
    figure.suptitle(title)
    return figure, panels


def _draw_angle(panel: Axes, flights: Sequence[PaperFlight], axis: int, *, desired: bool) -> None:
    """Draw one angle of all flights over time; with `desired`, also the planned angle."""
    if desired:
        first = flights[0]
        panel.plot(
            first.flight.t_s, first.desired_deg[:, axis], "--", c=MEASURED_COLOUR, lw=1.0, label="desired"
        )
    for flight, colour in zip(flights, _COLOURS, strict=False):
        fault = "" if flight.outcome == "completed" else f": {flight.outcome.split(';')[0]}"
        label = f"{flight.label}{fault}"
        angle_deg = np.rad2deg(flight.flight.angles_rad[:, axis])
        panel.plot(flight.flight.t_s, angle_deg, color=colour, lw=0.9, label=label)
        if axis == _PITCH:
            label = f"{flight.label}, setpoint"
            panel.plot(
                flight.flight.t_s, flight.desired_deg[:, _PITCH], ":", color=colour, lw=0.7, label=label
            )
    finish(panel, f"{AXES[axis]} [deg]")
