"""A flight prepared for fitting: which rows are free flight, and the size of an encoder count."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats
from heli_host.flight import Flight
from heli_host.flight.counts import count_rad
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from heli_sim.rig.encoders import count_rad as rig_count_rad

from heli_lab.errors import IdentifyError, NotExcited
from heli_lab.identify import thresholds

ON_GROUND: Final = frozenset({"idle", "armed", "fault"})
"""States of the board's supervisor in which the motors are off."""


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
    """Find the rows in free flight and the size of a count.

    Take-off, landing, standing on the table, contact with a stop, gaps, and what the board logged with its
    motors off are cut out.

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
        When nothing flies in it: it never moves, or no second of it is free.
    IdentifyError
        When it is not sound: it has no voltages, or duties in their place, its rows are not evenly spaced, or
        an angle jumps.
    """
    angles, volts, t_s = flight.angles_rad, flight.voltages_V, flight.t_s
    step_s = _step_s(flight, label)
    counts_rad, notes = encoder_counts(flight, rig)
    _refuse_dead_columns(flight, label, counts_rad)
    _refuse_duties(flight, label, rig)

    reasons: list[tuple[Booleans, str]] = []
    if start_s is not None or stop_s is not None:
        low, high = -math.inf if start_s is None else start_s, math.inf if stop_s is None else stop_s
        reasons.append(((t_s < low) | (t_s >= high), "not asked for"))
    if flight.state is not None and flight.state_names:
        off = [number for number, name in flight.state_names.items() if name in ON_GROUND]
        reasons.append((np.isin(flight.state, off), "motors off"))
    near_table = _near_table(flight, rig, step_s)
    near_table |= _last_descent(flight, near_table, step_s)
    reasons.append((near_table, "table, take-off or landing"))
    for axis, at_stop, note in _stops(angles, rig, step_s):
        reasons.append((at_stop, f"stop of the {axis}"))
        notes += note
    gaps = flight.gaps
    gap = np.zeros(len(t_s), bool)
    gap[gaps] = True

    segments, cuts = _segments(reasons, gap, t_s, max(2, round(thresholds.MIN_SEGMENT_S / step_s)))
    _refuse_jumps(flight, label, segments)
    record = Record(
        label, t_s, angles, volts, step_s, counts_rad, segments, cuts, tuple(notes), tuple(map(int, gaps))
    )
    if not segments:
        why = ", ".join(dict.fromkeys(cut.why for cut in cuts)) or "it is too short"
        raise NotExcited(
            f"{label}: no second of free flight in t_s {t_s[0]:g} to {t_s[-1]:g}, data row 1 to {len(t_s)} "
            f"({why})",
            "give a longer flight",
        )
    return record


def _step_s(flight: Flight, label: str) -> float:
    """Time from row to row; the mean, because times are often printed in whole milliseconds."""
    steps_s = np.diff(flight.t_s)
    steps_s = np.delete(steps_s, flight.gaps)
    step_s = float(steps_s.mean())
    stray = np.abs(np.cumsum(steps_s - step_s)) / step_s
    worst = int(np.argmax(stray))
    if stray[worst] > thresholds.MAX_STRAY_STEPS:
        raise IdentifyError(
            f"{label}: t_s differs by {stray[worst]:.0f} steps of {step_s:.4g} s from even steps at data row "
            f"{worst + 2}",
            "log with an even clock, or resample the flight",
        )
    return step_s


def _refuse_duties(flight: Flight, label: str, rig: Rig) -> None:
    dead_zone = rig["dead_zone"]
    least_V = dead_zone.value - dead_zone.tolerance
    highest = max(("front_V", "back_V"), key=lambda name: float(np.max(np.abs(getattr(flight, name)))))
    column = np.abs(getattr(flight, highest))
    row = int(np.argmax(column))
    if column[row] < least_V:
        raise IdentifyError(
            f"{label}: {highest} reaches {column[row]:.3g} at most, in data row {row + 1}, which is "
            f"within the dead zone of {least_V:g} V, where no rotor gives thrust",
            "if the column is a duty cycle, multiply it by the supply voltage",
        )


