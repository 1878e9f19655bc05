"""A model some of whose axes a pin holds: what a bench test is fitted with."""

from __future__ import annotations

from typing import Final

import casadi as ca
import numpy as np
import numpy.typing as npt

from heli_sim.model.base import Model, Operands
from heli_sim.rig import Rig

_AXES: Final = ("elevation", "pitch", "travel")


class Locked(Model):
    """A model with pinned axes: they do not accelerate, and the others feel the pins' reactions.

    Parameters
    ----------
    model : Model
        The model; effects and all.
    pinned : tuple of bool
        Which of elevation, pitch and travel are pinned.
    """

    def __init__(self, model: Model, pinned: tuple[bool, bool, bool]) -> None:
        self._model = model
        self._pinned = ca.SX([float(held) for held in pinned])
        held = [axis for axis, on in zip(_AXES, pinned, strict=True) if on]
        self.name = f"{model.name} with {' and '.join(held) or 'nothing'} pinned"
        self.effects = model.effects
        self.states, self.inputs, self.parameters = model.states, model.inputs, model.parameters
        self.delay = model.delay

    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        """As of the model inside.

        Parameters
        ----------
        at : Operands
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Thrust of the front and the back rotor, shape (2, 1).
        torque_Nm : casadi.SX
            Friction and other torques about the three axes, shape (3, 1).

        Returns
        -------
        casadi.SX
            Acceleration of elevation, pitch and travel in rad/s2, shape (3, 1).
        """
        return self._model.acceleration(at, thrust_N, torque_Nm)

    def dynamics(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, pinned: ca.SX | None = None
    ) -> ca.SX:
        """Time derivative of the state with the pins in.

        Parameters
        ----------
        x : casadi.SX
            State, in the order of `states`.
        u : casadi.SX
            Voltages that act, in the order of `inputs`.
        p : casadi.SX
            Parameters, in the order of `parameters`.
        time_s : casadi.SX, optional
            Time since the flight's first sample; 0 where it is not given.
        pinned : casadi.SX, optional
            Further pins.

        Returns
        -------
        casadi.SX
            Rate of each state in its unit per second. A pinned axis keeps the rate that it has, which a fit
            then finds to be none.
        """
        held = self._pinned if pinned is None else ca.fmax(self._pinned, pinned)
        return self._model.dynamics(x, u, p, time_s, held)

    def parameter_values(self, rig: Rig) -> npt.NDArray[np.float64]:
        """Numbers for the symbols of `parameters`.

        Parameters
        ----------
        rig : Rig
            Gives the values of its own names.

        Returns
        -------
        numpy.ndarray
            Values in the units of `parameters`, shape (len(parameters),).
        """
        return self._model.parameter_values(rig)
