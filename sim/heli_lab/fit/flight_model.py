"""The helicopter as a grey-box model for the estimation core, and its parameters in several flights."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.evaluate.trajectories import AlongTrajectory
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES, Effect, Operands, Stage
from heli_sim.rig import Prior, Quantity, Rig
from typing_extensions import override

from heli_lab.fit.grey_box import ActingInputs, DisturbanceModel, GreyBoxModel, Recording
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.parameters import FreeParameter, ParameterVector
from heli_lab.fit.problem import (
    FLIGHT_TORQUES,
    PER_FLIGHT,
    RIGID_STATES,
    delay_of,
    free_parameters,
    parameter_values,
    rig_prior,
)
from heli_lab.fit.records import Record
from heli_lab.fit.reference_trajectory import KinematicModel, ReferenceTrajectory, kinematic_filter
from heli_lab.fit.windows import make_grid


def model_along(
    model: Model, expressions: Callable[[ca.SX, ca.SX, ca.SX, ca.SX], Sequence[ca.SX]]
) -> AlongTrajectory:
    """Compile expressions of a `model`, so that they can be evaluated along trajectories."""
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
    results = [ca.densify(ca.SX(expression)) for expression in expressions(x, u, p, t)]
    return AlongTrajectory(ca.Function("along", [x, u, t, p], results))


class RotorGains(Effect):
    """Relative changes of the motors' voltage and of the rotors' thrust, as inputs of disturbances."""

    # Both motors get 1 + s times their voltage. The front rotor then gives 1 + d times its thrust, and the
    # back rotor 1 - d times, after all other effects. Both gains are 0; the estimation core adds random
    # disturbances to them, as to the torques. A supply that wanders varies s alone. Rotor wash, which varies
    # each thrust separately, varies s and d.
    # The gain s acts on the voltage, not on the thrust, because the two are not proportional if there is a
    # dead zone. For a wandering supply, this adds 38 and 52 nats to the log-likelihood of two flights
    # (2026-11).

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * (1 + self.value(at, "supply"))

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        difference = self.value(at, "difference")
        return thrust_N * ca.vertcat(1 + difference, 1 - difference)


_NAME: Final = "rotor_gain"
GAINS: Final = (f"{_NAME}_supply", f"{_NAME}_difference")
"""Parameters of the model that has the effect."""
ROTOR_GAINS: Final = RotorGains(
    _NAME,
    (
        Quantity(GAINS[0], "1", "relative change of both motors' voltage"),
        Quantity(GAINS[1], "1", "relative change of the front rotor's thrust, opposite to the back rotor's"),
    ),
    dict.fromkeys(GAINS, 0.0),
    stage=Stage.TORQUE,
)
"""With this effect in a model, the strength of both disturbances is estimated."""


TORQUE_STD_Nm: Final = dict(zip(FLIGHT_TORQUES, (0.02, 0.01, 0.01), strict=True))
"""Prior standard deviation of the constant torque about each axis in a flight: an unlevel table, a cable or a
draught. By judgement, of the order of the disturbances. Smaller: a rig whose balance changes from flight to
flight distorts its other parameters. Larger: elevation's cannot be distinguished from the masses."""

DISTURBANCE_START: Final = DisturbanceModel.start((1e-2, 3e-3, 6e-3), (1e-3, 5e-4, 5e-4))
"""Disturbance torques (N m) at the start of a search: about the middle of those of recorded flights."""
_DISTURBANCE_RANGE_Nm: Final = (2e-5, 1.0)
"""Bounds of the search: far outside of those of recorded flights."""

# Standard deviations of the state at the beginning of a window, about the reference trajectory.
_ANGLE_STD_rad: Final = 1.0
"""Wide, because the reference has the angles that the encoders show: a narrow standard deviation would be
evidence against every error of an encoder. With 0.02 rad, a model with a true zero error of 6 degrees lost 35
nats in three flights (2026-11)."""
_RATE_STD_rad_s: Final = 0.3
"""Far above the error of a rate, which the encoders show to about one count."""
_EFFECT_STATE_STD: Final = 0.3
"""About the state that a simulation from rest would have reached, in the state's unit."""

_KINEMATICS: Final = KinematicModel(5.0, 0.15, 1.0, 0.1)
"""Angles (rad) driven by random accelerations: more than rigs of this type accelerate."""


def with_measured_angles(model: Model) -> Model:
    """Replace each effect of a `model` by its variant for flights whose angles have been measured."""
    return type(model)(tuple(effect.with_measured_angles() for effect in model.effects))


