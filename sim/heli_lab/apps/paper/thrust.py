"""Simulate the scales under the rotors for Fig. 15; `heli_sim.bench` fits the line (31) to their readings."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.bench.thrust_curve import SCALE_N
from heli_sim.plant import Plant


class ThrustScale:
    """Scales under both rotors of a locked rig, with a resolution of one gram."""

    def __init__(self, plant: Plant) -> None:
        """Compile the thrust of both rotors of a plant as a function of state and voltages."""
        model = plant.model
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        driven = model.driven(x, u, ca.SX(model.parameter_values(plant.rig)))
        self._thrust_N = ca.Function("thrust_N", [x, u], [driven.thrust_N])

    def read_N(self, state: Floats, volts_V: Sequence[float]) -> Floats:
        """Return the thrust of the front and the back rotor [N], shape (2,), rounded to the resolution.
        Shapes: `state` (n,).
        """
        exact = np.asarray(self._thrust_N(state, np.asarray(volts_V))).ravel()
        return np.round(exact / SCALE_N) * SCALE_N
