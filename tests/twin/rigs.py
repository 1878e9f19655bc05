"""Random rigs under disturbances, each with a twin that a user could train: from two flights of the rig."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from heli_host.data.flight import Flight
from heli_host.errors import HeliError
from heli_lab.fit.estimator import estimate
from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.records import prepare
from heli_lab.watch.calibration import TwinRig
from heli_lab.watch.learn import fly_simulated, learn, random_plan, with_process_noise
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Effect, Model
from heli_sim.model.effects import parse_effects
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
    """A simulated rig.

    Parameters
    ----------
    rig : Rig
        True parameters.
    model : Model
        True equations of motion, without disturbances.
    disturbances : DisturbanceModel
        Gusts and drift of its room.
    """

    rig: Rig
    model: Model
    disturbances: DisturbanceModel

    @property
    def disturbed_model(self) -> Model:
        """True equations of motion with the disturbances as effects."""
        return with_process_noise(self.model, self.disturbances)


@dataclass(frozen=True)
class RigWithTwin:
    """A simulated rig, and the twin that its user has trained.

    Parameters
    ----------
    seed : int
        Seed from which everything about the rig was drawn.
    rig : Rig
        True parameters.
    model : Model
        True equations of motion; the effects include the disturbances.
    twin : TwinRig
        Twin with the identified parameters.
    """

    seed: int
    rig: Rig
    model: Model
    twin: TwinRig


def true_rig(seed: int) -> TrueRig:
    """Draw a rig within the tolerances of the nominal rig, and its disturbances.

    Rigs with an odd seed have a rotor lag. The disturbing torques and the zeros of the encoders are those of
    the nominal rig.
    """
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
    """Draw a rig, fly it, identify it, and train its twin.

    Parameters
    ----------
    seed : int
        Seed of the rig, its flights and the training.
    drawn_minutes : int
        Time of flight for which the training draws evidence [min].
    """
    drawn = true_rig(seed)
    training_flights = random_flights(drawn.disturbed_model, drawn.rig, 10_000 * seed, TRAINING_FLIGHTS)
    identified_model, identified_rig = identify_rig(drawn.model, training_flights)
    calibration = learn(
        identified_model,
        identified_rig,
        training_flights,
        [_training_label(number) for number in range(TRAINING_FLIGHTS)],
        drawn_s=60.0 * drawn_minutes,
        seed=seed,
    )
    twin = TwinRig(identified_rig, identified_model, calibration, f"rig {seed}")
    return RigWithTwin(seed, drawn.rig, drawn.disturbed_model, twin)


def random_flights(
    model: Model, rig: Rig, first_seed: int, count: int, duration_s: float = 60.0
) -> list[Flight]:
    """Fly random plans in simulation, with successive seeds.

    Strong disturbances can move the arm so much that the board refuses to arm. Such a flight is replaced by
    the flight of the next seed.
    """
    flights: list[Flight] = []
    for seed in range(first_seed, first_seed + MAX_ATTEMPTS_PER_FLIGHT * count):
        if len(flights) == count:
            break
        try:
            flights.append(fly_simulated(model, rig, random_plan(seed, duration_s), seed))
        except HeliError:
            continue
    return flights


def identify_rig(model: Model, training_flights: list[Flight]) -> tuple[Model, Rig]:
    """Estimate the parameters of a rig and of the model's effects from flights.

    The estimation starts from the nominal rig and from typical values of the effects, as a user's does.
    """
    nominal = load_rig(NOMINAL_RIG)
    typical_model = type(model)(parse_effects([effect.name for effect in model.effects]))
    records = [
        prepare(flight, nominal, _training_label(number)) for number, flight in enumerate(training_flights)
    ]
    parameter_vector = RigParameters(typical_model, nominal, records)
    functions = model_functions(typical_model, parameter_vector.quantities)
    fit = estimate(
        parameter_vector, [filter_record(record) for record in records], functions, parameter_vector.start
    )
    # Estimates that belong to a single flight, such as encoder zeros, are no parameters of the rig.
    estimates = {
        parameter.quantity: float(value)
        for parameter, value in zip(parameter_vector.free, fit.theta, strict=True)
        if parameter.record is None
    }
    identified_rig = nominal.replace(**{name: value for name, value in estimates.items() if name in nominal})
    effects: list[Effect] = [
        replace(
            effect, values={name: estimates.get(name, typical) for name, typical in effect.values.items()}
        )
        for effect in typical_model.effects
    ]
    return type(model)(tuple(effects)), identified_rig


def _training_label(number: int) -> str:
    return f"training {number}"
