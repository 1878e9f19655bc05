"""The compiled plant: one millisecond of the rig, with its mechanical limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from typing import Final

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats

from heli_sim import _native
from heli_sim.compiled import compile_function
from heli_sim.model.base import Model
from heli_sim.rig import Quantity, Rig
from heli_sim.runge_kutta import runge_kutta_step

STEP_s: Final = 0.001
LIMITS: Final = ("elevation_min", "elevation_max", "pitch_max", "travel_max", "table_damping")
_RAD: Final = np.pi / 180.0
_MULTIPLIER: Final = 48_271
_MODULUS: Final = 2**31 - 1


@dataclass(frozen=True)
class Extras:
    """States that a simulation has in addition to those of its model.

    Parameters
    ----------
    states : tuple of Quantity
        In their order; their initial value is 0, that of the random generator aside.
    timed : bool
        Whether the first of them is the time since the motors first turned.
    random : bool
        Whether the next one is the state of the random generator.
    late_s : float
        Delay of the voltages; the rest of the states are the voltages of the milliseconds that it spans.
    """

    states: tuple[Quantity, ...] = ()
    timed: bool = False
    random: bool = False
    late_s: float = 0.0


def extras(model: Model, late_s: float = 0.0) -> Extras:
    """Find the quantities that a simulation of a model keeps in addition to its states, if the voltages act
    `late_s` late.
    """
    timed, random = _depends_on_time(model), model.noise_inputs > 0
    states = [Quantity("time_s", "s", "time since the motors first turned")] if timed else []
    states += [Quantity("random", "1", "state of the random generator")] if random else []
    ticks = math.ceil(late_s / STEP_s - 1e-9)
    states += [
        Quantity(f"{name}_{tick}_ms_ago", "V", f"{name} {tick} ms ago")
        for tick in range(1, ticks + 1)
        for name in ("front_V", "back_V")
    ]
    return Extras(tuple(states), timed, random, late_s)


def step_function(model: Model, late_s: float = 0.0) -> ca.Function:
    """Make the function of one millisecond: a fourth-order Runge-Kutta step, then table, stops and locks.

    A stop is inelastic: the angle stays at it and the rate outwards becomes 0. The table is the lower stop of
    the elevation; while the arm rests on it, pitch and travel rates die out with table_damping. A locked axis
    (as in a bench test) keeps its angle with rate 0, and its lock gives the reaction that this takes.

    Parameters
    ----------
    late_s : float
        By how much the voltages act late.

    Returns
    -------
    casadi.Function
        ``plant_step(state, volts_V, locked, parameters) -> (next state, measured angles in rad)``; the
        state is that of the model and then that of `extras`; the parameters are those of the model, then
        elevation_min, elevation_max, pitch_max, travel_max (deg) and table_damping (1/s).
    """
    count, more = len(model.states), extras(model, late_s)
    whole, commanded = ca.SX.sym("state", count + len(more.states)), ca.SX.sym("volts_V", 2)
    x, rest = whole[:count], whole[count:]
    locked = ca.SX.sym("locked", 3)
    p = ca.SX.sym("parameters", len(model.parameters) + len(LIMITS))
    p_model = p[: len(model.parameters)]
    free = ca.vertcat(1 - locked, 1 - locked, ca.SX.ones(count - 6))
    t, rest = (rest[0], rest[1:]) if more.timed else (ca.SX(0), rest)
    chance, past_V = (rest[0], rest[1:]) if more.random else (ca.SX(0), rest)
    u = late_volts(commanded, past_V, late_s)

    def rates(at: ca.SX, later_s: float) -> ca.SX:
        return free * model.dynamics(at, u, p_model, t + later_s, locked=locked)

    after = runge_kutta_step(rates, x, STEP_s)
    turning = ca.fmax(t > 0, ca.fmax(ca.fabs(commanded[0]), ca.fabs(commanded[1])) > 0)
    t_after = t + STEP_s * turning
    after, measured, chance = end_of_step(model, after, u, p, t_after, chance, locked)
    kept_V = ca.vertcat(commanded, past_V)[: past_V.numel()]
    whole_after = ca.vertcat(
        after, *((t_after,) if more.timed else ()), *((chance,) if more.random else ()), kept_V
    )
    results = ca.cse([ca.densify(whole_after), ca.densify(measured)])
    return ca.Function("plant_step", [whole, commanded, locked, p], results)


def end_of_step(
    model: Model, after: ca.SX, u: ca.SX, p: ca.SX, t_after: ca.SX, chance: ca.SX, locked: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Apply what the rates do not describe at the end of a millisecond: table, stops, locks, and the resets
    and random inputs of effects.

    Parameters
    ----------
    after : casadi.SX
        State of the model, integrated over the millisecond.
    u : casadi.SX
        Voltages that acted [V].
    p : casadi.SX
        Parameters, as in `step_function`.
    t_after : casadi.SX
        Time since the motors first turned [s].
    chance : casadi.SX
        State of the random generator.
    locked : casadi.SX
        1 for each locked axis.

    Returns
    -------
    after, measured, chance : casadi.SX
        The state, the angles that the encoders see [rad], and the generator's next state.
    """
    p_model, limits = p[: len(model.parameters)], p[len(model.parameters) :]
    low = ca.vertcat(limits[0], -limits[2], -limits[3]) * _RAD
    high = ca.vertcat(limits[1], limits[2], limits[3]) * _RAD
    angles, speeds = after[0:3], after[3:6]
    speeds = ca.if_else(angles <= low, ca.fmax(speeds, 0.0), speeds)
    speeds = ca.if_else(angles >= high, ca.fmin(speeds, 0.0), speeds)
    on_table = angles[0] <= low[0]
    # By table_damping [1/s], pitch and travel rates die out while the arm rests on the table.
    speed_factor = ca.if_else(on_table, ca.exp(-STEP_s * limits[4]), 1.0)
    speeds = ca.vertcat(speeds[0], speed_factor * speeds[1], speed_factor * speeds[2]) * (1 - locked)
    after = ca.vertcat(ca.fmin(ca.fmax(angles, low), high), speeds, after[6:])

    normal, chance = _drawn(chance, model.noise_inputs)
    after = model.reset_map(after, u, p_model, t_after)
    after = after + model.diffusion(after, u, p_model, t_after, STEP_s, normal)
    return after, model.measurement(after, u, p_model, t_after), chance


