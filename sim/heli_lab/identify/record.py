"""Prepare a flight for fitting: find the rows in free flight, and the angle of an encoder count."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats
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
from heli_lab.identify.free_flight import Cut, divide, reasons_to_cut


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
    reasons, stop_notes = reasons_to_cut(flight, rig, step_s, start_s, stop_s)
    min_rows = max(2, round(thresholds.MIN_SEGMENT_S / step_s))
    segments, cuts = divide(reasons, flight, min_rows)
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


def encoder_counts(flight: Flight, rig: Rig) -> tuple[Floats, list[str]]:
    """Return the angle of one count of each encoder of a flight.

    A log of the board states this angle. In a table, it is the smallest step of the angles. If the angles are
    not in whole counts, the count of the rig file is used.

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
