"""Tracking quality of each axis of a flight: step responses, tracking error, and effort.

The numbers are defined as in control textbooks, over the rows in which a law flew and an axis had a setpoint.
This is their only definition in the project; all other modules import them from here.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.flight import MIN_ROWS, Flight
from heli_host.declaration import AXES, Flags
from heli_host.errors import FlightDataError, check_choice

__all__ = ["Response", "Step", "StepMetrics", "effort_V", "responses", "rms", "step_metrics", "steps"]

PHASE_EVENT: Final = "phase"
"""Name of the events with which a flight marks its phases."""
TAKE_OFF: Final = "take-off"
LANDING: Final = "landing"
"""Phases around the plans."""
_OWN: Final = "closed_loop"
_STREAMED: Final = "streamed"
_NO_ERROR_rad: Final = 1.5e-4
"""Tracking error up to which a setpoint counts as a copy of the angle [rad]: a tenth of an encoder's count,
far above the rounding of a setpoint in the log."""


def flown_rows(flight: Flight) -> Booleans:
    """Return the rows in which a control law flew: the board's own, an uploaded law, or the host's. Returns
    shape (n,).
    """
    # If the flight marks its phases, only rows after the take-off and before the landing count. Without names
    # of its states, all rows count.
    rows = np.ones(len(flight), np.bool_)
    if flight.state is not None and flight.state_names:
        rows = _rows_in_state(flight, _OWN) | _rows_in_state(flight, _STREAMED)
    phases = [event for event in flight.events if event.name == PHASE_EVENT]
    flown_s = [event.t_s for event in phases if event.text not in (TAKE_OFF, LANDING)]
    if phases:
        rows &= flight.t_s >= (flown_s[0] if flown_s else np.inf)
    landing_s = [event.t_s for event in phases if event.text == LANDING]
    if landing_s:
        rows &= flight.t_s < landing_s[0]
    return rows


def led_rows(flight: Flight, axis: str) -> Booleans:
    """Return the rows of `flown_rows` in which an axis followed a setpoint. Returns shape (n,)."""
    # Some control laws have no setpoint for an axis, on the host or on the board. The log then contains the
    # measured angle as the setpoint. Such rows are left out, because their error of zero means nothing.
    rows = flown_rows(flight)
    setpoint_rad = getattr(flight, f"{axis}_setpoint_rad")
    if setpoint_rad is None:
        return np.zeros(len(flight), np.bool_)
    error_rad = np.abs(getattr(flight, f"{axis}_rad") - setpoint_rad)
    for rows_of_other_law in (_rows_in_state(flight, _STREAMED), _rows_of_uploaded_law(flight)):
        if rows_of_other_law.any() and error_rad[rows_of_other_law].max() <= _NO_ERROR_rad:
            rows = rows & ~rows_of_other_law
    return rows


_CHECK_EVENT: Final = "travel_probe"
CHECK_RETURN_s: Final = 10.0
"""Time within which travel is back after a check of its encoder [s]; docs/reference/failures.md describes the
checks. Shorter: the swing counts as an error of the law. Longer: a hover with two checks per minute is hardly
judged at all."""
_MAX_GAP_s: Final = 0.05
"""Longest gap across which a response is measured [s], a twentieth of the rise time of travel. Longer: a peak
may be missing. Shorter: a few lost ticks leave a flight without metrics."""
_TILTED: Final = ("pitch", "travel")
"""Axes that a check moves."""


def measuring_notes(flight: Flight) -> list[str]:
    """State which rows errors and step responses are without, and which rows they wrongly contain."""
    notes = []
    # The board reports the beginning and the result of each check.
    number = math.ceil(len(_check_times_s(flight)) / 2)
    if number:
        checks = "a check" if number == 1 else f"{number} checks"
        notes.append(
            f"{checks} of the silent travel encoder tilted the arm: errors and step responses of pitch and "
            f"travel, and the effort, are without {'it' if number == 1 else 'them'} and the "
            f"{CHECK_RETURN_s:g} s after {'it' if number == 1 else 'each'}"
        )
    gap_rows = _gap_rows(flight)
    if gap_rows.size:
        notes.append(
            f"rows are missing after {flight.t_s[gap_rows[0]]:.3f} s"
            f"{f' and in {gap_rows.size - 1} more places' if gap_rows.size > 1 else ''}: "
            "a step response with a gap is not measured"
        )
    if flight.state is not None and not flight.state_names:
        notes.append("the log does not name its states: rows on the table are measured, too")
    return notes


def _gap_rows(flight: Flight) -> Integers:
    """Return the last row before each gap in which a response may change, shape (k,)."""
    return np.flatnonzero(np.diff(flight.t_s) > max(_MAX_GAP_s, 2.0 * flight.step_s))


def _check_times_s(flight: Flight) -> list[float]:
    return [event.t_s for event in flight.events if event.name == _CHECK_EVENT]


def judged_rows(flight: Flight, axis: str) -> Booleans:
    """Return the rows of `led_rows` in which the law alone moved an axis: not those of a check of travel's
    encoder. Returns shape (n,).
    """
    rows = led_rows(flight, axis)
    return rows & ~_disturbed_by_check(flight) if axis in _TILTED else rows


def _disturbed_by_check(flight: Flight) -> Booleans:
    rows = np.zeros(len(flight), np.bool_)
    for time_s in _check_times_s(flight):
        rows |= (flight.t_s >= time_s) & (flight.t_s < time_s + CHECK_RETURN_s)
    return rows


def flight_under_law(flight: Flight) -> Flight:
    """Cut a flight to the rows in which an uploaded law flew; if none flew, to the rows of `flown_rows`."""
    is_flown = _rows_of_uploaded_law(flight)
    if not is_flown.any():
        is_flown = flown_rows(flight)
    rows = np.flatnonzero(is_flown)
    if rows.size < MIN_ROWS:
        raise FlightDataError("the log contains no flight of a control law", "give a flight under setpoints")
    first_s = float(flight.t_s[rows[0]])
    cut = flight.between(first_s, float(flight.t_s[rows[-1]]))
    # A check shortly before the first row still moves the arm.
    checks = tuple(
        event
        for event in flight.events
        if event.name == _CHECK_EVENT and first_s - CHECK_RETURN_s < event.t_s < first_s
    )
    others = tuple(event for event in cut.events if event.name != PHASE_EVENT)
    return replace(cut, events=(*checks, *others))


def _rows_in_state(flight: Flight, name: str) -> Booleans:
    numbers = [number for number, known in flight.state_names.items() if known == name]
    return np.zeros(len(flight), np.bool_) if flight.state is None else np.isin(flight.state, numbers)


def _rows_of_uploaded_law(flight: Flight) -> Booleans:
    if flight.flags is None:
        return np.zeros(len(flight), np.bool_)
    return np.asarray(flight.flags & Flags.LAW, np.bool_)


_REST_rad = 1e-7
"""Moves below this are rounding of printed angles."""
_WHOLE_SHARE = 0.95
_WHOLE_ERROR = 0.05
"""Angles are in whole counts if this share of the moves are multiples of the smallest, within this error in
counts. By judgement. A smaller share: estimates and filtered angles pass. A larger: a log with a few
interpolated rows does not."""


def count_rad(flight: Flight) -> Floats:
    """Return the angle of one count of each encoder [rad], shape (3,)."""
    # The counts per turn are the board's parameters if the flight has them. Otherwise they are measured, and
    # nan for angles that are not in whole counts or do not move.
    result = np.empty(len(AXES))
    for index, axis in enumerate(AXES):
        # A negative number reverses the direction on the board.
        counts = abs(flight.parameters.get(f"{axis}_counts_per_rev", 0.0))
        angle_rad = getattr(flight, f"{axis}_rad")
        result[index] = 2.0 * math.pi / counts if counts else measured_count_rad(angle_rad)
    return result


def measured_count_rad(angle_rad: Floats) -> float:
    """Measure one count of an encoder. Shapes: `angle_rad` (n,)."""
    moves = np.abs(np.diff(angle_rad))
    moves = moves[moves > _REST_rad]
    if not moves.size:
        return math.nan
    count = float(moves.min())
    # Printed angles are rounded to decimals; the mean over single counts is better than the least.
    count = float(moves[moves < 1.5 * count].mean())
    multiples = moves[moves < 50 * count] / count
    if np.mean(np.abs(multiples - np.round(multiples)) < _WHOLE_ERROR) < _WHOLE_SHARE:
        return math.nan
    turn = 2.0 * math.pi / count
    return 2.0 * math.pi / round(turn) if abs(turn / round(turn) - 1.0) < 1e-3 else count


MIN_STEP_DEG: Final = 1.0
"""Smallest difference of two held setpoints that counts as a step. By judgement. With a lower value, small
corrections would count as steps; with a higher one, small steps would have no metrics."""
HELD_s: Final = 1.0
"""Time for which a setpoint must not change to count as held. The board shapes a step into a shorter ramp. By
judgement. With a shorter time, the crests of a sine would count; with a longer one, quick steps would not."""
SETTLED_SHARE: Final = 0.05
"""Distance from the setpoint, as a share of the step, within which a response is settled. 5 % is common; less
would be hidden by disturbances."""
_HELD_DEG: Final = 0.01
_SAME_DEG: Final = 1e-3
"""Rounding of a setpoint in a log."""


@dataclass(frozen=True)
class StepMetrics:
    """Rise time, overshoot and settling time of a step response.

    Parameters
    ----------
    rise_s : float
        Time from 10 % to 90 % of the step [s]; nan if the angle does not reach 90 %.
    overshoot_percent : float
        Largest excess over the end of the step, as a share of the step [%].
    settling_s : float
        Time from the step until the angle stays within 5 % of its end [s]; nan if it never does. Between two
        counts of the encoder, the angle nearest to this end is used.
    """

    rise_s: float
    overshoot_percent: float
    settling_s: float


@dataclass(frozen=True)
class Step:
    """A step of a setpoint, from one that was held to the next.

    Parameters
    ----------
    start_s : float
        Time at which the setpoint began to move, on the flight's time axis [s].
    size_deg : float
        Size of the step [deg].
    metrics : StepMetrics
        Response of the axis, until the setpoint moves again, or a check of travel's encoder moves it; nan if
        rows are missing.
    """

    start_s: float
    size_deg: float
    metrics: StepMetrics


@dataclass(frozen=True)
class Response:
    """Tracking quality of one axis.

    Parameters
    ----------
    axis : str
        Name of the axis.
    step_s : float
        Time at which its setpoint began its largest step [s]; nan without a step.
    step_deg : float
        Size of the step [deg]; the metrics below are nan without a step, or if rows of it are missing.
    rise_s, overshoot_percent, settling_s : float
        As in `StepMetrics`.
    rms_deg : float
        Root mean square error over the rows of `judged_rows` [deg]; nan without such rows.
    """

    axis: str
    step_s: float
    step_deg: float
    rise_s: float
    overshoot_percent: float
    settling_s: float
    rms_deg: float


def responses(flight: Flight) -> tuple[Response, ...]:
    """Measure each axis of a flight, in the order elevation, pitch, travel; the largest step counts."""
    return tuple(_response(flight, axis) for axis in AXES)


def effort_V(flight: Flight) -> float:
    """Return the control effort: the RMS deviation of both motor voltages from their means, V.

    Subtracting the means removes the voltage that carries the arm. Only rows in which a control law flew
    count, without checks of travel's encoder; nan without such rows.
    """
    flown = flight.voltages_V[flown_rows(flight) & ~_disturbed_by_check(flight)]
    return float(np.sqrt(np.mean(flown.var(axis=0)))) if flown.size else math.nan


def steps(flight: Flight, axis: str) -> tuple[Step, ...]:
    """Find the steps of an axis' setpoint, and the response to each.

    Parameters
    ----------
    flight : Flight
        Flight to analyse.
    axis : str
        Name of the axis.

    Returns
    -------
    tuple of Step
        In order of time; empty for a flight without setpoints.

    Raises
    ------
    ParameterError
        There is no such axis.
    """
    check_choice("axis", axis, AXES)
    setpoint_rad = getattr(flight, f"{axis}_setpoint_rad")
    if setpoint_rad is None:
        return ()
    angle_deg, setpoint_deg = np.rad2deg(getattr(flight, f"{axis}_rad")), np.rad2deg(setpoint_rad)
    count_deg = float(np.rad2deg(count_rad(flight)[AXES.index(axis)]))
    result, gap_rows = [], _gap_rows(flight)
    for first, stop in _setpoint_steps(flight, setpoint_deg, judged_rows(flight, axis)):
        start_deg, end_deg = float(setpoint_deg[first - 1]), float(setpoint_deg[stop - 1])
        t_s = flight.t_s[first:stop]
        metrics = step_metrics(t_s - t_s[0], angle_deg[first:stop], start_deg, end_deg, count_deg)
        # A gap just before the first row hides when the step began.
        has_gap = bool(np.any((first - 1 <= gap_rows) & (gap_rows < stop - 1)))
        if has_gap:
            metrics = StepMetrics(math.nan, math.nan, math.nan)
        result.append(Step(start_s=float(t_s[0]), size_deg=end_deg - start_deg, metrics=metrics))
    return tuple(result)


def step_metrics(
    t_s: Floats, angle_deg: Floats, start_deg: float, end_deg: float, count_deg: float = math.nan
) -> StepMetrics:
    """Measure a step response, as `control.step_info` does; that takes two seconds to import.

    Parameters
    ----------
    t_s : ndarray (n,)
        Time since the step [s].
    angle_deg : ndarray (n,)
        Measured angle [deg].
    start_deg, end_deg : float
        Setpoints before and after the step [deg].
    count_deg : float
        Angle of a count of the encoder [deg]; nan if the angles are not in whole counts.
    """
    if not len(t_s):
        return StepMetrics(math.nan, math.nan, math.nan)
    size_deg = end_deg - start_deg
    completed_share = (angle_deg - start_deg) / size_deg
    # The rise lasts from 10 % to 90 % of the step.
    rows_above_10, rows_above_90 = (np.flatnonzero(completed_share >= level) for level in (0.1, 0.9))
    rise_s = float(t_s[rows_above_90[0]] - t_s[rows_above_10[0]]) if rows_above_90.size else math.nan
    if math.isfinite(count_deg):
        angle_deg = _between_counts(t_s, angle_deg, end_deg, count_deg)
    rows_outside = np.flatnonzero(np.abs(angle_deg - end_deg) > SETTLED_SHARE * abs(size_deg))
    # It has settled after the last row outside the band, unless the flight ends outside it.
    settling_s = 0.0
    if rows_outside.size:
        settled_row = int(rows_outside[-1]) + 1
        settling_s = float(t_s[settled_row]) if settled_row < len(t_s) else math.nan
    overshoot_share = max(float(completed_share.max()) - 1.0, 0.0)
    return StepMetrics(rise_s, 100.0 * overshoot_share, settling_s)


def _between_counts(t_s: Floats, angle_deg: Floats, end_deg: float, count_deg: float) -> Floats:
    """Estimate the angle between encoder counts: exact where a count changes, and a cubic between such
    edges.
    """
    # If an axis turns back within a count, or starts or ends in it, the angle may be anywhere in the count.
    # The estimate is then the angle nearest to the end of the step, `end_deg`. Otherwise a coarse encoder
    # would never settle at a setpoint between two of its counts.
    half_count_deg = 0.5 * count_deg
    edge_rows = np.flatnonzero(np.abs(np.diff(angle_deg)) > half_count_deg) + 1
    low_deg, high_deg = angle_deg - half_count_deg, angle_deg + half_count_deg
    nearest_deg: Floats = np.clip(end_deg, low_deg, high_deg)
    if len(edge_rows) < 3:
        return nearest_deg  # a parabola needs three edges
    edge_s = 0.5 * (t_s[edge_rows - 1] + t_s[edge_rows])
    edge_deg = 0.5 * (angle_deg[edge_rows - 1] + angle_deg[edge_rows])
    # Cubic Hermite: the slope at an edge is that of the parabola through this edge and its neighbours.
    interval_s, mean_slope = np.diff(edge_s), np.diff(edge_deg) / np.diff(edge_s)
    inner_slope = (mean_slope[:-1] * interval_s[1:] + mean_slope[1:] * interval_s[:-1]) / (
        interval_s[:-1] + interval_s[1:]
    )
    slope = np.concatenate((mean_slope[:1], inner_slope, mean_slope[-1:]))
    # The interval between edges that each row is in; rows beyond the outermost edges get the nearest one.
    rows = np.arange(len(t_s))
    interval = np.clip(np.searchsorted(edge_rows, rows, side="right") - 1, 0, len(interval_s) - 1)
    # x is 0 at the first edge of the interval, and 1 at its second.
    x, h_s = (t_s - edge_s[interval]) / interval_s[interval], interval_s[interval]
    cubic_deg = (
        (1.0 + 2.0 * x) * (1.0 - x) ** 2 * edge_deg[interval]
        + x * (1.0 - x) ** 2 * h_s * slope[interval]
        + x**2 * (3.0 - 2.0 * x) * edge_deg[interval + 1]
        - x**2 * (1.0 - x) * h_s * slope[interval + 1]
    )
    # Where the axis turns back within a count, both edges are the same angle.
    is_crossed = (x >= 0.0) & (x <= 1.0) & (mean_slope[interval] != 0.0)
    estimate_deg: Floats = np.where(is_crossed, np.clip(cubic_deg, low_deg, high_deg), nearest_deg)
    return estimate_deg


def rms(values: Floats) -> float:
    """Return the root mean square; nan for no values.

    Parameters
    ----------
    values : ndarray
        In any unit.
    """
    return float(np.sqrt(np.mean(values**2))) if values.size else math.nan


def _response(flight: Flight, axis: str) -> Response:
    """Return the metrics of the largest step of an axis, and its RMS tracking error; nan where a flight has
    none.
    """
    nan = math.nan
    response = Response(
        axis, step_s=nan, step_deg=nan, rise_s=nan, overshoot_percent=nan, settling_s=nan, rms_deg=nan
    )
    is_judged = judged_rows(flight, axis)
    if not is_judged.any():
        return response
    error_rad = getattr(flight, f"{axis}_rad") - getattr(flight, f"{axis}_setpoint_rad")
    response = replace(response, rms_deg=rms(np.rad2deg(error_rad[is_judged])))
    largest = max(steps(flight, axis), key=lambda step: abs(step.size_deg), default=None)
    if largest is None:
        return response
    metrics = largest.metrics
    return replace(
        response,
        step_s=largest.start_s,
        step_deg=largest.size_deg,
        rise_s=metrics.rise_s,
        overshoot_percent=metrics.overshoot_percent,
        settling_s=metrics.settling_s,
    )


def _setpoint_steps(flight: Flight, setpoint_deg: Floats, is_commanded: Booleans) -> list[tuple[int, int]]:
    """Return the steps of a setpoint: the row where it leaves a held value, and the end of the next one."""
    return [
        (first, stop)
        for (_, first), (_, stop) in itertools.pairwise(_held_stretches(flight, setpoint_deg, is_commanded))
        if is_commanded[first:stop].all()
        and abs(setpoint_deg[stop - 1] - setpoint_deg[first - 1]) > MIN_STEP_DEG
    ]


def _held_stretches(flight: Flight, setpoint_deg: Floats, is_commanded: Booleans) -> list[tuple[int, int]]:
    """Return the stretches of rows in which a setpoint is held: first row, and the row after the last."""
    rows = max(4, round(HELD_s / max(flight.step_s, 1e-9)))
    if len(setpoint_deg) <= rows:
        return []
    # `is_still` has an element for each possible first row. A sine has the same value before and after its
    # crest, so the setpoint is compared at every quarter of the time, and not only at its end.
    is_still = is_commanded[:-rows] & is_commanded[rows:]
    for quarter in (1, 2, 3, 4):
        later_deg = setpoint_deg[quarter * rows // 4 :][: len(is_still)]
        is_still = is_still & (np.abs(later_deg - setpoint_deg[: len(is_still)]) < _HELD_DEG)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], is_still, [False])).astype(np.int8)))
    stretches = []
    for first_still, stop_still in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        first, stop = first_still, stop_still + rows
        # A ramp begins so slowly that its first rows look held; they are cut off.
        level_deg = setpoint_deg[(first + stop) // 2]
        held_rows = np.flatnonzero(np.abs(setpoint_deg[first:stop] - level_deg) < _SAME_DEG)
        stretches.append((first + int(held_rows[0]), first + int(held_rows[-1]) + 1))
    return stretches
