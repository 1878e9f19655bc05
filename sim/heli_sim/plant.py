"""Numbers from the symbols: one compiled millisecond of the rig, mechanical limits included."""

from __future__ import annotations

from typing import Final

import casadi as ca
import numpy as np
import numpy.typing as npt

from heli_sim import _native
from heli_sim.compiled import compile_function
from heli_sim.model.base import Model
from heli_sim.rig import Rig

STEP_s: Final = 0.001
_LIMITS: Final = ("elevation_min", "elevation_max", "pitch_max", "travel_max", "table_damping")
_RAD: Final = np.pi / 180.0


def step_function(model: Model) -> ca.Function:
    """One millisecond: Runge-Kutta of fourth order, then table, stops and locks.

    A stop is inelastic: the angle stays at it and the rate outwards becomes 0. The table is the lower stop of
    the elevation; while the arm rests on it, pitch and travel rates die out with table_damping. A locked axis
    (pinned for a bench test) keeps its angle with rate 0, and its pin gives the reaction that this takes.

    Parameters
    ----------
    model : Model
        Gives the dynamics and the measurement.

    Returns
    -------
    casadi.Function
        ``plant_step(state, volts_V, locked, parameters) -> (next state, measured angles in rad)``; the
        parameters are those of the model, then elevation_min, elevation_max, pitch_max, travel_max (deg) and
        table_damping (1/s).
    """
    count = len(model.states)
    x, u = ca.SX.sym("state", count), ca.SX.sym("volts_V", 2)
    locked = ca.SX.sym("locked", 3)
    p = ca.SX.sym("parameters", len(model.parameters) + len(_LIMITS))
    p_model, limits = p[: len(model.parameters)], p[len(model.parameters) :]
    free = ca.vertcat(1 - locked, 1 - locked, ca.SX.ones(count - 6))

    def rates(at: ca.SX) -> ca.SX:
        return free * model.dynamics(at, u, p_model, pinned=locked)

    k1 = rates(x)
    k2 = rates(x + STEP_s / 2 * k1)
    k3 = rates(x + STEP_s / 2 * k2)
    k4 = rates(x + STEP_s * k3)
    after = x + STEP_s / 6 * (k1 + 2 * k2 + 2 * k3 + k4)

    low = ca.vertcat(limits[0], -limits[2], -limits[3]) * _RAD
    high = ca.vertcat(limits[1], limits[2], limits[3]) * _RAD
    angles, speeds = after[0:3], after[3:6]
    speeds = ca.if_else(angles <= low, ca.fmax(speeds, 0.0), speeds)
    speeds = ca.if_else(angles >= high, ca.fmin(speeds, 0.0), speeds)
    on_table = angles[0] <= low[0]
    kept = ca.if_else(on_table, ca.exp(-STEP_s * limits[4]), 1.0)
    speeds = ca.vertcat(speeds[0], kept * speeds[1], kept * speeds[2]) * (1 - locked)
    after = ca.vertcat(ca.fmin(ca.fmax(angles, low), high), speeds, after[6:])

    measured = model.measurement(after, u, p_model)
    results = ca.cse([ca.densify(after), ca.densify(measured)])
    return ca.Function("plant_step", [x, u, locked, p], results)


class Plant:
    """A model with the numbers of a rig.

    Parameters
    ----------
    model : Model
        Equations of motion.
    rig : Rig
        Their numbers.
    """

    def __init__(self, model: Model, rig: Rig) -> None:
        self.model = model
        self.rig = rig
        self.function = step_function(model)
        limits = [rig[name].value for name in _LIMITS]
        self.parameters: npt.NDArray[np.float64] = np.array([*model.parameter_values(rig), *limits])
        """Parameters of the step, shape (len(model.parameters) + 5,)."""

    def rest_state(self) -> npt.NDArray[np.float64]:
        """State of the arm at rest on the table, level in pitch, travel 0.

        Returns
        -------
        numpy.ndarray
            In the order of ``model.states``, shape (len(model.states),).
        """
        state = np.zeros(len(self.model.states))
        state[0] = np.deg2rad(self.rig["elevation_min"].value)
        return state

    def step(
        self,
        state: npt.ArrayLike,
        volts_V: npt.ArrayLike,
        locked: tuple[bool, bool, bool] = (False, False, False),
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """One millisecond, computed in Python; the compiled twin is `native_step`.

        Parameters
        ----------
        state : array_like
            State, shape (len(model.states),).
        volts_V : array_like
            Voltages that act on the front and the back motor, shape (2,).
        locked : tuple of bool
            Which of elevation, pitch and travel are pinned.

        Returns
        -------
        tuple of numpy.ndarray
            State a millisecond later and the angles that the encoders see, rad, shape (3,).
        """
        flags = [float(axis) for axis in locked]
        after, measured = self.function(np.asarray(state), np.asarray(volts_V), flags, self.parameters)
        return np.asarray(after).ravel(), np.asarray(measured).ravel()

    def native_step(self) -> _native.PlantStep:
        """The step for the C++ world.

        Returns
        -------
        _native.PlantStep
            Compiled by the system's C compiler, or, where there is none, CasADi's virtual machine called back
            from C++, which is about 50 times slower.

        Raises
        ------
        PlantError
            When the compiler fails.
        """
        library = compile_function(self.function)
        if library is not None:
            return _native.CompiledStep(str(library), self.function.name())
        return _native.CallbackStep(self._call, len(self.model.states), len(self.parameters))

    def _call(
        self, state: list[float], volts_V: list[float], locked: list[float], parameters: list[float]
    ) -> tuple[list[float], list[float]]:
        after, measured = self.function(state, volts_V, locked, parameters)
        return after.nonzeros(), measured.nonzeros()
