"""Weigh the two mirror images of a flight by the constant travel torque of a known rig."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from heli_lab.guess import thresholds
from heli_lab.guess.ambiguities import SignChanges
from heli_lab.guess.assignment import ColumnAssignment
from heli_lab.guess.axis_regression import sum_and_difference
from heli_lab.guess.reference import Reference
from heli_lab.guess.refusals import names_state_voltages
from heli_lab.guess.signals import Signals, filtered_signal

_EVERY = 10


def travel_torque_nats(
    signals: Signals,
    assignment: ColumnAssignment,
    reference: Reference,
    rad: Mapping[str, float],
    sign: float,
) -> float:
    """Weigh a flight against its mirror image by the constant acceleration of travel.

    A mirror image turns travel round, and with it the pull of the cables and of the rotors' drag.

    Parameters
    ----------
    rad : Mapping[str, float]
        Radians per unit of each angle.
    sign : float
        Sign of travel in the proposed profile.

    Returns
    -------
    float
        Log-likelihood of the flight less that of its mirror image [nats]; 0 if the rig file states no torque.
    """
    if not reference.travel_rad_s2:
        return 0.0
    travel, pitch = signals.filtered[assignment.travel], signals.filtered[assignment.pitch]
    total = filtered_signal(sum_and_difference(signals, assignment)[0]).value
    mean = float(total[signals.inner].mean())
    share = np.clip(total / mean, 0.0, 2.0) if mean > 0.5 * float(total.std()) else np.ones(total.size)
    columns = np.column_stack((np.ones(total.size), travel.rate, np.sin(rad["pitch"] * pitch.value) * share))
    rows = signals.inner
    solution, *_ = np.linalg.lstsq(columns[rows][::_EVERY], travel.acceleration[rows][::_EVERY], rcond=None)
    measured = sign * rad["travel"] * float(solution[0])
    expected, std = reference.travel_rad_s2, reference.travel_std_rad_s2
    return 2.0 * measured * expected / std**2


def prefers_mirror(signs: SignChanges, assignment: ColumnAssignment, torque_nats: float) -> bool:
    """Whether the torque outweighs the names and the fewest changes of sign.

    If the names state both motors, each further change of sign counts `SIGN_CHANGE_NATS` against the image.
    """
    if not names_state_voltages(assignment):
        return torque_nats < 0.0
    changes = signs.motors_swapped + (signs.pitch < 0.0) + (signs.travel < 0.0)
    mirrored = (not signs.motors_swapped) + (signs.pitch > 0.0) + (signs.travel > 0.0)
    return changes > 0 and torque_nats < -thresholds.SIGN_CHANGE_NATS * (mirrored - changes)
