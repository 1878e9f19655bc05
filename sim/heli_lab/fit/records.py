"""Flights prepared for a fit: they are checked, and the rows in free flight are found."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_host.data.flight import Flight
from heli_host.data.response import count_rad
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig
from heli_sim.rig.rig import count_rad as rig_count_rad

from heli_lab.errors import IdentifyError, NotExcited
from heli_lab.fit import thresholds

_MIN_MOTION_COUNTS: Final = 10
"""Encoder counts that an axis must span to have moved. Set by judgement: noise and drift give one or two."""
_MIN_PITCH_RAD: Final = math.radians(5.0)
"""Range of pitch in a flight whose pitch is controlled, rad; equal voltages cannot control it."""
_JUMP_RAD: Final = 1.0
"""A move between two rows that no arm makes, rad: an angle that was not unwrapped jumps by 2 pi. Set by
judgement; at 500 Hz it is 500 rad/s."""
_MAX_STRAY_STEPS: Final = 5.0
"""Largest deviation of the times from an even clock, in steps. Five steps of 2 ms at the fastest travel are
half a degree: far more than any other error. Below 1, times in whole milliseconds are refused."""


def encoder_counts(flight: Flight, rig: Rig) -> tuple[Floats, list[str]]:
    """Return the angle of one count of each encoder of a flight, shape (3,), and notes on assumptions."""
    # A log of the board states this angle. In a table, it is the smallest step of the angles. If the angles
    # are not in whole counts, the count of the rig file is used.
    counts, notes = count_rad(flight), []
    for index, axis in enumerate(AXES):
        if math.isfinite(counts[index]):
            continue  # the flight shows its count
        counts[index] = rig_count_rad(rig)[index]
        if np.ptp(flight.angles_rad[:, index]) > 0.0:
            notes.append(f"{axis} is not in whole counts: {2.0 * math.pi / counts[index]:g} a turn assumed")
    return counts, notes


def even_step_s(flight: Flight, label: str) -> float:
    """Return the mean time from row to row [s], and check that the rows are evenly spaced."""
    # The mean is more exact than one difference, because times are often printed in whole milliseconds.
    steps_s = np.diff(flight.t_s)
    steps_s = np.delete(steps_s, flight.gaps)
    step_s = float(steps_s.mean())
    # Deviation of each row's time from an even clock, in steps.
    stray_steps = np.abs(np.cumsum(steps_s - step_s)) / step_s
    worst = int(np.argmax(stray_steps))
    if stray_steps[worst] > _MAX_STRAY_STEPS:
        # A step ends one row after it begins, and data rows are numbered from 1.
        raise IdentifyError(
            f"{label}: the times t_s are uneven: data row {worst + 2} is {stray_steps[worst]:.0f} steps of "
            f"{step_s:.4g} s early or late",
            "log at a constant rate, or resample the flight",
        )
    return step_s


def refuse_constant_columns(flight: Flight, label: str, count_rad: Floats) -> None:
    """Refuse a flight in which no axis moves, or in which a voltage is constant. Shapes: `count_rad` (3,)."""
    rows = len(flight)
    moved_counts = np.ptp(flight.angles_rad, axis=0) / count_rad
    if np.all(moved_counts < _MIN_MOTION_COUNTS):
        axis = int(np.argmax(moved_counts))
        raise NotExcited(
            f"{label}: the rig never moves: {AXES[axis]}_rad varies by {moved_counts[axis]:.0f} counts "
            f"from data row 1 to {rows}",
            "fly it, for example with heli-host fly identify",
        )
    for name in ("front_V", "back_V"):
        column = getattr(flight, name)
        if not np.any(column):
            reason, remedy = "0", "log the voltages that act on the motors"
        elif float(np.ptp(column)) < 1e-9:  # Rounding of a converted number
            reason, remedy = f"{column[0]:g}", "fly with voltages that change"
        else:
            continue
        raise IdentifyError(f"{label}: {name} is {reason} from data row 1 to {rows}", remedy)
    _, pitch_range_rad, _ = moved_counts * count_rad
    if np.array_equal(flight.front_V, flight.back_V) and pitch_range_rad > _MIN_PITCH_RAD:
        raise IdentifyError(
            f"{label}: front_V equals back_V from data row 1 to {rows}, although pitch moves",
            "log the voltage of each motor",
        )


def refuse_duty_cycles(flight: Flight, label: str, rig: Rig) -> None:
    """Refuse voltages that never leave the dead zone of the motors: they are probably duty cycles."""
    dead_zone = rig["dead_zone"]
    min_V = dead_zone.value - dead_zone.tolerance
    size_V = {name: np.abs(getattr(flight, name)) for name in ("front_V", "back_V")}
    larger = max(size_V, key=lambda name: float(np.max(size_V[name])))
    row = int(np.argmax(size_V[larger]))
    if size_V[larger][row] < min_V:
        raise IdentifyError(
            f"{label}: {larger} reaches {size_V[larger][row]:.3g} at most, in data row {row + 1}, which is "
            f"within the dead zone of {min_V:g} V, where no rotor gives thrust",
            "if the column is a duty cycle, multiply it by the supply voltage",
        )


def refuse_jumps(flight: Flight, label: str, segments: tuple[tuple[int, int], ...]) -> None:
    """Refuse angles that jump within a segment, as an angle does that was not unwrapped."""
    for index, axis in enumerate(AXES):
        for start, stop in segments:
            moves = np.abs(np.diff(flight.angles_rad[start:stop, index]))
            if moves.size and moves.max() > _JUMP_RAD:
                # The jump ends one row after it begins, and data rows are numbered from 1.
                row = start + int(np.argmax(moves)) + 2
                raise IdentifyError(
                    f"{label}: {axis}_rad jumps by {moves.max():.3g} in data row {row}",
                    "unwrap the angle, or cut the flight there",
                )


ON_GROUND: Final = frozenset({"idle", "armed", "fault"})
"""States of the board's supervisor in which the motors are off."""