def _refuse_jumps(flight: Flight, label: str, segments: tuple[tuple[int, int], ...]) -> None:
    for index, axis in enumerate(AXES):
        for start, stop in segments:
            moves = np.abs(np.diff(flight.angles_rad[start:stop, index]))
            if moves.size and moves.max() > thresholds.JUMP_RAD:
                row = start + int(np.argmax(moves)) + 2
                raise IdentifyError(
                    f"{label}: {axis}_rad jumps by {moves.max():.3g} in data row {row}",
                    "unwrap the angle, or cut the flight there",
                )


def encoder_counts(flight: Flight, rig: Rig) -> tuple[Floats, list[str]]:
    """Return one count of each encoder of a flight [rad], shape (3,).

    A log states its board's counts, and a table shows them in its angles. For angles that are not in whole
    counts they are the rig's, and a note says so.
    """
    counts, notes = count_rad(flight), []
    for index, axis in enumerate(AXES):
        if math.isfinite(counts[index]):
            continue
        counts[index] = rig_count_rad(rig)[index]
        if np.ptp(flight.angles_rad[:, index]) > 0.0:
            notes.append(f"{axis} is not in whole counts: {2.0 * math.pi / counts[index]:g} a turn assumed")
    return counts, notes


def _refuse_dead_columns(flight: Flight, label: str, count_rad: Floats) -> None:
    rows = len(flight)
    moved = np.ptp(flight.angles_rad, axis=0) / count_rad
    if np.all(moved < thresholds.MIN_MOTION_COUNTS):
        most = int(np.argmax(moved))
        raise NotExcited(
            f"{label}: the rig never moves: {AXES[most]}_rad varies by {moved[most]:.0f} counts "
            f"from data row 1 to {rows}",
            "fly it, for example with heli-host fly identify",
        )
    for name in ("front_V", "back_V"):
        column = getattr(flight, name)
        if not np.any(column):
            raise IdentifyError(
                f"{label}: {name} is 0 from data row 1 to {rows}",
                "log the voltages that act on the motors",
            )
        if float(np.ptp(column)) < 1e-9:
            raise IdentifyError(
                f"{label}: {name} is {column[0]:g} from data row 1 to {rows}",
                "fly with voltages that change",
            )


def _near_table(flight: Flight, rig: Rig, step_s: float) -> Booleans:
    """Rows on the table, taking off or landing."""
    elevation_deg = np.rad2deg(flight.elevation_rad)
    table_deg = rig["elevation_min"].value
    rest = round(0.2 / step_s)
    start_deg = float(np.median(elevation_deg[:rest]))
    # A flight that begins at rest at its own lowest point begins on its table, wherever the rig has it.
    at_rest = float(np.ptp(elevation_deg[:rest])) < 0.1
    if at_rest and start_deg < elevation_deg.min() + 1.0 and start_deg < np.median(elevation_deg) - 10.0:
        table_deg = max(table_deg, start_deg)
    contact = (
        elevation_deg
        < table_deg
        + min(rig["elevation_min"].tolerance, thresholds.MAX_UNSURE_DEG)
        + thresholds.TABLE_MARGIN_DEG
    )
    # An arm that leans far reaches the table with its lower rotor long before it stands on it.
    share = (rig["L_h"].value + thresholds.ROTOR_m) / rig["L_a"].value
    low = np.sin(flight.elevation_rad) - share * np.abs(np.sin(flight.pitch_rad)) * np.cos(
        flight.elevation_rad
    )
    contact |= low < math.sin(math.radians(table_deg))
    if not contact.any():
        return contact
    clear = elevation_deg > table_deg + thresholds.TAKE_OFF_DEG
    typical_deg = float(np.median(elevation_deg[clear])) if clear.any() else 0.0
    up = elevation_deg > max(table_deg + thresholds.TAKE_OFF_DEG, typical_deg - 5.0)
    cut = contact.copy()
    tail = round(thresholds.SETTLED_S / step_s)
    edges = np.flatnonzero(np.diff(contact.astype(int)))
    for edge in edges:
        if contact[edge]:
            above = np.flatnonzero(up[edge:])
            cut[edge : edge + (int(above[0]) + tail if above.size else len(cut))] = True
        else:
            before = np.flatnonzero(up[: edge + 1])
            cut[int(before[-1]) if before.size else 0 : edge + 1] = True
    return cut


