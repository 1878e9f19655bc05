"""The plant: a model of the rig with its mechanical limits, simulated by one millisecond per step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats

from heli_sim import _native
from heli_sim.evaluate.compiled import compile_function
from heli_sim.model.base import Model
from heli_sim.rig import Quantity, Rig


def runge_kutta_step(derivative: Callable[[Any, float], Any], state: Any, step: float) -> Any:
    """Integrate over one step with the classical Runge-Kutta method of fourth order.

    Examples
    --------
    >>> from heli_sim.model.plant import runge_kutta_step
    >>> round(runge_kutta_step(lambda x, _: -x, 1.0, 0.1), 6)
    0.904837
    """
    k1 = derivative(state, 0.0)
    k2 = derivative(state + step / 2 * k1, step / 2)
    k3 = derivative(state + step / 2 * k2, step / 2)
    k4 = derivative(state + step * k3, step)
    return state + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


STEP_s: Final = 0.001
LIMITS: Final = ("elevation_min", "elevation_max", "pitch_max", "travel_max", "table_damping")
_RAD_PER_DEG: Final = np.pi / 180.0
_MULTIPLIER: Final = 48_271
_MODULUS: Final = 2**31 - 1
"""Constants of the random generator of Park and Miller."""


@dataclass(frozen=True)
class Extras:
    """States that a simulation has in addition to those of its model."""

    states: tuple[Quantity, ...] = ()
    """The additional states in their order. All start at 0, except that of the random generator."""
    timed: bool = False  # Whether the first of them is the time since the motors first turned
    random: bool = False  # Whether the next one is the state of the random generator
    delay_s: float = 0.0
    """Delay of the voltages. The remaining states are the voltages of the milliseconds that it spans, the
    newest first."""

    @property
    def delay_ticks(self) -> int:
        """Number of milliseconds that the delay spans: each has a front and a back voltage."""
        return (len(self.states) - self.timed - self.random) // 2


def extras(model: Model, delay_s: float = 0.0) -> Extras:
    """Return the states that a simulation needs in addition to those of its model."""
    timed, random = _depends_on_time(model), model.noise_inputs > 0
    states = [Quantity("time_s", "s", "time since the motors first turned")] if timed else []
    states += [Quantity("random", "1", "state of the random generator")] if random else []
    ticks = math.ceil(delay_s / STEP_s - 1e-9)
    states += [
        Quantity(f"{name}_{tick}_ms_ago", "V", f"{name} {tick} ms ago")
        for tick in range(1, ticks + 1)
        for name in ("front_V", "back_V")
    ]
    return Extras(tuple(states), timed, random, delay_s)


def step_function(model: Model, delay_s: float = 0.0) -> ca.Function:
    """Build the function of one millisecond: a fourth-order Runge-Kutta step, then table, stops and locks."""
    # A stop is inelastic: the angle stays at it and the rate outwards becomes 0. The table is the lower stop
    # of the elevation; while the arm rests on it, pitch and travel rates die out with table_damping. A locked
    # axis (as in a bench test) keeps its angle with rate 0, and its lock gives the reaction that this takes.
    count, added = len(model.states), extras(model, delay_s)
    full_state, commanded_V = ca.SX.sym("state", count + len(added.states)), ca.SX.sym("volts_V", 2)
    x, added_states = full_state[:count], full_state[count:]
    locked = ca.SX.sym("locked", 3)
    p = ca.SX.sym("parameters", len(model.parameters) + len(LIMITS))
    p_model = p[: len(model.parameters)]
    # 0 for the angle and the rate of a locked axis, otherwise 1, shape (count, 1).
    free = ca.vertcat(1 - locked, 1 - locked, ca.SX.ones(count - 6))
    # The order of the added states: time, random generator, past voltages; the first two may be absent.
    t = added_states[0] if added.timed else ca.SX(0)
    generator_state = added_states[added.timed] if added.random else ca.SX(0)
    past_V = added_states[added.timed + added.random :]
    u = delayed_volts_V(commanded_V, past_V, delay_s)

    def rates(state: ca.SX, later_s: float) -> ca.SX:
        return free * model.dynamics(state, u, p_model, t + later_s, locked=locked)

    next_model_state = runge_kutta_step(rates, x, STEP_s)
    # The time of a flight begins when a motor first gets a voltage.
    motors_turned = ca.fmax(t > 0, ca.fmax(ca.fabs(commanded_V[0]), ca.fabs(commanded_V[1])) > 0)
    t_end = t + STEP_s * motors_turned
    next_model_state, measured, generator_state = end_of_step(
        model, next_model_state, u, p, t_end, generator_state, locked
    )
    kept_past_V = ca.vertcat(commanded_V, past_V)[: past_V.numel()]
    next_full_state = ca.vertcat(
        next_model_state,
        *((t_end,) if added.timed else ()),
        *((generator_state,) if added.random else ()),
        kept_past_V,
    )
    results = ca.cse([ca.densify(next_full_state), ca.densify(measured)])
    return ca.Function("plant_step", [full_state, commanded_V, locked, p], results)


def end_of_step(
    model: Model,
    next_model_state: ca.SX,
    u: ca.SX,
    p: ca.SX,
    t_end: ca.SX,
    generator_state: ca.SX,
    locked: ca.SX,
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Apply what a differential equation cannot describe: table, stops, locks, resets and random inputs."""
    # The plant does this once per millisecond, after it has integrated the rates.
    p_model, limits = p[: len(model.parameters)], p[len(model.parameters) :]
    elevation_min, elevation_max, pitch_max, travel_max, table_damping_1_s = ca.vertsplit(limits)
    low = ca.vertcat(elevation_min, -pitch_max, -travel_max) * _RAD_PER_DEG
    high = ca.vertcat(elevation_max, pitch_max, travel_max) * _RAD_PER_DEG
    angles, speeds = next_model_state[0:3], next_model_state[3:6]
    speeds = ca.if_else(angles <= low, ca.fmax(speeds, 0.0), speeds)
    speeds = ca.if_else(angles >= high, ca.fmin(speeds, 0.0), speeds)
    on_table = angles[0] <= low[0]
    # While the arm rests on the table, the rates of pitch and travel decay.
    decay = ca.if_else(on_table, ca.exp(-STEP_s * table_damping_1_s), 1.0)
    elevation_speed, pitch_speed, travel_speed = ca.vertsplit(speeds)
    speeds = ca.vertcat(elevation_speed, decay * pitch_speed, decay * travel_speed) * (1 - locked)
    next_model_state = ca.vertcat(ca.fmin(ca.fmax(angles, low), high), speeds, next_model_state[6:])

    normal, generator_state = _random_numbers(generator_state, model.noise_inputs)
    next_model_state = model.reset_map(next_model_state, u, p_model, t_end)
    next_model_state = next_model_state + model.diffusion(next_model_state, u, p_model, t_end, STEP_s, normal)
    return next_model_state, model.measurement(next_model_state, u, p_model, t_end), generator_state


