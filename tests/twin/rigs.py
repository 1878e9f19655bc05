"""Random rigs under disturbances, and a user's knowledge of them: estimates from two flights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from heli_host.errors import HeliError
from heli_host.flight import Flight
from heli_lab.estimation import DisturbanceModel, estimate
from heli_lab.identify import prepare
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions
from heli_lab.twin.files import TwinRig
from heli_lab.twin.healthy_flights import fly_simulated, random_plan, with_process_noise
from heli_lab.twin.learn import learn
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Effect, Model
from heli_sim.model.effects import parse_effects
from heli_sim.rig import Rig, load_rig

STRENGTHS_Nm = ((0.006, 0.002, 0.004), (0.012, 0.004, 0.008), (0.02, 0.006, 0.012))
"""Gusts about elevation, pitch and travel, N m: weak, moderate and strong disturbances."""
DRIFT_Nm = (1e-3, 5e-4, 5e-4)
TEACHING = 2
"""Flights from which the user identifies the rig and estimates its disturbances."""
FIXED = frozenset({"g", "elevation_min", "elevation_max", "pitch_max", "travel_max"})


@dataclass(frozen=True)
class Known:
    """A rig, and what is known of it.

    Parameters
    ----------
    seed : int
        Gives it all that it has.
    rig : Rig
        True numbers.
    model : Model
        True equations; the effects include the disturbances.
    twin : TwinRig
        The rig as the user knows it.
    """

    seed: int
    rig: Rig
    model: Model
    twin: TwinRig


def true_rig(seed: int) -> tuple[Rig, Model, DisturbanceModel]:
    """Draw a rig within the tolerances of makki2024, and disturbances. Half of the rigs have a rotor
    lag."""
    rng = np.random.default_rng([seed, 16])
    base = load_rig("makki2024")
    model = MultibodyModel()
    names = [
        q.name for q in model.parameters if q.name in base and base[q.name].tolerance and q.name not in FIXED
    ]
    drawn = {
        name: base[name].value + 0.5 * base[name].tolerance * float(np.clip(rng.normal(), -2, 2))
        for name in names
        if not name.startswith(("torque_", "offset_"))
    }
    lag = parse_effects([f"rotor_lag={rng.uniform(0.05, 0.15):.3f}"]) if seed % 2 else ()
    disturbances = DisturbanceModel(
        np.array(STRENGTHS_Nm[rng.integers(3)]),
        np.full(3, float(rng.choice((0.3, 0.6, 1.2)))),
        np.array(DRIFT_Nm),
        np.ones(3),
    )
    return base.replace(**drawn), MultibodyModel(lag), disturbances


def known(seed: int, drawn: int) -> Known:
    """Draw a rig, fly it, identify it, and train its twin on so many minutes of `drawn` evidence."""
    rig, calm, disturbances = true_rig(seed)
    model = with_process_noise(calm, disturbances)
    training_flights = flights(model, rig, 10_000 * seed, TEACHING)
    fitted, numbers = identified(calm, training_flights)
    labels = [f"teaching {i}" for i in range(TEACHING)]
    calibration = learn(fitted, numbers, training_flights, labels, drawn_s=60.0 * drawn, seed=seed)
    return Known(seed, rig, model, TwinRig(numbers, fitted, calibration, f"rig {seed}"))


def flights(model: Model, rig: Rig, seed: int, count: int, seconds: float = 60.0) -> list[Flight]:
    """Fly random plans. If disturbances move the arm too much to be armed, try again."""
    flights: list[Flight] = []
    for number in range(10 * count):
        if len(flights) == count:
            break
        try:
            flights.append(fly_simulated(model, rig, random_plan(seed + number, seconds), seed + number))
        except HeliError:
            continue
    return flights


def identified(model: Model, training_flights: list[Flight]) -> tuple[Model, Rig]:
    """Estimate numbers from flights, from the nominal rig and typical effects on."""
    base = load_rig("makki2024")
    start = type(model)(parse_effects([effect.name for effect in model.effects]))
    records = [prepare(flight, base, f"teaching {i}") for i, flight in enumerate(training_flights)]
    parameter_vector = RigParameters(start, base, records)
    functions = model_functions(start, parameter_vector.quantities)
    fitted = estimate(
        parameter_vector, [filter_record(record) for record in records], functions, parameter_vector.start
    )
    values = {
        parameter.quantity: float(value)
        for parameter, value in zip(parameter_vector.free, fitted.theta, strict=True)
        if parameter.record is None
    }
    numbers = base.replace(**{name: value for name, value in values.items() if name in base})
    effects: list[Effect] = [
        replace(effect, values={name: values.get(name, was) for name, was in effect.values.items()})
        for effect in start.effects
    ]
    return type(model)(tuple(effects)), numbers
