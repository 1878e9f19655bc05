"""How well each axis of a flight followed: metrics of its largest step, tracking error, effort."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from heli_host.declaration import AXES
from heli_host.flight.flight import Flight

LEAST_STEP_DEG: Final = 1.0
"""Move of a setpoint from one that was held to the next from which on it is a step. By judgement. Lower: what
trims the flight is taken for steps. Higher: small steps have no metrics."""
HELD_s: Final = 1.0
"""Time for which a setpoint stays where it is to count as held: the board shapes a step into a ramp of less,
and a sine stays nowhere. By judgement. Shorter: a sine's crests count. Longer: quick steps are missed."""
_STILL_DEG: Final = 1e-3
"""Motion of a setpoint from row to row that is rounding."""
SETTLED_SHARE: Final = 0.05
"""Share of the step within which a response counts as settled, as is usual; less is lost in draughts."""
_FLYING: Final = ("closed_loop", "streamed")


@dataclass(frozen=True)
class Response:
    """How one axis followed its setpoint.

    Parameters
    ----------
    axis : str
        Which.
    step_s : float
        When its setpoint began its largest move from one that was held to the next, on the flight's axis; nan
        where it made none.
    step_deg : float
        By how much; the metrics below are nan without a step.
    rise_s : float
        From 10 % to 90 % of the step.
    overshoot_percent : float
        Of the step.
    settling_s : float
        From the step until the angle stays within 5 % of it; nan where it does not before the next move.
    rms_deg : float
        Root mean square error over all rows under control; nan without setpoints.
    """

    axis: str
    step_s: float
    step_deg: float
    rise_s: float
    overshoot_percent: float
    settling_s: float
    rms_deg: float


def responses(flight: Flight) -> tuple[Response, ...]:
    """Measure each axis of a flight, in the order elevation, pitch, travel."""
    flown = under_control(flight)
    return tuple(_response(flight, axis, flown) for axis in AXES)


def effort_V(flight: Flight) -> float:
    """Root mean square of both motors' voltages under control, V; nan where a flight never was."""
    flown = flight.voltages_V[under_control(flight)]
    return float(np.sqrt(np.mean(flown**2))) if flown.size else math.nan


def under_control(flight: Flight) -> NDArray[np.bool_]:
    """Rows in which a control law flew, shape (n,); all of a flight without states."""
    if flight.state is None:
        return np.ones(len(flight), bool)
    numbers = [number for number, name in flight.state_names.items() if name in _FLYING]
    return np.isin(flight.state, numbers)


def _response(flight: Flight, axis: str, flown: NDArray[np.bool_]) -> Response:
    setpoint = getattr(flight, f"{axis}_setpoint_rad")
    nan = math.nan
    none = Response(axis, nan, nan, nan, nan, nan, nan)
    if setpoint is None or not flown.any():
        return none
    angle_deg, wanted_deg = np.rad2deg(getattr(flight, f"{axis}_rad")), np.rad2deg(setpoint)
    rms_deg = float(np.sqrt(np.mean((angle_deg - wanted_deg)[flown] ** 2)))
    moves = _moves(flight, wanted_deg, flown)
    if not moves:
        return replace(none, rms_deg=rms_deg)
    first, stop = max(moves, key=lambda move: abs(wanted_deg[move[1] - 1] - wanted_deg[move[0]]))
    size_deg, t_s = float(wanted_deg[stop - 1] - wanted_deg[first]), flight.t_s[first:stop]
    rise_s, overshoot, settling_s = _step_info(
        t_s - t_s[0], (angle_deg[first:stop] - wanted_deg[first]) / size_deg
    )
    return Response(axis, float(t_s[0]), size_deg, rise_s, overshoot, settling_s, rms_deg)


def _moves(
    flight: Flight, wanted_deg: NDArray[np.float64], flown: NDArray[np.bool_]
) -> list[tuple[int, int]]:
    """Steps of a setpoint as rows: where it leaves the place it was held at, and where it leaves the next."""
    still = np.concatenate(
        ([False], (np.abs(np.diff(wanted_deg)) < _STILL_DEG) & flown[1:] & flown[:-1], [False])
    )
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    least = round(HELD_s / max(flight.step_s, 1e-9))
    held = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= least]
    return [
        (before[1], after[1])
        for before, after in itertools.pairwise(held)
        if flown[before[1] : after[0] + 1].all()
        and abs(wanted_deg[after[0]] - wanted_deg[before[1]]) > LEAST_STEP_DEG
    ]


def _step_info(t_s: NDArray[np.float64], share: NDArray[np.float64]) -> tuple[float, float, float]:
    """Rise time, overshoot in per cent and settling time of a response to a step from 0 to 1, as
    `control.step_info` has them; that takes two seconds to import.
    """
    reached = [np.flatnonzero(share >= level) for level in (0.1, 0.9)]
    rise_s = float(t_s[reached[1][0]] - t_s[reached[0][0]]) if reached[1].size else math.nan
    outside = np.flatnonzero(np.abs(share - 1.0) > SETTLED_SHARE)
    settled = not outside.size or outside[-1] < len(share) - 1
    settling_s = float(t_s[outside[-1] + 1] if outside.size else 0.0) if settled else math.nan
    return rise_s, 100.0 * max(float(share.max()) - 1.0, 0.0), settling_s