def _depends_on_time(model: Model) -> bool:
    x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
    p = ca.SX.sym("p", len(model.parameters))
    timed = (model.dynamics(x, u, p, t), model.measurement(x, u, p, t), model.reset_map(x, u, p, t))
    return bool(ca.depends_on(ca.vertcat(*timed), t))


def late_volts(commanded_V: ca.SX, past_V: ca.SX, late_s: float) -> ca.SX:
    """Mean over a millisecond of the voltages that were commanded `late_s` before it: of those `commanded_V`
    in it, shape (2,), and of `past_V`, those of the milliseconds before, newest first.
    """
    ticks = past_V.numel() // 2
    if not ticks:
        return commanded_V
    older = ticks - late_s / STEP_s  # share of the newer of the two milliseconds that it lies across
    newer_V = commanded_V if ticks == 1 else past_V[2 * ticks - 4 : 2 * ticks - 2]
    return older * newer_V + (1 - older) * past_V[2 * ticks - 2 :]


def _drawn(chance: ca.SX, count: int) -> tuple[ca.SX, ca.SX]:
    """Random numbers of mean 0 and variance 1, and the generator's next state.

    Park and Miller's generator: its products fit a double exactly, so that C and CasADi's virtual machine
    draw the same. The numbers are evenly distributed; what lags them makes them normal.
    """
    numbers = []
    for _ in range(count):
        chance = ca.fmod(_MULTIPLIER * chance, _MODULUS)
        numbers.append(np.sqrt(12.0) * (chance / _MODULUS - 0.5))
    return ca.vertcat(*numbers), chance


def _step(model: Model, late_s: float) -> tuple[Extras, ca.Function]:
    return extras(model, late_s), step_function(model, late_s)


@cache
def _plain_step(kind: type[Model]) -> tuple[Extras, ca.Function]:
    """Return extras and step of a model without effects: to make them takes half of the time in which a
    simulated board opens.
    """
    return _step(kind(), 0.0)


class Plant:
    """A model with the parameters of a rig. Random effects draw from the `seed`."""

    def __init__(self, model: Model, rig: Rig, seed: int = 1) -> None:
        self.model = model
        self.rig = rig
        values = model.parameter_values(rig)
        names = [parameter.name for parameter in model.parameters]
        late_s = float(values[names.index(model.delay)]) if model.delay else 0.0
        self.extras, self.function = _plain_step(type(model)) if model.is_plain else _step(model, late_s)
        """What the simulation remembers besides the model's states, which follow those, and its step."""
        limits = [rig[name].value for name in LIMITS]
        self.parameters: Floats = np.array([*values, *limits])
        """Parameters of the step, shape (len(model.parameters) + 5,)."""
        # Seeds next to each other would draw nearly the same first number.
        self._first_chance = 1 + int(np.random.default_rng(seed).integers(_MODULUS - 1))

    def rest_state(self) -> Floats:
        """State of the arm at rest on the table, level in pitch, travel 0, in the order of ``model.states``
        and ``extras.states``.
        """
        state = np.zeros(len(self.model.states) + len(self.extras.states))
        state[0] = np.deg2rad(self.rig["elevation_min"].value)
        if self.extras.random:
            state[len(self.model.states) + self.extras.timed] = self._first_chance
        return state

    def step(
        self,
        state: npt.ArrayLike,
        volts_V: npt.ArrayLike,
        locked: tuple[bool, bool, bool] = (False, False, False),
    ) -> tuple[Floats, Floats]:
        """Return the state a millisecond later and the angles that the encoders see [rad], shape (3,),
        computed in Python. `native_step` is the same step, compiled.

        Parameters
        ----------
        state : array_like
            State, as `rest_state` has it, shape (n,).
        volts_V : array_like
            Voltages that act on the front and the back motor, shape (2,).
        locked : tuple of bool
            Which of elevation, pitch and travel are locked.
        """
        flags = [float(axis) for axis in locked]
        after, measured = self.function(np.asarray(state), np.asarray(volts_V), flags, self.parameters)
        return np.asarray(after).ravel(), np.asarray(measured).ravel()

    def native_step(self) -> _native.PlantStep:
        """Return the step for the C++ world, compiled by the system's C compiler. Without a compiler,
        CasADi's virtual machine is called from C++, which takes about 50 times as long. A PlantError when the
        compiler fails.
        """
        library = compile_function(self.function)
        if library is not None:
            return _native.CompiledStep(str(library), self.function.name())
        return _native.CallbackStep(self._call, self.function.numel_in(0), len(self.parameters))

    def _call(
        self, state: list[float], volts_V: list[float], locked: list[float], parameters: list[float]
    ) -> tuple[list[float], list[float]]:
        after, measured = self.function(state, volts_V, locked, parameters)
        return after.nonzeros(), measured.nonzeros()