_REST_s: Final = 0.2
"""Time at the beginning of a flight in which a rest on the table is looked for [s]."""
_REST_RANGE_deg: Final = 0.1
"""Largest range of the elevation at rest [deg]: a count of an encoder with 4096 per turn."""
_LOWEST_deg: Final = 1.0
"""Largest elevation above the lowest of a flight [deg] that still counts as the lowest."""
_RISEN_deg: Final = 10.0
"""Smallest rise from the rest to the median of a flight [deg]. Rest and level differ by some 25 deg."""
_FLIGHT_RANGE_deg: Final = 5.0
"""Take-off and landing take place more than this below the median elevation of a flight [deg]."""


@dataclass(frozen=True)
class Cut:
    """A part of a flight that is not fitted: from `start_s` to `stop_s`, and `why` in a few words."""

    start_s: float
    stop_s: float
    why: str


@dataclass(frozen=True)
class Record:
    """A flight prepared for fitting.

    Parameters
    ----------
    label : str
        Name for messages and reports, such as the file's.
    t_s : ndarray (n,)
        Times, s.
    angles_rad : ndarray (n, 3)
        Elevation, pitch and travel.
    voltages_V : ndarray (n, 2)
        Front and back voltage that act from each row to the next.
    step_s : float
        Time from one row to the next.
    count_rad : ndarray (3,)
        One count of each encoder.
    segments : tuple of (int, int)
        First row and last row plus one of each part in free flight.
    notes : tuple of str
        Further remarks on the flight, one sentence each.
    gaps : tuple of int
        Rows after which time is missing.
    advance_rows : float
        Part of a row by which the voltages act early on average, 0 to 1; see `voltage_timing`.
    """

    label: str
    t_s: Floats
    angles_rad: Floats
    voltages_V: Floats
    step_s: float
    count_rad: Floats
    segments: tuple[tuple[int, int], ...]
    cuts: tuple[Cut, ...]
    notes: tuple[str, ...] = ()
    gaps: tuple[int, ...] = ()
    advance_rows: float = 0.0

    @property
    def sigma_rad(self) -> Floats:
        """Standard deviation of the quantisation to counts, count / sqrt(12), shape (3,)."""
        return self.count_rad / math.sqrt(12.0)

    @property
    def outputs(self) -> Floats:
        """The angles, as `grey_box.Recording` names them, shape (n, 3), rad."""
        return self.angles_rad

    @property
    def inputs(self) -> Floats:
        """The voltages, as `grey_box.Recording` names them, shape (n, 2), V."""
        return self.voltages_V

    @property
    def resolution(self) -> Floats:
        """The encoders' counts, as `grey_box.Recording` names them, shape (3,), rad."""
        return self.count_rad

    def over_rows(self, values: Floats) -> Floats:
        """Average a function of the voltages over the time from each row to the next.

        Parameters
        ----------
        values : ndarray (n, 2)
            Values of the function for the logged voltages.

        Returns
        -------
        ndarray (n, 2)
            Their means: between two rows, the voltages change from those of the first to those of the second.
        """
        return averaged_over_rows(values, self.advance_rows, self.gaps)

    @property
    def used_s(self) -> float:
        """Seconds in free flight."""
        return sum(stop - start for start, stop in self.segments) * self.step_s