def without_random_effects(model: Model) -> Model:
    """Return a `model` without its effects that have random inputs."""
    return type(model)(tuple(effect for effect in model.effects if not effect.noise_inputs))


def known_directions(effects: Sequence[Effect]) -> tuple[tuple[int, int], ...]:
    """List the states of effects that hold the direction in which an axis moves."""
    names = [state.name for effect in effects for state in effect.states]
    axes = {name: axis for effect in effects for name, axis in effect.direction_of.items()}
    return tuple((names.index(name), AXES.index(axis)) for name, axis in axes.items())


def _acting_voltages(
    model: Model, recording: Recording, every: int, count: int, parameters: Floats, free: Collection[str]
) -> ActingInputs:
    """Return the voltages that act on a `model`: the recorded ones after its delay, raised to the dead
    zone.
    """
    assert isinstance(recording, Record)
    delay, dead_zone_V = delay_of(model, parameters), model.dead_zone_V(parameters, free)
    grid = make_grid(recording, [(0, count * every)], every, delay=delay, dead_zone_V=dead_zone_V)
    mean_derivatives = tuple((by.parameter, by.of_mean) for by in grid.inputs.voltage_derivatives)
    return ActingInputs(grid.inputs.mean_V, mean_derivatives)


def grey_box(model: Model) -> GreyBoxModel:
    """Describe a helicopter's `model` to the estimation core, for flights whose angles have been measured."""
    model = with_measured_angles(model)
    effect_states = len(model.states) - RIGID_STATES
    gains = GAINS if ROTOR_GAINS in model.effects else ()
    return GreyBoxModel(
        states=tuple(state.name for state in model.states),
        inputs=tuple(quantity.name for quantity in model.inputs),
        outputs=AXES,
        parameters=model.parameter_names,
        disturbed=(*FLIGHT_TORQUES, *gains),
        dynamics=model.dynamics,
        measurement=model.measurement,
        reset_map=model.reset_map,
        initial_std=np.repeat(
            (_ANGLE_STD_rad, _RATE_STD_rad_s, _EFFECT_STATE_STD), (len(AXES), len(AXES), effect_states)
        ),
        disturbance_start=DISTURBANCE_START.with_gains(len(gains)),
        disturbance_std_range=_DISTURBANCE_RANGE_Nm,
        acting_inputs=functools.partial(_acting_voltages, model),
        known_directions=known_directions(model.effects),
        source=model,
    )


def model_functions(model: Model, free: Sequence[str]) -> ModelFunctions:
    """Compile a helicopter's `model` with its derivatives by the parameters `free`."""
    return _plain_functions(model, tuple(free)) if model.is_plain else ModelFunctions(grey_box(model), free)


@functools.lru_cache(maxsize=32)
def _plain_functions(model: Model, free: tuple[str, ...]) -> ModelFunctions:
    """Compile the functions of a model without effects, and keep them for the next flight."""
    return ModelFunctions(grey_box(model), free)


def filter_record(record: Record) -> ReferenceTrajectory:
    """Filter the angles of a flight without a model of the rig."""
    return kinematic_filter(record, _KINEMATICS)


class RigParameters(ParameterVector):
    """Free parameters of a rig in several flights: all flights share those of the rig and of the effects;
    each flight has its own encoder zeros and constant torques.
    """

    def __init__(
        self, model: Model, rig: Rig, records: Sequence[Recording], fixed: Mapping[str, float] | None = None
    ) -> None:
        self.model, self.rig = model, rig
        fixed = fixed or {}
        shared, per_flight = [], []
        for parameter in free_parameters(model, rig, None, {}):
            if parameter.quantity in PER_FLIGHT:
                per_flight.append(parameter)
            elif parameter.quantity not in FLIGHT_TORQUES and parameter.quantity not in fixed:
                shared.append(parameter)
        per_flight += [FreeParameter(name, "N m", _torque_prior(rig, name), name) for name in FLIGHT_TORQUES]
        self.labels = tuple(record.label for record in records)
        values = parameter_values(model, rig, fixed)
        super().__init__(model.parameter_names, values, shared, per_flight, self.labels)

    @override
    def parameters(self, theta: Floats, index: int = 0) -> Floats:
        return self.model.values_in(self.labels[index], super().parameters(theta, index))


def _torque_prior(rig: Rig, name: str) -> Prior:
    """Prior of the constant torque about one axis in one flight: the torque of the rig file plus a part that
    differs from flight to flight.
    """
    stated = rig_prior(rig, name) if name in rig and rig[name].tolerance > 0 else Prior(0.0, 0.0)
    return Prior(stated.mean, math.hypot(stated.std, TORQUE_STD_Nm[name]))
