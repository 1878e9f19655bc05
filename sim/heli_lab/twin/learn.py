"""Calibrates a twin: disturbances from nominal flights, tail of the evidence by a parametric bootstrap."""

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
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions
from heli_lab.twin.calibration import DEFAULT_DISTURBANCES, Calibration, Tail, fit_tail
from heli_lab.twin.flights import count_rad_of, samples_of
from heli_lab.twin.healthy_flights import fly_simulated, random_plan, with_process_noise
from heli_lab.twin.kalman_filter import TwinModel
from heli_lab.twin.twin import Twin

FLIGHTS: Final = 12
"""Number of simulated flights of the bootstrap, one minute each. They give some 30 excursions, and a standard
error of 18 % for the scale of the tail. More: minutes of waiting. Fewer: thresholds that chance sets."""

_TRIES: Final = 3
"""Greatest number of attempts per flight: the board does not arm if gusts move the arm on the table."""
DETECTABLE_WITHIN_s: Final = 0.5
"""Time within which a gust must move an axis by the rounding of its encoder to be detectable, s. It equals
the correlation time of the gusts of a quiet room. Longer: the lower bound admits gusts that no flight shows.
Shorter: the lower bound exceeds the gusts of a quiet room."""
_FEW: Final = 1.0 / 3.0
"""Share of a quiet room's gusts below which a warning is given."""
NO_ALARM: Final = Tail(np.inf, 0.0, 0.0, 1)
"""Tail of a twin that raises no alarm."""

Say = Callable[[str, float], None]


def learn_disturbances(model: Model, rig: Rig, records: Sequence[Record]) -> DisturbanceModel:
    """Estimate the disturbances in nominal flights. The rig's parameters are fixed; encoder zeros and
    constant torques are estimated per flight.
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
        parameter_vector, [filter_record(record) for record in records], functions, parameter_vector.start
    )
    return estimate_.disturbances


def at_least_rounding(
    disturbances: DisturbanceModel, model: Model, rig: Rig, count_rad: Floats
) -> DisturbanceModel:
    """Raise disturbances to the smallest ones that the encoders can show.

    A gust is not detectable if it moves an axis within `DETECTABLE_WITHIN_s` by less than the standard
    deviation of the rounding, a count over the root of 12. Estimates below that bound are arbitrary.

    Parameters
    ----------
    disturbances : DisturbanceModel
        Estimated disturbances.
    model : Model
        Equations of motion.
    rig : Rig
        Parameters of the rig.
    count_rad : ndarray (3,)
        Angle of one count of each encoder [rad].
    """
    bare = type(model)()
    hover = trim(bare, rig)
    names = [quantity.name for quantity in bare.parameters]
    torques = [names.index(f"torque_{axis}") for axis in AXES]
    by_torque = derivatives(bare, rig, hover.state, hover.volts_V).P[3:6, torques]
    rounding_rad = count_rad / 12.0**0.5
    least_Nm = 2.0 * rounding_rad / (np.abs(np.diagonal(by_torque)) * DETECTABLE_WITHIN_s**2)
    # A shorter gust moves an axis less: by the square root of the number of impulses that add up.
    share = np.minimum(np.sqrt(8.0 * disturbances.correlation_time_s / (3.0 * DETECTABLE_WITHIN_s)), 1.0)
    small = disturbances.fast_std * share < least_Nm
    return replace(
        disturbances,
        fast_std=np.where(small, least_Nm, disturbances.fast_std),
        correlation_time_s=np.where(small, DETECTABLE_WITHIN_s, disturbances.correlation_time_s),
        quantisation=np.maximum(disturbances.quantisation, 1.0),
        curvature=None,
    )


def has_few_disturbances(disturbances: DisturbanceModel) -> bool:
    """Whether the gusts about an axis are so small that those of an ordinary day will raise an alarm."""
    return bool(np.any(disturbances.fast_std < _FEW * DEFAULT_DISTURBANCES.fast_std))


def learn_disturbances_of_flights(
    model: Model, rig: Rig, healthy: Sequence[Flight], labels: Sequence[str]
) -> DisturbanceModel:
    """Estimate the disturbances in nominal flights, named `labels`, with the bounds of `at_least_rounding`.

    Raises
    ------
    IdentifyError
        A flight is damaged, or has no free flight.
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
    """Estimate the calibration of a twin.

    Parameters
    ----------
    model : Model
        Equations with the rig's effects.
    rig : Rig
        Parameters of the rig.
    healthy : sequence of Flight
        Nominal flights, together about as long as those from which the rig's parameters were estimated.
        Without any, the disturbances are those of a quiet room and the parameters count as exact.
    labels : sequence of str
        Names of these flights.
    flights : int
        Number of simulated flights.
    seed : int
        Seed of the simulated flights.
    say : callable taking str and float
        Called with the present stage and the share of the work that is done.

    Raises
    ------
    IdentifyError
        A flight is damaged, or has no free flight.
    """
    twin = TwinModel(model, rig)
    disturbances = DEFAULT_DISTURBANCES
    if healthy:
        say("disturbances of the nominal flights", 0.0)
        disturbances = learn_disturbances_of_flights(model, rig, healthy, labels)
    references = []
    for flight, label in zip(healthy, labels, strict=True):
        say(f"evidence in {label}", 0.1)
        references.append(evidence(twin, disturbances, flight))
    training_s = BLOCK_s * sum(map(len, references)) if references else math.inf
    flown = with_process_noise(twin.model, disturbances)
    done = 0
    for number in range(_TRIES * flights):
        if done == flights:
            break
        say(f"simulated flight {done + 1} of {flights}", 0.1 + 0.9 * done / flights)
        # Users choose small seeds: these flights must differ from theirs.
        flight_seed = 1_000_000 * seed + number
        try:
            flight = fly_simulated(flown, rig, random_plan(flight_seed), flight_seed)
        except FlightAborted:
            continue
        references.append(evidence(twin, disturbances, flight))
        done += 1
    real = f"{', '.join(labels)} and " if labels else ""
    return Calibration(
        disturbances, fit_tail(references, training_s), f"{real}{flights} simulated flights, seed {seed}"
    )


def evidence(twin: TwinModel, disturbances: DisturbanceModel, flight: Flight) -> list[tuple[float, float]]:
    """Return the times [s] and the evidence [nats] of a flight, without raising an alarm."""
    samples, sample_s = samples_of(flight)
    never = Calibration(disturbances, NO_ALARM)
    follower = Twin(twin, never, count_rad_of(flight, twin.rig), sample_s)
    follower.records_evidence = True
    follower.update(samples)
    return follower.evidence_history
