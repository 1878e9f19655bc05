"""Decide between a flight and its mirror image by the constant travel torque of a known rig.

A flight in which front and back motor are exchanged, and pitch and travel inverted, obeys the same equations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.ambiguities import SignChanges
from heli_lab.setup.guess.regression.assignment import ColumnAssignment
from heli_lab.setup.guess.regression.axis_regression import sum_and_difference
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.signals import Signals, filtered_signal

_DECIMATION: Final = 10
"""The regression uses every tenth row: 10 Hz samples all that the low-pass filter leaves."""

_OPPOSITE_SHARE: Final = 0.1
"""Share of rigs whose torque has the opposite direction to the rig file's. Set by judgement: cables pull
in either direction, and on measured flights of four rigs, two had the opposite one."""


def travel_torque_nats(
    signals: Signals,
    assignment: ColumnAssignment,
    reference: Reference,
    rad: Mapping[str, float],
    sign: float,
) -> float:
    """Compare a flight with its mirror image by the constant acceleration of travel.

    Cables and the rotors' drag exert a constant torque about travel. A mirror image inverts travel, and thus
    also the direction of this torque.
    """
    if not reference.travel_rad_s2:
        return 0.0
    travel, pitch = signals.filtered[assignment.travel], signals.filtered[assignment.pitch]
    voltage_sum, _ = sum_and_difference(signals, assignment)
    total = filtered_signal(voltage_sum).value
    mean = float(total[signals.inner].mean())
    relative_thrust = (
        np.clip(total / mean, 0.0, 2.0) if mean > 0.5 * float(total.std()) else np.ones(total.size)
    )
    # Travel is driven by a constant torque, damping, and the horizontal part of the thrust.
    horizontal_thrust = np.sin(rad["pitch"] * pitch.value) * relative_thrust
    regressors = np.column_stack((np.ones(total.size), travel.rate, horizontal_thrust))[signals.inner]
    acceleration = travel.acceleration[signals.inner]
    solution, *_ = np.linalg.lstsq(regressors[::_DECIMATION], acceleration[::_DECIMATION], rcond=None)
    measured_rad_s2 = sign * rad["travel"] * float(solution[0])
    # Log-likelihood ratio of two normal distributions, about plus and minus the expected acceleration.
    nats = 2.0 * measured_rad_s2 * reference.travel_rad_s2 / reference.travel_std_rad_s2**2
    ratio = math.exp(min(max(nats, -50.0), 50.0))
    # A share of rigs has a torque in the opposite direction, which bounds the evidence of every flight.
    opposite = _OPPOSITE_SHARE
    return math.log(((1.0 - opposite) * ratio + opposite) / (opposite * ratio + 1.0 - opposite))


def prefers_mirror(signs: SignChanges, torque_nats: float) -> bool:
    """Whether the mirror image is more likely than the proposed signs.

    The travel torque speaks for one of the two. Each change of sign or exchange of motors that the mirror
    image needs in addition counts `SIGN_CHANGE_NATS` against the mirror image.
    """
    changes = signs.motors_swapped + (signs.pitch < 0.0) + (signs.travel < 0.0)
    changes_of_mirror = (not signs.motors_swapped) + (signs.pitch > 0.0) + (signs.travel > 0.0)
    return torque_nats < -thresholds.SIGN_CHANGE_NATS * (changes_of_mirror - changes)
