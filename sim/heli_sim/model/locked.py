"""A model with locked axes, to which bench tests are fitted."""

from __future__ import annotations

import casadi as ca
from heli_host.data.arrays import Floats
from typing_extensions import override

from heli_sim.model.base import Model, Operands
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig


class Locked(Model):
    """A model with locked axes: they do not accelerate, and the others feel the reactions of the locks."""

    def __init__(self, model: Model, locked: tuple[bool, bool, bool]) -> None:
        self._model = model
        self._locked = ca.SX([float(is_locked) for is_locked in locked])
        locked_axes = [axis for axis, is_locked in zip(AXES, locked, strict=True) if is_locked]
        self.name = f"{model.name} with {' and '.join(locked_axes) or 'nothing'} locked"
        self.effects = model.effects
        self.states, self.inputs, self.parameters = model.states, model.inputs, model.parameters
        self.delay = model.delay

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        return self._model.acceleration(at, thrust_N, torque_Nm)

    @override
    def dynamics(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, locked: ca.SX | None = None
    ) -> ca.SX:
        # A locked axis keeps its rate. A fit estimates that rate from the flight, and finds that it is 0.
        all_locked = self._locked if locked is None else ca.fmax(self._locked, locked)
        return self._model.dynamics(x, u, p, time_s, all_locked)

    @override
    def parameter_values(self, rig: Rig) -> Floats:
        return self._model.parameter_values(rig)
