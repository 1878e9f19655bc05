"""Weigh the two mirror images of a flight by the constant travel torque of a known rig."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from heli_lab.guess import thresholds
from heli_lab.guess.ambiguities import SignChanges
from heli_lab.guess.regression.assignment import ColumnAssignment
from heli_lab.guess.regression.axis_regression import sum_and_difference
from heli_lab.guess.regression.reference import Reference
from heli_lab.guess.regression.signals import Signals, filtered_signal

_EVERY: Final = 10

_OTHER_WAY: Final = 0.1
"""Share of rigs whose torque has the opposite direction to the rig file's. Set by judgement: cables pull
either way, and on measured flights of four rigs, the constant acceleration had this direction in two."""


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
    # The torque of one rig in ten points the other way, which bounds the weight of every flight.
    ratio = math.exp(min(max(2.0 * measured * expected / std**2, -50.0), 50.0))
    return math.log(((1.0 - _OTHER_WAY) * ratio + _OTHER_WAY) / (_OTHER_WAY * ratio + 1.0 - _OTHER_WAY))


def prefers_mirror(signs: SignChanges, torque_nats: float) -> bool:
    """Whether the torque outweighs the fewest changes of sign.

    Each further change of sign or exchange of motors counts `SIGN_CHANGE_NATS` against the mirror image.

    Parameters
    ----------
    signs : SignChanges
        Proposed changes of sign.
    torque_nats : float
        Result of `travel_torque_nats`.
    """
    changes = signs.motors_swapped + (signs.pitch < 0.0) + (signs.travel < 0.0)
    mirrored = (not signs.motors_swapped) + (signs.pitch > 0.0) + (signs.travel > 0.0)
    return torque_nats < -thresholds.SIGN_CHANGE_NATS * (mirrored - changes)
