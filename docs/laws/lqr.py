"""LQR: the gains that cost least, by python-control, on the rig's own linear model."""

import control
import numpy as np
from heli_lab.control.tune import linear_plant
from heli_lab.law import from_gain, law_rig

plant = linear_plant(law_rig())


def without_rotors(A, B):
    """Thrust follows the voltage at once: its state is -A B / A of the others."""
    return A[:-1, :-1], A[:-1, -1:] * (-B[-1] / A[-1, -1])


elevation = control.lqr(*without_rotors(plant.elevation_A, plant.elevation_B), np.diag([80.0, 8.0]), [[1.0]])[
    0
]
tilt = control.lqr(*without_rotors(plant.tilt_A, plant.tilt_B), np.diag([4.0, 12.0, 0.4, 12.0]), [[4.0]])[0]

# Of collective and differential, on elevation, pitch, travel and their rates.
K = np.zeros((2, 6))
K[0, [0, 3]] = elevation
K[1, [1, 2, 4, 5]] = tilt
LAW = from_gain(K, hover_V=plant.hover_V, name="lqr")