def _depends_on_time(model: Model) -> bool:
    """Whether the equations of a model contain the time, for example the moment of a sudden change."""
    x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
    p = ca.SX.sym("p", len(model.parameters))
    timed = (model.dynamics(x, u, p, t), model.measurement(x, u, p, t), model.reset_map(x, u, p, t))
    return bool(ca.depends_on(ca.vertcat(*timed), t))


def delayed_volts_V(commanded_V: ca.SX, past_V: ca.SX, delay_s: float) -> ca.SX:
    """Return the voltages that act in a millisecond if commands act late, shape (2,)."""
    # The delay need not be whole milliseconds, so the result is a mean of two successive commands.
    ticks = past_V.numel() // 2
    if not ticks:
        return commanded_V
    newer_share = ticks - delay_s / STEP_s
    newer_V = commanded_V if ticks == 1 else past_V[2 * ticks - 4 : 2 * ticks - 2]
    return newer_share * newer_V + (1 - newer_share) * past_V[2 * ticks - 2 :]


def _random_numbers(generator_state: ca.SX, count: int) -> tuple[ca.SX, ca.SX]:
    """Draw `count` random numbers of mean 0 and variance 1, and return them with the generator's next
    state.
    """
    # The generator is that of Park and Miller. Its products fit a double exactly, so that C and CasADi's
    # virtual machine draw the same numbers. They are uniformly distributed; the lag of a random effect sums
    # many of them, which makes the result nearly normal.
    numbers = []
    for _ in range(count):
        generator_state = ca.fmod(_MULTIPLIER * generator_state, _MODULUS)
        numbers.append(np.sqrt(12.0) * (generator_state / _MODULUS - 0.5))
    return ca.vertcat(*numbers), generator_state


