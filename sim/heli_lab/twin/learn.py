"""A rig's weather from its healthy flights, and the tail of the evidence by parametric bootstrap."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.errors import FlightAborted
from heli_host.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.linear import derivatives, trim
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.estimation import BLOCK_s, DisturbanceModel, estimate
from heli_lab.identify import Record, prepare
from heli_lab.identify.flight_model import RigParameters, kinematic_filter, model_functions
from heli_lab.twin.calibration import QUIET, Calibration, Tail, fit_tail
from heli_lab.twin.flights import count_rad_of, samples_of
from heli_lab.twin.healthy_flights import fly_simulated, in_weather, random_plan
from heli_lab.twin.kalman_filter import TwinModel
from heli_lab.twin.twin import Twin

FLIGHTS: Final = 12
"""Simulated flights of the bootstrap, a minute each: some 30 excursions to fit the tail to, which leaves
its scale 18 % unsure. More: minutes of waiting. Fewer: thresholds that chance sets."""

_TRIES: Final = 3
"""Flights begun for each that is wanted: an arm that gusts move on its table is not armed."""
SHOWS_s: Final = 0.5
"""Time within which a gust has to move an axis by the rounding to be known, s: the memory of the gusts of a
quiet room. Longer: gusts are believed that no flight tells. Shorter: the floor is above a quiet room's
gusts."""
_CALM: Final = 1.0 / 3.0
"""Share of a quiet room's gusts below which a learned weather is called calm."""
NEVER: Final = Tail(np.inf, 0.0, 0.0, 1)
"""Of a twin that calls nothing an alarm."""

Say = Callable[[str, float], None]


def learn_disturbances(model: Model, rig: Rig, records: Sequence[Record]) -> DisturbanceModel:
    """Estimate the weather of healthy flights; the rig's numbers stay, zeros and constant torques are each
    flight's own.
    """
    shared = RigParameters(model, rig, records)
    values = dict(zip((q.name for q in model.parameters), model.parameter_values(rig), strict=True))
    fixed = {
        parameter.quantity: float(values[parameter.quantity])
        for parameter in shared.free
        if parameter.record is None
    }
    parameter_vector = RigParameters(model, rig, records, fixed)
    functions = model_functions(model, parameter_vector.quantities)
    estimate_ = estimate(
        parameter_vector, [kinematic_filter(record) for record in records], functions, parameter_vector.start
    )
    return estimate_.disturbances


def at_least_rounding(
    disturbances: DisturbanceModel, model: Model, rig: Rig, count_rad: Floats
) -> DisturbanceModel:
    """Raise a weather to the least that encoders can show.

    A gust that moves an axis within `SHOWS_s` by less than the standard deviation of the rounding, a count
    over the root of 12, cannot be told from none: of calm flights its estimate is anything from there down.

    Parameters
    ----------
    disturbances : DisturbanceModel
        As estimated.
    model : Model
        Equations.
    rig : Rig
        Its numbers.
    count_rad : ndarray (3,)
        One count of each encoder.
    """
    bare = type(model)()
    hover = trim(bare, rig)
    names = [quantity.name for quantity in bare.parameters]
    torques = [names.index(f"torque_{axis}") for axis in AXES]
    by_torque = derivatives(bare, rig, hover.state, hover.volts_V).P[3:6, torques]
    rounding_rad = count_rad / 12.0**0.5
    least_Nm = 2.0 * rounding_rad / (np.abs(np.diagonal(by_torque)) * SHOWS_s**2)
    # A gust that is shorter moves an axis less: as the root of the impulses that add up.
    share = np.minimum(np.sqrt(8.0 * disturbances.correlation_time_s / (3.0 * SHOWS_s)), 1.0)
    small = disturbances.fast_std * share < least_Nm
    return replace(
        disturbances,
        fast_std=np.where(small, least_Nm, disturbances.fast_std),
        correlation_time_s=np.where(small, SHOWS_s, disturbances.correlation_time_s),
        quantisation=np.maximum(disturbances.quantisation, 1.0),
        curvature=None,
    )


def is_calm(disturbances: DisturbanceModel) -> bool:
    """Whether about some axis there was so little weather that that of an ordinary day will be an alarm."""
    return bool(np.any(disturbances.fast_std < _CALM * QUIET.fast_std))


def learn_disturbances_of_flights(
    model: Model, rig: Rig, healthy: Sequence[Flight], labels: Sequence[str]
) -> DisturbanceModel:
    """Prepare healthy flights, called `labels`, and estimate their weather, `at_least_rounding`.

    Raises
    ------
    IdentifyError
        A flight is not sound, or nothing flies in it.
    """
    calm = TwinModel(model, rig).model
    records = [prepare(flight, rig, label) for flight, label in zip(healthy, labels, strict=True)]
    count_rad = np.min([count_rad_of(flight, rig) for flight in healthy], axis=0)
    return at_least_rounding(learn_disturbances(calm, rig, records), calm, rig, count_rad)


def learn(
    model: Model,
    rig: Rig,
    healthy: Sequence[Flight] = (),
    labels: Sequence[str] = (),
    *,
    flights: int = FLIGHTS,
    seed: int = 1,
    say: Say = lambda _text, _share: None,
) -> Calibration:
    """Learn weather and tail.

    Parameters
    ----------
    model : Model
        Equations with the rig's effects.
    rig : Rig
        Its numbers.
    healthy : sequence of Flight
        Flights in which nothing changed, as long in all as those that the rig's numbers were found in;
        without any the weather is that of a quiet room, and the numbers count as known.
    labels : sequence of str
        Their names.
    flights : int
        Simulated flights.
    seed : int
        Of the simulated flights.
    say : callable taking str and float
        Is told what is done, and what share is done.

    Raises
    ------
    IdentifyError
        A flight is not sound, or nothing flies in it.
    """
    twin = TwinModel(model, rig)
    disturbances = QUIET
    if healthy:
        say("weather of the healthy flights", 0.0)
        disturbances = learn_disturbances_of_flights(model, rig, healthy, labels)
    references = []
    for flight, label in zip(healthy, labels, strict=True):
        say(f"evidence in {label}", 0.1)
        references.append(evidence(twin, disturbances, flight))
    taught_s = BLOCK_s * sum(map(len, references)) if references else math.inf
    flown = in_weather(twin.model, disturbances)
    done = 0
    for number in range(_TRIES * flights):
        if done == flights:
            break
        say(f"simulated flight {done + 1} of {flights}", 0.1 + 0.9 * done / flights)
        # Seeds of flights that somebody else simulates are small numbers.
        flight_seed = 1_000_000 * seed + number
        try:
            flight = fly_simulated(flown, rig, random_plan(flight_seed), flight_seed)
        except FlightAborted:
            continue
        references.append(evidence(twin, disturbances, flight))
        done += 1
    own_text = f"{', '.join(labels)} and " if labels else ""
    return Calibration(
        disturbances, fit_tail(references, taught_s), f"{own_text}{flights} simulated flights, seed {seed}"
    )


def evidence(twin: TwinModel, disturbances: DisturbanceModel, flight: Flight) -> list[tuple[float, float]]:
    """Times and evidence of a flight in which nothing is called an alarm."""
    samples, sample_s = samples_of(flight)
    never = Calibration(disturbances, NEVER)
    follower = Twin(twin, never, count_rad_of(flight, twin.rig), sample_s)
    follower.keeps = True
    follower.take(samples)
    return follower.evidence_history
