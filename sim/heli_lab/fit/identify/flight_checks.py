"""Checks of a flight before it is fitted: encoder counts, even times, angles that move, voltages that act."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.response import count_rad
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from heli_sim.rig.encoders import count_rad as rig_count_rad

from heli_lab.errors import IdentifyError, NotExcited

_MIN_MOTION_COUNTS: Final = 10
"""Encoder counts that an axis must span to have moved. Set by judgement: noise and drift give one or two."""
_JUMP_RAD: Final = 1.0
"""A move between two rows that no arm makes, rad: an angle that was not unwrapped jumps by 2 pi. Set by
judgement; at 500 Hz it is 500 rad/s."""
_MAX_STRAY_STEPS: Final = 5.0
"""Largest deviation of the times from an even clock, in steps. Five steps of 2 ms at the fastest travel are
half a degree: far more than any other error. Below 1, times in whole milliseconds are refused."""


def encoder_counts(flight: Flight, rig: Rig) -> tuple[Floats, list[str]]:
    """Return the angle of one count of each encoder of a flight. Returns shape `count_rad` (3,).

    A log of the board states this angle. In a table, it is the smallest step of the angles. If the angles are
    not in whole counts, the count of the rig file is used.
    """
    counts, notes = count_rad(flight), []
    for index, axis in enumerate(AXES):
        if math.isfinite(counts[index]):
            continue
        counts[index] = rig_count_rad(rig)[index]
        if np.ptp(flight.angles_rad[:, index]) > 0.0:
            notes.append(f"{axis} is not in whole counts: {2.0 * math.pi / counts[index]:g} a turn assumed")
    return counts, notes


def even_step_s(flight: Flight, label: str) -> float:
    """Return the mean time from row to row [s], and check that the rows are evenly spaced.

    The mean is more exact than one difference, because times are often printed in whole milliseconds.
    """
    steps_s = np.diff(flight.t_s)
    steps_s = np.delete(steps_s, flight.gaps)
    step_s = float(steps_s.mean())
    # Deviation of each row's time from an even clock, in steps.
    stray_steps = np.abs(np.cumsum(steps_s - step_s)) / step_s
    worst = int(np.argmax(stray_steps))
    if stray_steps[worst] > _MAX_STRAY_STEPS:
        raise IdentifyError(
            f"{label}: the times t_s are uneven: data row {worst + 2} is {stray_steps[worst]:.0f} steps of "
            f"{step_s:.4g} s early or late",
            "log at a constant rate, or resample the flight",
        )
    return step_s


def refuse_constant_columns(flight: Flight, label: str, count_rad: Floats) -> None:
    """Refuse a flight in which no axis moves, or in which a voltage is constant. Shapes: `count_rad` (3,)."""
    rows = len(flight)
    moved = np.ptp(flight.angles_rad, axis=0) / count_rad
    if np.all(moved < _MIN_MOTION_COUNTS):
        most_moved = int(np.argmax(moved))
        raise NotExcited(
            f"{label}: the rig never moves: {AXES[most_moved]}_rad varies by {moved[most_moved]:.0f} counts "
            f"from data row 1 to {rows}",
            "fly it, for example with heli-host fly identify",
        )
    for name in ("front_V", "back_V"):
        column = getattr(flight, name)
        if not np.any(column):
            reason, remedy = "0", "log the voltages that act on the motors"
        elif float(np.ptp(column)) < 1e-9:
            reason, remedy = f"{column[0]:g}", "fly with voltages that change"
        else:
            continue
        raise IdentifyError(f"{label}: {name} is {reason} from data row 1 to {rows}", remedy)


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
                row = start + int(np.argmax(moves)) + 2
                raise IdentifyError(
                    f"{label}: {axis}_rad jumps by {moves.max():.3g} in data row {row}",
                    "unwrap the angle, or cut the flight there",
                )
