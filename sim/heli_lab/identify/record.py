"""A flight prepared for fitting: which rows are free flight, and the size of an encoder count."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats
from heli_host.flight import Flight
from heli_host.flight.counts import count_rad
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from heli_sim.rig.encoders import count_rad as rig_count_rad

from heli_lab.errors import NotExcited
from heli_lab.identify import thresholds
from heli_lab.identify.flight_checks import (
    even_step_s,
    refuse_constant_columns,
    refuse_duty_cycles,
    refuse_jumps,
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
"""A take-off ends this far below the median elevation of a flight [deg], and a landing begins there."""


@dataclass(frozen=True)
class Cut:
    """A part of a flight from `start_s` to `stop_s` that is not fitted, and `why` in a few words."""

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

    @property
    def sigma_rad(self) -> Floats:
        """Standard deviation of the quantisation to counts, count / sqrt(12), shape (3,)."""
        return self.count_rad / math.sqrt(12.0)

    @property
    def outputs(self) -> Floats:
        """The angles, as `estimation.Recording` names them, shape (n, 3), rad."""
        return self.angles_rad

    @property
    def inputs(self) -> Floats:
        """The voltages, as `estimation.Recording` names them, shape (n, 2), V."""
        return self.voltages_V

    @property
    def resolution(self) -> Floats:
        """The encoders' counts, as `estimation.Recording` names them, shape (3,), rad."""
        return self.count_rad

    @property
    def used_s(self) -> float:
        """Seconds in free flight."""
        return sum(stop - start for start, stop in self.segments) * self.step_s


