"""Draw Figs. 21 to 25: hover, the irregular path and the sines, each with two sets of gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.flight.response import rms
from heli_sim.model.parts import AXES

from heli_lab.apps.paper.figures_bench import (
    GREY_COLOUR,
    MEASURED_COLOUR,
    MODEL_COLOUR,
    PRINTED_COLOUR,
    finish,
)
from heli_lab.errors import IdentifyError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS: Final = (PRINTED_COLOUR, MODEL_COLOUR)
_WIDTH, _HEIGHT = 7.0, 2.7
_END_S: Final = 0.1
"""Time at the end of a flight that is left out [s]: a streamed path arrives late on the board, and the
landing begins."""
_LEVEL_TOLERANCE_DEG: Final = 0.5
"""Error of the elevation below which a take-off has reached its setpoint [deg]."""
_TAKEN_OFF_DEG: Final = -1.0
"""Setpoint of the elevation from which on a take-off is nearly over [deg]."""
_SETTLE_S: Final = 1.0
"""Time after a take-off that is left out too [s]."""


@dataclass(frozen=True)
class PaperFlight:
    """Closed-loop flight for a figure."""

    label: str  # Name of the gains
    flight: Flight  # Closed-loop part of a log; time 0 is the take-off
    desired_deg: Floats  # (n, 3): Planned elevation and travel, and the setpoint of the pitch loop [deg]
    outcome: str  # ``completed``, or the reason why the flight ended

    @property
    def error_deg(self) -> Floats:
        """Measured minus desired angles [deg], shape (n, 3)."""
        return np.rad2deg(self.flight.angles_rad) - self.desired_deg


def closed_loop_flight(label: str, flight: Flight, desired_deg: Floats, outcome: str) -> PaperFlight:
    """Cut out the closed-loop part of a log, from take-off to the end of the plan. Shapes: `desired_deg` (n,
    3).
    """
    names = {name: number for number, name in flight.state_names.items()}
    if flight.state is None or flight.setpoints_rad is None:
        raise IdentifyError(
            f"{label}: the log contains no states or setpoints", "record it with heli-host fly"
        )
    rows = np.flatnonzero(flight.state == names["closed_loop"])
    if rows.size == 0:
        raise IdentifyError(
            f"{label}: the board never closed its loops ({outcome})", "record a flight that takes off"
        )
    start_s, stop_s = float(flight.t_s[rows[0]]), float(flight.t_s[rows[-1]]) - _END_S
    closed_loop = flight.between(start_s, stop_s)
    is_closed_loop = (flight.t_s >= start_s) & (flight.t_s < stop_s)
    closed_loop_desired_deg = desired_deg[is_closed_loop].copy()
    # The travel loop gives the setpoint of pitch, and the plan does not.
    closed_loop_desired_deg[:, 1] = np.rad2deg(flight.setpoints_rad[is_closed_loop, 1])
    from_zero = replace(closed_loop, t_s=closed_loop.t_s - start_s)
    return PaperFlight(label, from_zero, closed_loop_desired_deg, outcome)


def hover_figure(flights: Sequence[PaperFlight]) -> Figure:
    """Draw Fig. 21: pitch, elevation and travel over time at hover."""
    figure, panels = _figure_with_panels(3, "Pitch, elevation and travel while hovering (after Fig. 21)")
    for panel, axis in zip(panels, (1, 0, 2), strict=True):
        _draw_angle(panel, flights, axis, desired=axis != 1)
    return figure


def response_figure(flights: Sequence[PaperFlight], path: str, number: int) -> Figure:
    """Draw Fig. 22 or 24, its `number`: travel and elevation along a `path`, which the title names."""
    figure, panels = _figure_with_panels(2, f"Response during flight along the {path} (after Fig. {number})")
    for letter, panel, axis in zip("ab", panels, (2, 0), strict=True):
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
    for letter, panel, axis in zip("ab", panels, (2, 0), strict=True):
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
    return float(flight.flight.t_s[rows[0]]) + _SETTLE_S if rows.size else 0.0


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
        if axis == 1:
            label = f"{flight.label}, setpoint"
            panel.plot(flight.flight.t_s, flight.desired_deg[:, 1], ":", color=colour, lw=0.7, label=label)
    finish(panel, f"{AXES[axis]} [deg]")