def averaged_over_rows(values: Floats, advance_rows: float, gaps: Sequence[int]) -> Floats:
    """Average values that change from each row to the next; see `Record.over_rows`. Shapes: `values` (n, 2);
    returns (n, 2).
    """
    if advance_rows == 0.0:
        return values
    next_values = np.concatenate((values[1:], values[-1:]))
    next_values[list(gaps)] = values[list(gaps)]
    return values + advance_rows * (next_values - values)


def prepare(
    flight: Flight,
    rig: Rig,
    label: str = "flight",
    *,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> Record:
    """Prepare a flight for a fit: check it, find its rows in free flight, and the angle of an encoder count.

    Free flight excludes the rows in which the arm takes off, lands, lies on its table or touches a stop, and
    the rows that the board logged with its motors off. A gap in the log ends a segment.

    Parameters
    ----------
    flight : Flight
        The flight, as `read_flight` checked it; gaps are allowed.
    rig : Rig
        Gives table, stops and, for angles that are not quantised, the encoders' counts.
    label : str
        Name for messages and reports.
    start_s, stop_s : float, optional
        Use only this part, on the flight's own time axis.

    Raises
    ------
    NotExcited
        When the rig never moves, or no part of the flight is free for `thresholds.MIN_SEGMENT_S`.
    IdentifyError
        When the flight has no voltages, or duty cycles in their place, when its rows are not evenly spaced,
        or when an angle jumps.
    """
    step_s = even_step_s(flight, label)
    count_rad, count_notes = encoder_counts(flight, rig)
    refuse_constant_columns(flight, label, count_rad)
    refuse_duty_cycles(flight, label, rig)
    exclusions, stop_notes = _exclusions(flight, rig, step_s, start_s, stop_s)
    min_rows = max(2, round(thresholds.MIN_SEGMENT_S / step_s))  # One row has no step
    segments, cuts = _segments_and_cuts(exclusions, flight, min_rows)
    refuse_jumps(flight, label, segments)
    if not segments:
        t_s = flight.t_s
        why = ", ".join(dict.fromkeys(cut.why for cut in cuts)) or "it is too short"
        raise NotExcited(
            f"{label}: no second of free flight in t_s {t_s[0]:g} to {t_s[-1]:g}, data row 1 to {len(t_s)} "
            f"({why})",
            "give a longer flight",
        )
    return Record(
        label=label,
        t_s=flight.t_s,
        angles_rad=flight.angles_rad,
        voltages_V=flight.voltages_V,
        step_s=step_s,
        count_rad=count_rad,
        segments=segments,
        cuts=cuts,
        notes=(*count_notes, *stop_notes),
        gaps=tuple(map(int, flight.gaps)),
    )


def prepare_all(
    flights: Sequence[Flight | Record],
    rig: Rig,
    labels: Sequence[str] | None = None,
    role: str = "flight",
    *,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> tuple[Record, ...]:
    """Prepare those flights that are not prepared yet."""
    names = labels if labels is not None else [f"{role} {number}" for number in range(1, len(flights) + 1)]
    return tuple(
        flight if isinstance(flight, Record) else prepare(flight, rig, name, start_s=start_s, stop_s=stop_s)
        for flight, name in zip(flights, names, strict=True)
    )


class _Exclusion(NamedTuple):
    """Rows of a flight that are not free flight, for one reason."""

    is_excluded: Booleans  # (n,): Whether each row of the flight is excluded
    why: str  # The reason, in a few words


def _exclusions(
    flight: Flight, rig: Rig, step_s: float, start_s: float | None, stop_s: float | None
) -> tuple[list[_Exclusion], list[str]]:
    """Find the rows of a flight that are not free flight; return them with notes on its stops."""
    exclusions: list[_Exclusion] = []
    if start_s is not None or stop_s is not None:
        low_s = -math.inf if start_s is None else start_s
        high_s = math.inf if stop_s is None else stop_s
        exclusions.append(_Exclusion((flight.t_s < low_s) | (flight.t_s >= high_s), "not asked for"))
    if flight.state is not None and flight.state_names:
        motors_off = [number for number, name in flight.state_names.items() if name in ON_GROUND]
        exclusions.append(_Exclusion(np.isin(flight.state, motors_off), "motors off"))
    near_table = _near_table(flight, rig, step_s)
    near_table |= _last_descent(flight, near_table, step_s)
    exclusions.append(_Exclusion(near_table, "table, take-off or landing"))
    at_stops, notes = _contacts_with_stops(flight.angles_rad, rig, step_s)
    return [*exclusions, *at_stops], notes


def _near_table(flight: Flight, rig: Rig, step_s: float) -> Booleans:
    """Find the rows in which the arm is on the table, takes off or lands; shape (n,)."""
    elevation_deg = np.rad2deg(flight.elevation_rad)
    table_deg = _table_deg(elevation_deg, rig, step_s)
    in_contact = _in_contact(flight, rig, table_deg)
    if not in_contact.any():
        return in_contact
    # A take-off ends, and a landing begins, near the typical elevation of the flight.
    min_clear_deg = table_deg + thresholds.TAKE_OFF_DEG
    is_clear = elevation_deg > min_clear_deg
    typical_deg = float(np.median(elevation_deg[is_clear])) if is_clear.any() else 0.0
    is_up = elevation_deg > max(min_clear_deg, typical_deg - _FLIGHT_RANGE_deg)
    near_table = in_contact.copy()
    settling_rows = round(thresholds.SETTLED_S / step_s)
    # Each row after which a contact begins or ends.
    for last_row in np.flatnonzero(np.diff(in_contact.astype(int))):
        if in_contact[last_row]:
            # The contact ends: cut the take-off that follows.
            up_after = np.flatnonzero(is_up[last_row:])
            stop = last_row + int(up_after[0]) + settling_rows if up_after.size else len(near_table)
            near_table[last_row:stop] = True
        else:
            # A contact begins in the next row: cut the landing before it.
            up_before = np.flatnonzero(is_up[: last_row + 1])
            start = int(up_before[-1]) if up_before.size else 0
            near_table[start : last_row + 1] = True
    return near_table


def _table_deg(elevation_deg: Floats, rig: Rig, step_s: float) -> float:
    """Return the elevation at which the arm lies on its table [deg]."""
    # If the flight begins at rest at its lowest point, it is the higher one of this rest and the table of the
    # rig file; otherwise that of the rig file.
    rig_deg = rig["elevation_min"].value
    first_rows = elevation_deg[: round(_REST_s / step_s)]
    start_deg = float(np.median(first_rows))
    is_at_rest = float(np.ptp(first_rows)) < _REST_RANGE_deg
    is_lowest = start_deg < elevation_deg.min() + _LOWEST_deg
    has_risen = start_deg < np.median(elevation_deg) - _RISEN_deg
    if is_at_rest and is_lowest and has_risen:
        return max(rig_deg, start_deg)
    return rig_deg


def _in_contact(flight: Flight, rig: Rig, table_deg: float) -> Booleans:
    """Find the rows in which the arm, or the lower rotor of a tilted arm, touches the table; shape (n,)."""
    margin_deg = min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG) + thresholds.TABLE_MARGIN_DEG
    in_contact: Booleans = np.rad2deg(flight.elevation_rad) < table_deg + margin_deg
    # All heights are relative to the pivot, as a share of the arm's length.
    rotor_reach = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
    tilt = np.abs(np.sin(flight.pitch_rad)) * np.cos(flight.elevation_rad)
    rotor_height = np.sin(flight.elevation_rad) - rotor_reach * tilt
    table_height = math.sin(math.radians(table_deg))
    return in_contact | (rotor_height < table_height)


def _last_descent(flight: Flight, near_table: Booleans, step_s: float) -> Booleans:
    """Find the rows of a final descent with reduced voltages, shape (n,)."""
    # Such a log may end before the arm reaches the table. No row is true if the flight ends with thrust, or
    # high.
    descent = np.zeros(len(flight), bool)
    flying = ~near_table
    lag_rows = max(1, round(thresholds.LAG_S / step_s))
    # A flight of so few rows has no typical voltage or elevation.
    if int(flying.sum()) < 4 * lag_rows:
        return descent
    total_V = flight.front_V + flight.back_V
    smooth_V = np.convolve(total_V, np.ones(lag_rows) / lag_rows, mode="same")
    typical_V = float(np.median(total_V[flying]))
    typical_rad = float(np.median(flight.elevation_rad[flying]))
    low_rad = typical_rad - math.radians(thresholds.LANDING_DEG)
    ends_with_thrust = float(total_V[-lag_rows:].mean()) > thresholds.LANDING_VOLTAGE_SHARE * typical_V
    if ends_with_thrust or flight.elevation_rad[-1] > low_rad:
        return descent
    rows_with_thrust = np.flatnonzero(smooth_V >= thresholds.DESCENT_VOLTAGE_SHARE * typical_V)
    high_rows = np.flatnonzero(flight.elevation_rad > low_rad)
    if rows_with_thrust.size and high_rows.size:
        # The descent begins with the last thrust while the arm is high; later thrust does not end it.
        last_high = int(high_rows[-1])
        before = rows_with_thrust[rows_with_thrust <= last_high]
        start = int(before[-1]) if before.size else last_high
        descent[start:] = True
    return descent


def _contacts_with_stops(angles_rad: Floats, rig: Rig, step_s: float) -> tuple[list[_Exclusion], list[str]]:
    """Find the contacts with the mechanical stops; return them with notes on angles beyond a stop."""
    exclusions: list[_Exclusion] = []
    notes = []
    lag_rows = round(thresholds.LAG_S / step_s)
    names = ("elevation_max", "pitch_max", "travel_max")
    for index, (axis, name) in enumerate(zip(AXES, names, strict=True)):
        stop, angle_deg = rig[name], np.rad2deg(angles_rad[:, index])
        # Pitch and travel have a stop on either side.
        deflection_deg = angle_deg if axis == "elevation" else np.abs(angle_deg)
        unsure_deg = min(stop.tolerance, thresholds.MAX_UNSURE_DEG)
        at_stop = deflection_deg > stop.value - unsure_deg - thresholds.STOP_MARGIN_DEG
        largest_deg = deflection_deg.max()
        if largest_deg > stop.value + stop.tolerance + thresholds.BEYOND_STOP_DEG:
            note = f"{axis} reaches {largest_deg:.0f} deg, beyond the rig's {name} of {stop.value:g}"
            notes.append(f"{note}: taken to be free there")
        elif at_stop.any():
            # Also the rows just before and after a contact.
            near_stop = np.convolve(at_stop, np.ones(2 * lag_rows + 1), mode="same") > 0.5
            exclusions.append(_Exclusion(near_stop, f"stop of the {axis}"))
    return exclusions, notes


def _segments_and_cuts(
    exclusions: list[_Exclusion], flight: Flight, min_rows: int
) -> tuple[tuple[tuple[int, int], ...], tuple[Cut, ...]]:
    """Divide a flight into segments of free flight, given as first row and last row plus one, and cuts."""
    t_s = flight.t_s
    reasons = ["", *(exclusion.why for exclusion in exclusions)]
    # Number of the reason in each row; 0 is free flight. The first exclusion is written last and wins.
    reason_number = np.zeros(len(t_s), int)
    for number, exclusion in reversed(list(enumerate(exclusions, 1))):
        reason_number[exclusion.is_excluded] = number
    is_border = np.diff(reason_number) != 0
    is_border[flight.gaps] = True
    edges = [0, *(int(row) + 1 for row in np.flatnonzero(is_border)), len(t_s)]
    segments, cuts = [], []
    for start, stop in itertools.pairwise(edges):
        why = reasons[reason_number[start]]
        if not why and stop - start < min_rows:
            why = "too short between cuts"
        if why:
            cuts.append(Cut(float(t_s[start]), float(t_s[stop - 1]), why))
        else:
            segments.append((start, stop))
    return tuple(segments), tuple(cuts)