def prepare(
    flight: Flight,
    rig: Rig,
    label: str = "flight",
    *,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> Record:
    """Prepare a flight for a fit: check it, find its rows in free flight, and the angle of an encoder count.

    Rows are cut out in which the arm takes off, lands, lies on its table or touches a stop, rows at gaps,
    and rows that the board logged with its motors off.

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
    reasons, stop_notes = _reasons_to_cut(flight, rig, step_s, start_s, stop_s)
    min_rows = max(2, round(thresholds.MIN_SEGMENT_S / step_s))
    segments, cuts = _segments(reasons, flight, min_rows)
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
    """Prepare those flights that are not prepared yet.

    Parameters
    ----------
    flights : sequence of Flight or Record
        Prepared ones are taken as they are.
    rig, start_s, stop_s
        As in `prepare`.
    labels : sequence of str, optional
        Names of the flights; by default their `role` and number.
    role : str
        Use of the flights, in a word.
    """
    names = labels if labels is not None else [f"{role} {number}" for number in range(1, len(flights) + 1)]
    return tuple(
        flight if isinstance(flight, Record) else prepare(flight, rig, name, start_s=start_s, stop_s=stop_s)
        for flight, name in zip(flights, names, strict=True)
    )


def _reasons_to_cut(
    flight: Flight, rig: Rig, step_s: float, start_s: float | None, stop_s: float | None
) -> tuple[list[tuple[Booleans, str]], list[str]]:
    """Rows of a flight that are not free flight.

    Returns
    -------
    reasons : list of (ndarray of bool (n,), str)
        Rows that each reason cuts out, and the reason in a few words; the first one that applies counts.
    notes : list of str
        Remarks on stops that the flight shows to be elsewhere than in the rig file.
    """
    reasons: list[tuple[Booleans, str]] = []
    if start_s is not None or stop_s is not None:
        low_s = -math.inf if start_s is None else start_s
        high_s = math.inf if stop_s is None else stop_s
        reasons.append(((flight.t_s < low_s) | (flight.t_s >= high_s), "not asked for"))
    if flight.state is not None and flight.state_names:
        motors_off = [number for number, name in flight.state_names.items() if name in ON_GROUND]
        reasons.append((np.isin(flight.state, motors_off), "motors off"))
    near_table = _near_table(flight, rig, step_s)
    near_table |= _last_descent(flight, near_table, step_s)
    reasons.append((near_table, "table, take-off or landing"))
    at_stops, notes = _stops(flight.angles_rad, rig, step_s)
    return [*reasons, *at_stops], notes


def encoder_counts(flight: Flight, rig: Rig) -> tuple[Floats, list[str]]:
    """Angle of one count of each encoder of a flight.

    A log of the board states it. In a table it is the smallest step of the angles. For angles that are not
    in whole counts it is that of the rig.

    Returns
    -------
    count_rad : ndarray (3,)
        Angle of one count [rad].
    notes : list of str
        A sentence for each encoder whose count is that of the rig.
    """
    counts, notes = count_rad(flight), []
    for index, axis in enumerate(AXES):
        if math.isfinite(counts[index]):
            continue
        counts[index] = rig_count_rad(rig)[index]
        if np.ptp(flight.angles_rad[:, index]) > 0.0:
            notes.append(f"{axis} is not in whole counts: {2.0 * math.pi / counts[index]:g} a turn assumed")
    return counts, notes


def _near_table(flight: Flight, rig: Rig, step_s: float) -> Booleans:
    """Rows in which the arm is on the table, takes off or lands, shape (n,)."""
    elevation_deg = np.rad2deg(flight.elevation_rad)
    table_deg = _table_deg(elevation_deg, rig, step_s)
    in_contact = _in_contact(flight, rig, table_deg)
    if not in_contact.any():
        return in_contact
    # A take-off ends, and a landing begins, at the elevation of the flight.
    clear = elevation_deg > table_deg + thresholds.TAKE_OFF_DEG
    typical_deg = float(np.median(elevation_deg[clear])) if clear.any() else 0.0
    up = elevation_deg > max(table_deg + thresholds.TAKE_OFF_DEG, typical_deg - _FLIGHT_RANGE_deg)
    cut = in_contact.copy()
    settling_rows = round(thresholds.SETTLED_S / step_s)
    for edge in np.flatnonzero(np.diff(in_contact.astype(int))):
        if in_contact[edge]:
            up_after = np.flatnonzero(up[edge:])
            stop = edge + int(up_after[0]) + settling_rows if up_after.size else len(cut)
            cut[edge:stop] = True
        else:
            up_before = np.flatnonzero(up[: edge + 1])
            cut[int(up_before[-1]) if up_before.size else 0 : edge + 1] = True
    return cut


def _table_deg(elevation_deg: Floats, rig: Rig, step_s: float) -> float:
    """Elevation at which the arm lies on its table [deg]: that of the rig, or the rest of this flight if it
    begins at rest at its lowest point.
    """
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
    """Rows in which the arm, or the lower rotor of a tilted arm, touches the table, shape (n,)."""
    margin_deg = min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG) + thresholds.TABLE_MARGIN_DEG
    in_contact: Booleans = np.rad2deg(flight.elevation_rad) < table_deg + margin_deg
    # Height of the lower rotor over the length of the arm.
    rotor_reach = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
    tilt = np.abs(np.sin(flight.pitch_rad)) * np.cos(flight.elevation_rad)
    rotor_height = np.sin(flight.elevation_rad) - rotor_reach * tilt
    return in_contact | (rotor_height < math.sin(math.radians(table_deg)))


def _last_descent(flight: Flight, near_table: Booleans, step_s: float) -> Booleans:
    """Rows of the final descent after the voltages were reduced, shape (n,); the log may end above the
    table.
    """
    descent = np.zeros(len(flight), bool)
    flying = ~near_table
    lag_rows = max(1, round(thresholds.LAG_S / step_s))
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
    with_thrust = np.flatnonzero(smooth_V >= thresholds.DESCENT_VOLTAGE_SHARE * typical_V)
    high = np.flatnonzero(flight.elevation_rad > low_rad)
    if with_thrust.size and high.size:
        # Thrust for a moment on the way down does not end the descent.
        last_high = int(high[-1])
        before = with_thrust[with_thrust <= last_high]
        descent[int(before[-1]) if before.size else last_high :] = True
    return descent


def _stops(angles_rad: Floats, rig: Rig, step_s: float) -> tuple[list[tuple[Booleans, str]], list[str]]:
    """Contacts with the mechanical stops.

    Returns
    -------
    reasons : list of (ndarray of bool (n,), str)
        For each axis that reaches its stop, the rows in contact and shortly around them, and the name of the
        stop.
    notes : list of str
        A remark on each axis that goes far beyond the stop in the rig file.
    """
    reasons: list[tuple[Booleans, str]] = []
    notes = []
    around = round(thresholds.LAG_S / step_s)
    names = ("elevation_max", "pitch_max", "travel_max")
    for index, (axis, name) in enumerate(zip(AXES, names, strict=True)):
        stop, degrees = rig[name], np.rad2deg(angles_rad[:, index])
        beyond = degrees if axis == "elevation" else np.abs(degrees)
        unsure_deg = min(stop.tolerance, thresholds.MAX_UNSURE_DEG)
        at_stop = beyond > stop.value - unsure_deg - thresholds.STOP_MARGIN_DEG
        if beyond.max() > stop.value + stop.tolerance + thresholds.BEYOND_STOP_DEG:
            note = f"{axis} reaches {beyond.max():.0f} degrees, beyond the rig's {name} of {stop.value:g}"
            notes.append(f"{note}: taken to be free there")
        elif at_stop.any():
            wide = np.convolve(at_stop, np.ones(2 * around + 1), mode="same") > 0.5
            reasons.append((wide, f"stop of the {axis}"))
    return reasons, notes


def _segments(
    reasons: list[tuple[Booleans, str]], flight: Flight, min_rows: int
) -> tuple[tuple[tuple[int, int], ...], tuple[Cut, ...]]:
    """Divide a flight into free segments and cuts.

    Parameters
    ----------
    reasons : list of (ndarray of bool (n,), str)
        Rows that each reason cuts out, and the reason in a few words; the first one that applies counts.
    min_rows : int
        Rows of the shortest segment.

    Returns
    -------
    segments : tuple of (int, int)
        First row and last row plus one of each free segment.
    cuts : tuple of Cut
        All other parts.
    """
    t_s = flight.t_s
    # 0 for free flight, otherwise 1 + index of the reason.
    number = np.zeros(len(t_s), int)
    for index in reversed(range(len(reasons))):
        number[reasons[index][0]] = index + 1
    is_border = np.diff(number) != 0
    is_border[flight.gaps] = True
    edges = [0, *(int(row) + 1 for row in np.flatnonzero(is_border)), len(t_s)]
    segments, cuts = [], []
    for start, stop in itertools.pairwise(edges):
        why = reasons[number[start] - 1][1] if number[start] else ""
        if not why and stop - start < min_rows:
            why = "too short between cuts"
        if why:
            cuts.append(Cut(float(t_s[start]), float(t_s[stop - 1]), why))
        else:
            segments.append((start, stop))
    return tuple(segments), tuple(cuts)