def _last_descent(flight: Flight, near_table: Booleans, step_s: float) -> Booleans:
    """Rows of the descent at the end of a flight whose voltages were reduced, whether or not the log
    continues to the table.
    """
    descent = np.zeros(len(flight), bool)
    flying = ~near_table
    tail = max(1, round(thresholds.LAG_S / step_s))
    if int(flying.sum()) < 4 * tail:
        return descent
    total_V = flight.front_V + flight.back_V
    smooth_V = np.convolve(total_V, np.ones(tail) / tail, mode="same")
    typical_V = float(np.median(total_V[flying]))
    below_rad = float(np.median(flight.elevation_rad[flying])) - math.radians(thresholds.LANDING_DEG)
    if (
        float(total_V[-tail:].mean()) > thresholds.LANDING_VOLTAGE_SHARE * typical_V
        or flight.elevation_rad[-1] > below_rad
    ):
        return descent
    held = np.flatnonzero(smooth_V >= thresholds.DESCENT_VOLTAGE_SHARE * typical_V)
    above = np.flatnonzero(flight.elevation_rad > below_rad)
    if held.size and above.size:
        # A gust of voltage on the way down does not make it a flight again.
        last = int(above[-1])
        before = held[held <= last]
        descent[int(before[-1]) if before.size else last :] = True
    return descent


def _stops(angles_rad: Floats, rig: Rig, step_s: float) -> list[tuple[str, Booleans, list[str]]]:
    reasons: list[tuple[str, Booleans, list[str]]] = []
    around = round(thresholds.LAG_S / step_s)
    names = ("elevation_max", "pitch_max", "travel_max")
    for index, (axis, name) in enumerate(zip(AXES, names, strict=True)):
        stop, degrees = rig[name], np.rad2deg(angles_rad[:, index])
        beyond = degrees if axis == "elevation" else np.abs(degrees)
        at_stop = (
            beyond > stop.value - min(stop.tolerance, thresholds.MAX_UNSURE_DEG) - thresholds.STOP_MARGIN_DEG
        )
        if not at_stop.any():
            continue
        if beyond.max() > stop.value + stop.tolerance + thresholds.BEYOND_STOP_DEG:
            note = f"{axis} reaches {beyond.max():.0f} degrees, beyond the rig's {name} of {stop.value:g}"
            reasons.append((axis, np.zeros_like(at_stop), [f"{note}: taken to be free there"]))
            continue
        wide = np.convolve(at_stop, np.ones(2 * around + 1), mode="same") > 0.5
        reasons.append((axis, wide, []))
    return reasons


def _segments(
    reasons: list[tuple[Booleans, str]], gap: Booleans, t_s: Floats, least: int
) -> tuple[tuple[tuple[int, int], ...], tuple[Cut, ...]]:
    code = np.zeros(len(t_s), int)  # 0: free; else 1 + index of the first reason
    for index in reversed(range(len(reasons))):
        code[reasons[index][0]] = index + 1
    borders = np.flatnonzero((np.diff(code) != 0) | gap[:-1]) + 1
    edges = [0, *(int(border) for border in borders), len(t_s)]
    segments, cuts = [], []
    for start, stop in itertools.pairwise(edges):
        why = reasons[code[start] - 1][1] if code[start] else ""
        if not why and stop - start < least:
            why = "too short between cuts"
        if why:
            cuts.append(Cut(float(t_s[start]), float(t_s[stop - 1]), why))
        else:
            segments.append((start, stop))
    return tuple(segments), tuple(cuts)