def _step_with_effects(model: Model, delay_s: float) -> tuple[Extras, ca.Function]:
    return extras(model, delay_s), step_function(model, delay_s)


@cache
def _step_without_effects(kind: type[Model]) -> tuple[Extras, ca.Function]:
    """Return extras and step of a model without effects."""
    # They are kept, because building them takes half of the time in which a simulated board opens.
    return _step_with_effects(kind(), 0.0)


class Plant:
    """A model with the parameters of a rig. Random effects draw from the `seed`."""

    def __init__(self, model: Model, rig: Rig, seed: int = 1) -> None:
        self.model = model
        self.rig = rig
        values = model.parameter_values(rig)
        names = [parameter.name for parameter in model.parameters]
        delay_s = float(values[names.index(model.delay)]) if model.delay else 0.0
        self.extras, self.function = (
            _step_without_effects(type(model)) if model.is_plain else _step_with_effects(model, delay_s)
        )
        """Additional states, which follow those of the model, and the function of one millisecond."""
        limits = [rig[name].value for name in LIMITS]
        self.parameters: Floats = np.array([*values, *limits])
        """Parameters of the step, shape (len(model.parameters) + 5,)."""
        # Neighbouring states of this generator give nearly the same first number, so the seed is scrambled.
        self._first_generator_state = 1 + int(np.random.default_rng(seed).integers(_MODULUS - 1))

    def rest_state(self) -> Floats:
        """Return the state of the arm at rest on the table, with level pitch and travel 0."""
        # Its order is that of ``model.states``, then ``extras.states``.
        state = np.zeros(len(self.model.states) + len(self.extras.states))
        state[0] = np.deg2rad(self.rig["elevation_min"].value)
        if self.extras.random:
            state[len(self.model.states) + self.extras.timed] = self._first_generator_state
        return state

    def step(
        self,
        state: npt.ArrayLike,
        volts_V: npt.ArrayLike,
        locked: tuple[bool, bool, bool] = (False, False, False),
    ) -> tuple[Floats, Floats]:
        """Simulate one millisecond in Python; `native_step` is the same step, compiled."""
        # Returns the next state and the angles that the encoders see [rad], shape (3,).
        flags = [float(axis) for axis in locked]
        next_model_state, measured = self.function(
            np.asarray(state), np.asarray(volts_V), flags, self.parameters
        )
        return np.asarray(next_model_state).ravel(), np.asarray(measured).ravel()

    def native_step(self) -> _native.PlantStep:
        """Return the step for the C++ world, compiled by the system's C compiler."""
        # Without a compiler, C++ calls CasADi's virtual machine, which takes about 50 times as long.
        library = compile_function(self.function)
        if library is not None:
            return _native.CompiledStep(str(library), self.function.name())
        return _native.CallbackStep(self._step_values, self.function.numel_in(0), len(self.parameters))

    def _step_values(
        self, state: list[float], volts_V: list[float], locked: list[float], parameters: list[float]
    ) -> tuple[list[float], list[float]]:
        next_model_state, measured = self.function(state, volts_V, locked, parameters)
        return next_model_state.nonzeros(), measured.nonzeros()
