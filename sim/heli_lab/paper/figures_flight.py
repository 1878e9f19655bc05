"""Counterparts of Figs. 21 to 25: hover, the irregular path, the sines; each flown with two sets of gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_sim.model.parts import AXES

from heli_lab.errors import IdentifyError
from heli_lab.paper.figures_bench import GREY, MEASURED, MODEL, PRINTED

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_COLOURS: Final = (PRINTED, MODEL)
_WIDTH, _HEIGHT, _SMALL = 7.0, 2.7, 8
# A path that the host streams is on board a little later; and the last tick before a landing is no flight.
_END_S: Final = 0.1


@dataclass(frozen=True)
class Flown:
    """A flight to be drawn.

    Parameters
    ----------
    label : str
        Which gains flew it.
    flight : Flight
        Closed-loop part of a log, time 0 at the take-off.
    desired_deg : ndarray (n, 3)
        What the plan asked of elevation, pitch and travel; pitch as its own loop was asked.
    outcome : str
        ``completed``, or what ended it.
    """

    label: str
    flight: Flight
    desired_deg: Floats
    outcome: str

    @property
    def error_deg(self) -> Floats:
        """Measured minus desired, shape (n, 3)."""
        result: Floats = np.rad2deg(self.flight.angles_rad) - self.desired_deg
        return result


def flown(label: str, flight: Flight, desired_deg: Floats, outcome: str) -> Flown:
    """Cut the closed-loop part, from take-off to the end of the plan, out of a log.

    Parameters
    ----------
    label : str
        Which gains flew it.
    desired_deg : ndarray (n, 3)
        Elevation, pitch and travel that the plan asked for at each row, pitch being ignored.
    outcome : str
        How the flight ended.

    Raises
    ------
    IdentifyError
        When the log holds no closed-loop flight.
    """
    names = {name: number for number, name in flight.state_names.items()}
    if flight.state is None or flight.setpoints_rad is None:
        raise IdentifyError(f"{label}: the log holds no states or setpoints", "record it with heli-host fly")
    rows = np.flatnonzero(flight.state == names["closed_loop"])
    if rows.size == 0:
        raise IdentifyError(
            f"{label}: the board never closed its loops ({outcome})", "record a flight that takes off"
        )
    start_s, stop_s = float(flight.t_s[rows[0]]), float(flight.t_s[rows[-1]]) - _END_S
    cut = flight.between(start_s, stop_s)
    keep = (flight.t_s >= start_s) & (flight.t_s < stop_s)
    wanted = desired_deg[keep].copy()
    wanted[:, 1] = np.rad2deg(flight.setpoints_rad[keep, 1])
    shifted = Flight(
        cut.t_s - start_s, cut.front_V, cut.back_V, cut.elevation_rad, cut.pitch_rad, cut.travel_rad
    )
    return Flown(label, shifted, wanted, outcome)


def hover_figure(flights: Sequence[Flown]) -> Figure:
    """Draw Fig. 21: pitch, elevation and travel while hovering, on one time axis."""
    figure, panels = _panels(3, "Pitch, elevation and travel while hovering (after Fig. 21)")
    for panel, axis in zip(panels, (1, 0, 2), strict=True):
        _response(panel, flights, axis, desired=axis != 1)
    return figure


def response_figure(flights: Sequence[Flown], path: str, number: int) -> Figure:
    """Draw Fig. 22 or 24, its `number`: (a) travel and (b) elevation along the `path` of that name."""
    figure, panels = _panels(2, f"Response during flight along the {path} (after Fig. {number})")
    for letter, panel, axis in zip("ab", panels, (2, 0), strict=True):
        _response(panel, flights, axis, desired=True)
        panel.set_title(f"({letter}) {AXES[axis]} angle", fontsize=9)
    return figure


def performance_figure(flights: Sequence[Flown], path: str, number: int) -> Figure:
    """Draw Fig. 23 or 25, its `number`: how well (a) travel and (b) elevation follow that `path`."""
    figure, panels = _panels(
        2, f"Tracking performance along the {path} (after Fig. {number})", "; take-off left out"
    )
    for letter, panel, axis in zip("ab", panels, (2, 0), strict=True):
        for flight, colour in zip(flights, _COLOURS, strict=False):
            error = flight.error_deg[:, axis]
            aloft = flight.flight.t_s > aloft_s(flight)
            rms = float(np.sqrt(np.mean(error[aloft] ** 2))) if aloft.any() else float("nan")
            label = f"{flight.label}: {rms:.2f} deg rms"
            panel.plot(flight.flight.t_s[aloft], error[aloft], color=colour, lw=0.9, label=label)
        panel.axhline(0.0, color=GREY, lw=0.8)
        panel.set_title(f"({letter}) {AXES[axis]}", fontsize=9)
        _finish(panel, "error [deg]")
    return figure


def aloft_s(flight: Flown) -> float:
    """When the take-off is over [s]: the elevation has first reached what is desired within half a degree,
    and a second has passed.
    """
    level = np.abs(flight.error_deg[:, 0]) < _THERE_DEG
    up = level & (flight.desired_deg[:, 0] > _ALOFT_DEG)
    first = np.flatnonzero(up)
    return float(flight.flight.t_s[first[0]]) + _SETTLE_S if first.size else 0.0


_THERE_DEG: Final = 0.5
_ALOFT_DEG: Final = -1.0
_SETTLE_S: Final = 1.0


def _panels(count: int, title: str, note: str = "") -> tuple[Figure, list[Axes]]:
    """A figure of panels over one time axis."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, count * _HEIGHT), layout="constrained")
    panels = list(figure.subplots(count, 1, sharex=True))
    panels[-1].set_xlabel(f"time since the loops closed on the table [s]{note}")
    figure.suptitle(title)
    return figure, panels


def _finish(panel: Axes, label: str) -> None:
    panel.set_ylabel(label)
    panel.grid(alpha=0.25)
    panel.legend(fontsize=_SMALL, loc="best")


def _response(panel: Axes, flights: Sequence[Flown], axis: int, *, desired: bool) -> None:
    if desired:
        first = flights[0]
        panel.plot(first.flight.t_s, first.desired_deg[:, axis], "--", c=MEASURED, lw=1.0, label="desired")
    for flight, colour in zip(flights, _COLOURS, strict=False):
        label = (
            flight.label
            if flight.outcome == "completed"
            else f"{flight.label}: {flight.outcome.split(';')[0]}"
        )
        angle_deg = np.rad2deg(flight.flight.angles_rad[:, axis])
        panel.plot(flight.flight.t_s, angle_deg, color=colour, lw=0.9, label=label)
        if axis == 1:
            label = f"{flight.label}, setpoint"
            panel.plot(flight.flight.t_s, flight.desired_deg[:, 1], ":", color=colour, lw=0.7, label=label)
    _finish(panel, f"{AXES[axis]} [deg]")
