"""Encoders of a rig: counts per turn, direction, and the angle of a count, in the order of the axes."""

from __future__ import annotations

import numpy as np
from heli_host.data.arrays import Floats

from heli_sim.rig.rig import Rig
from heli_sim.rig.schema import ENCODER_COUNTS, ENCODER_DIRECTIONS


def counts_per_turn(rig: Rig) -> Floats:
    """Return the counts of each encoder for one revolution of its axis, positive, shape (3,)."""
    return np.array([rig[name].value for name in ENCODER_COUNTS])


def count_rad(rig: Rig) -> Floats:
    """Return the angle of one count of each encoder [rad], shape (3,)."""
    return 2.0 * np.pi / counts_per_turn(rig)


def directions(rig: Rig) -> Floats:
    """Return 1 for each encoder that counts up with its angle or whose direction is not known, and -1 for
    each that counts down, shape (3,).
    """
    return np.array([rig[name].value or 1.0 for name in ENCODER_DIRECTIONS])


def direction_is_known(rig: Rig) -> tuple[bool, ...]:
    """Return whether the rig file states the direction of each encoder, shape (3,)."""
    return tuple(rig[name].value != 0.0 for name in ENCODER_DIRECTIONS)
