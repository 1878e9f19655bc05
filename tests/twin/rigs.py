"""Random rigs under disturbances, each with a twin that a user could train: from two flights of the rig."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np
from heli_host.data.flight import Flight
from heli_host.errors import HeliError
from heli_lab.fit.estimator import estimate
from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.records import Record, prepare
from heli_lab.watch.calibration import TwinRig
from heli_lab.watch.learn import fly_simulated, learn, random_plan, with_process_noise
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Effect, Model, Operands
from heli_sim.model.effect import smooth_step
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.model.effects.encoders import ZeroOffset
from heli_sim.model.effects.thrust import ThrustFade
from heli_sim.model.effects.torques import CableSpring, CoulombFriction
from heli_sim.rig import Rig, load_rig

NOMINAL_RIG = "makki2024"
STRENGTHS_Nm = ((0.006, 0.002, 0.004), (0.012, 0.004, 0.008), (0.02, 0.006, 0.012))
"""Standard deviations of the gusts about elevation, pitch and travel [N m]: weak, moderate and
strong disturbances."""
CORRELATION_TIMES_s = (0.3, 0.6, 1.2)
"""Correlation times of the gusts, of which each rig has one [s]."""
DRIFT_Nm = (1e-3, 5e-4, 5e-4)
"""Standard deviations of the slow drift about elevation, pitch and travel [N m]."""
LAG_RANGE_s = (0.05, 0.15)
"""Shortest and longest rotor lag of a rig that has one [s]."""
TRAINING_FLIGHTS = 2
"""Number of flights from which the user identifies the rig and trains the twin."""
FIXED = frozenset({"g", "elevation_min", "elevation_max", "pitch_max", "travel_max"})
"""Parameters that every rig has in common."""
MAX_ATTEMPTS_PER_FLIGHT = 10
_RIG_STREAM = 16
"""Second part of the seed of a rig. Any other number gives other rigs, equally good."""


@dataclass(frozen=True)
class TrueRig:
    """A simulated rig."""

    rig: Rig  # True parameters
    model: Model  # True equations of motion, without disturbances
    disturbances: DisturbanceModel  # Gusts and drift of its room

    @property
    def disturbed_model(self) -> Model:
        """True equations of motion with the disturbances as effects."""
        return with_process_noise(self.model, self.disturbances)


@dataclass(frozen=True)
class RigWithTwin:
    """A simulated rig, and the twin that its user has trained."""

    seed: int  # Seed from which everything about the rig was drawn
    rig: Rig  # True parameters
    model: Model  # True equations of motion; the effects include the disturbances
    twin: TwinRig  # Twin with the identified parameters


def true_rig(seed: int) -> TrueRig:
    """Draw a rig within the tolerances of the nominal rig, and its disturbances."""
    # Rigs with an odd seed have a rotor lag. The disturbing torques and the zeros of the encoders are those
    # of the nominal rig.
    rng = np.random.default_rng([seed, _RIG_STREAM])
    nominal = load_rig(NOMINAL_RIG)
    names = [
        quantity.name
        for quantity in MultibodyModel().parameters
        if quantity.name in nominal and nominal[quantity.name].tolerance and quantity.name not in FIXED
    ]
    # A tolerance is two standard deviations. Draws beyond it are moved to its border.
    drawn = {
        name: nominal[name].value + 0.5 * nominal[name].tolerance * float(np.clip(rng.normal(), -2, 2))
        for name in names
        if not name.startswith(("torque_", "offset_"))
    }
    lag_effects = parse_effects([f"rotor_lag={rng.uniform(*LAG_RANGE_s):.3f}"]) if seed % 2 else ()
    disturbances = DisturbanceModel(
        fast_std=np.array(STRENGTHS_Nm[rng.integers(len(STRENGTHS_Nm))]),
        correlation_time_s=np.full(3, float(rng.choice(CORRELATION_TIMES_s))),
        slow_std=np.array(DRIFT_Nm),
        quantisation=np.ones(3),
    )
    return TrueRig(nominal.replace(**drawn), MultibodyModel(lag_effects), disturbances)


def rig_with_twin(seed: int, drawn_minutes: int) -> RigWithTwin:
    """Draw a rig, fly it, identify it, and train its twin."""
    drawn = true_rig(seed)
    training_flights = random_flights(drawn.disturbed_model, drawn.rig, 10_000 * seed, TRAINING_FLIGHTS)
    nominal = load_rig(NOMINAL_RIG)
    labels = [f"training {number}" for number in range(TRAINING_FLIGHTS)]
    records = [
        prepare(flight, nominal, label) for flight, label in zip(training_flights, labels, strict=True)
    ]
    identified_model, identified_rig = identify_rig(
        [effect.name for effect in drawn.model.effects], nominal, records
    )
    calibration = learn(
        identified_model, identified_rig, training_flights, labels, drawn_s=60.0 * drawn_minutes, seed=seed
    )
    twin = TwinRig(identified_rig, identified_model, calibration, f"rig {seed}")
    return RigWithTwin(seed, drawn.rig, drawn.disturbed_model, twin)


def random_flights(
    model: Model, rig: Rig, first_seed: int, count: int, duration_s: float = 60.0
) -> list[Flight]:
    """Fly random plans in simulation, with successive seeds."""
    # Strong disturbances can move the arm so much that the board refuses to arm. Such a flight is replaced by
    # the flight of the next seed.
    flights: list[Flight] = []
    for seed in range(first_seed, first_seed + MAX_ATTEMPTS_PER_FLIGHT * count):
        if len(flights) == count:
            break
        try:
            flights.append(fly_simulated(model, rig, random_plan(seed, duration_s), seed))
        except HeliError:
            continue
    return flights


def identify_rig(effects: Sequence[str], start: Rig, records: Sequence[Record]) -> tuple[Model, Rig]:
    """Estimate the parameters of a rig and of effects from flights, as a user does: from the rig `start` and
    from typical values of the effects.
    """
    typical_model = MultibodyModel(parse_effects(effects))
    parameter_vector = RigParameters(typical_model, start, list(records))
    functions = model_functions(typical_model, parameter_vector.quantities)
    fit = estimate(
        parameter_vector, [filter_record(record) for record in records], functions, parameter_vector.start
    )
    # Estimates that belong to a single flight, such as encoder zeros, are no parameters of the rig.
    estimates = {
        parameter.quantity: float(value)
        for parameter, value in zip(parameter_vector.free, fit.theta, strict=True)
        if parameter.is_shared
    }
    identified_rig = start.replace(**{name: value for name, value in estimates.items() if name in start})
    identified_effects = tuple(
        replace(
            effect, values={name: estimates.get(name, typical) for name, typical in effect.values.items()}
        )
        for effect in typical_model.effects
    )
    return MultibodyModel(identified_effects), identified_rig


ONSET_s = 30.0
"""Time from the first turn of the motors to the change [s]."""
SIZES: Mapping[str, tuple[float, float, float]] = {
    "thrust_step.front": (0.02, 0.05, 0.1),
    "thrust_step.back": (0.02, 0.05, 0.1),
    "thrust_fade": (0.002, 0.005, 0.01),
    "counterweight_shift": (0.002, 0.005, 0.01),
    "coulomb_friction.elevation": (0.015, 0.03, 0.06),
    "coulomb_friction.pitch": (0.005, 0.01, 0.02),
    "coulomb_friction.travel": (0.01, 0.02, 0.04),
    "zero_offset.elevation": (0.01, 0.02, 0.04),
    "zero_offset.pitch": (0.01, 0.02, 0.04),
    "cable_spring.elevation": (0.05, 0.1, 0.2),
    "cable_spring.travel": (0.02, 0.05, 0.1),
}
"""Sizes of each change, as values of its first parameter [SI]."""
REST_rad = 0.2
"""Angle at which the spring of the cable has no torque [rad]."""


class _LateFriction(CoulombFriction):
    """Dry friction from `ONSET_s` on."""

    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        full_friction_Nm = super().friction_Nm(at, acceleration_rad_s2, inertia_kg_m2)
        return smooth_step(at.time_s, ca.SX(ONSET_s)) * full_friction_Nm


class _LateZero(ZeroOffset):
    """A wrong encoder zero from `ONSET_s` on."""

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        shifted_rad = super().measured_rad(at, angles_rad)
        return angles_rad + smooth_step(at.time_s, ca.SX(ONSET_s)) * (shifted_rad - angles_rad)


class _LateCable(CableSpring):
    """The spring torque of a cable from `ONSET_s` on."""

    def torque_Nm(self, at: Operands) -> ca.SX:
        return smooth_step(at.time_s, ca.SX(ONSET_s)) * super().torque_Nm(at)


class _LateFade(ThrustFade):
    """Thrust that decreases at a constant rate from `ONSET_s` on."""

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return thrust_N * (1 - self.value(at, "per_s") * ca.fmax(at.time_s - ONSET_s, 0.0))


_LATE_EFFECTS: Mapping[str, type[Effect]] = {
    "coulomb_friction": _LateFriction,
    "zero_offset": _LateZero,
    "cable_spring": _LateCable,
    "thrust_fade": _LateFade,
}
"""Effects of the catalogue that have no onset of their own, with an onset."""


def change(name: str, size: float) -> Effect:
    """Return the effect `name` of the catalogue that acts from `ONSET_s` on."""
    # Its first parameter has the value `size` [SI], the others have typical values.
    spec = catalogue()[name]
    values = {**spec.typical, spec.full(spec.numbers[0].name): size}
    for parameter, value in (("at_s", ONSET_s), ("rest_rad", REST_rad)):
        if spec.full(parameter) in values:
            values[spec.full(parameter)] = value
    effect = spec.make(values)
    late_class = _LATE_EFFECTS.get(name.partition(".")[0])
    if late_class is None:
        return effect
    arguments: dict[str, Any] = {field.name: getattr(effect, field.name) for field in fields(effect)}
    return late_class(**arguments)
