"""Calibrates a twin on nominal flights: disturbances, uncertainty of the rig, and the tail of the evidence.

The evidence without a change is drawn along the nominal flights themselves. The filter follows a flight, and
its innovations are replaced by pieces of its own innovations in another order and with random signs. A
simulation would instead need gains that stabilise the rig. The errors of the rig's parameters are states of
the filter, so that innovations and sensitivities already contain them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.errors import FlightAborted
from heli_sim.model.base import Model
from heli_sim.model.linear import derivatives, trim
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.errors import TwinError
from heli_lab.fit.estimator import estimate
from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import InnovationsModel
from heli_lab.fit.linearised_flight import BLOCK_s, LinearisedFlight
from heli_lab.fit.normal_equations import posterior_step
from heli_lab.fit.records import Record, prepare
from heli_lab.watch.twin.calibration import DEFAULT_DISTURBANCES, Calibration
from heli_lab.watch.twin.draws import Draws, FollowedFlight, drawn_evidence, evidence
from heli_lab.watch.twin.flights import count_rad_of
from heli_lab.watch.twin.healthy_flights import fly_simulated, random_plan, with_process_noise
from heli_lab.watch.twin.model_check import FILTER_SETTLING_s
from heli_lab.watch.twin.parameter_uncertainty import SUPPLY_STD, ParameterUncertainty
from heli_lab.watch.twin.tail import fit_tail
from heli_lab.watch.twin.twin_model import TwinModel

DRAWN_s: Final = 720.0
"""Time of flight for which the evidence is drawn, s. It gives some 30 excursions, and a standard error of
18 % for the scale of the tail. More: minutes of waiting. Less: thresholds that chance sets."""
FLIGHTS: Final = 12
"""Number of simulated flights of a rig without nominal flights, one minute each, for the same reason."""
_MIN_FREE_s: Final = 10.0
"""Shortest free flight along which evidence is drawn, s: an onset needs some seconds to show. Longer: short
flights are refused. Shorter: the draws contain no whole excursion."""
_VOLTAGE_MARGIN: Final = 0.1
"""Share by which voltages may exceed those of the nominal flights, for the model to count as known: of
their range below, so that a rotor that brakes or reverses for the first time is noticed; of the voltage
above, where a weaker supply leads. Larger: unknown physics is taken for a change. Smaller: little of
another flight counts."""
_MAX_ATTEMPTS_PER_FLIGHT: Final = 3
"""Greatest number of attempts per flight: the board does not arm if gusts move the arm on the table."""
DETECTABLE_WITHIN_s: Final = 0.5
"""Time within which a gust must move an axis by the rounding of its encoder to be detectable, s. It equals
the correlation time of the gusts of a quiet room. Longer: the lower bound admits gusts that no flight shows.
Shorter: the lower bound exceeds the gusts of a quiet room."""
_FEW_SHARE: Final = 1.0 / 3.0
"""Share of a quiet room's gusts below which a warning is given."""
_DRAWS_STREAM: Final = 32
"""Second part of the seed of the draws, so that they are independent of flights that are simulated with the
same seed. Any other number gives other draws, equally good."""
_EVIDENCE_SHARE: Final = 0.3
"""Share of the work before the draws, for the progress: the draws take most of the time."""
Say = Callable[[str, float], None]
"""Function that takes the present stage and the share of the work that is done."""


def at_least_rounding(
    disturbances: DisturbanceModel, model: Model, rig: Rig, count_rad: Floats
) -> DisturbanceModel:
    """Raise disturbances to the smallest ones that the encoders can show. Shapes: `count_rad` (3,).

    A gust is not detectable if it moves an axis within `DETECTABLE_WITHIN_s` by less than the standard
    deviation of the rounding, a count over the root of 12. Estimates below that bound are arbitrary.
    """
    model_without_effects = type(model)()
    hover = trim(model_without_effects, rig)
    names = model_without_effects.parameter_names
    torques = [names.index(f"torque_{axis}") for axis in AXES]
    by_torque = derivatives(model_without_effects, rig, hover.state, hover.volts_V).P[3:6, torques]
    rounding_rad = count_rad / 12.0**0.5
    # A constant torque moves an axis at rest by acceleration * t^2 / 2.
    min_Nm = 2.0 * rounding_rad / (np.abs(np.diagonal(by_torque)) * DETECTABLE_WITHIN_s**2)
    # A shorter gust moves an axis less: by the square root of the number of impulses that add up.
    averaging_factor = np.minimum(
        np.sqrt(8.0 * disturbances.correlation_time_s / (3.0 * DETECTABLE_WITHIN_s)), 1.0
    )
    is_undetectable = disturbances.fast_std * averaging_factor < min_Nm
    return replace(
        disturbances,
        fast_std=np.where(is_undetectable, min_Nm, disturbances.fast_std),
        correlation_time_s=np.where(is_undetectable, DETECTABLE_WITHIN_s, disturbances.correlation_time_s),
        quantisation=np.maximum(disturbances.quantisation, 1.0),
        curvature=None,
    )


def has_few_disturbances(disturbances: DisturbanceModel) -> bool:
    """Whether the gusts about an axis are so small that those of an ordinary day will raise an alarm."""
    return bool(np.any(disturbances.fast_std < _FEW_SHARE * DEFAULT_DISTURBANCES.fast_std))


def learn_rig(
    model: Model, rig: Rig, healthy: Sequence[Flight], labels: Sequence[str]
) -> tuple[DisturbanceModel, ParameterUncertainty]:
    """Estimate disturbances and the uncertainty of parameters from nominal flights, named `labels`.

    The parameters keep the rig's values; encoder zeros and constant torques are estimated per flight. The
    tolerances of the rig file are the priors.
    """
    twin_model = TwinModel(model, rig).model
    records = [prepare(flight, rig, label) for flight, label in zip(healthy, labels, strict=True)]
    references = [filter_record(record) for record in records]
    # First estimate the disturbances and the constants of each flight, with the rig's parameters fixed.
    all_parameters = RigParameters(twin_model, rig, records)
    names = twin_model.parameter_names
    rig_values = dict(zip(names, twin_model.parameter_values(rig), strict=True))
    shared = [parameter.quantity for parameter in all_parameters.free if parameter.record is None]
    fixed = {name: float(rig_values[name]) for name in shared}
    flight_constants = RigParameters(twin_model, rig, records, fixed)
    functions = model_functions(twin_model, flight_constants.quantities)
    constants = estimate(flight_constants, references, functions, flight_constants.start)
    count_rad = np.min([count_rad_of(flight, rig) for flight in healthy], axis=0)
    disturbances = at_least_rounding(constants.disturbances, twin_model, rig, count_rad)
    # Then compute the covariance of all parameters at these estimates. The rig's parameters are the first.
    theta = np.concatenate(([fixed[name] for name in shared], constants.theta))
    functions = model_functions(twin_model, all_parameters.quantities)
    linearised = [
        LinearisedFlight(reference, functions, all_parameters.parameters(theta, index))
        for index, reference in enumerate(references)
    ]
    filtered = InnovationsModel(linearised, all_parameters.columns, len(theta))
    innovations = filtered.innovations(disturbances)
    posterior = posterior_step(
        all_parameters,
        theta,
        innovations.information(),
        innovations.score(),
        per_flight=innovations.per_flight,
    )
    covariance = posterior.covariance[: len(shared), : len(shared)]
    low_V, high_V = _known_voltages(records)
    return disturbances, ParameterUncertainty(tuple(shared), covariance, SUPPLY_STD, low_V, high_V)


def _known_voltages(records: Sequence[Record]) -> tuple[Floats, Floats]:
    """Return the lowest and the highest voltage of each rotor for which parameters hold [V], (2,) each."""
    free_V = np.vstack(
        [record.voltages_V[start:stop] for record in records for start, stop in record.segments]
    )
    lowest_V, highest_V = free_V.min(axis=0), free_V.max(axis=0)
    low_V = lowest_V - _VOLTAGE_MARGIN * (highest_V - lowest_V)
    # A rotor that reverses for the first time is unknown, however slowly it turned before.
    low_V = np.where(lowest_V >= 0.0, np.maximum(low_V, 0.0), low_V)
    high_V = (1.0 + _VOLTAGE_MARGIN) * highest_V
    return low_V, high_V


def learn(
    model: Model,
    rig: Rig,
    healthy: Sequence[Flight] = (),
    labels: Sequence[str] = (),
    *,
    drawn_s: float = DRAWN_s,
    seed: int = 1,
    say: Say = lambda _text, _share: None,
) -> Calibration:
    """Estimate the calibration of a twin."""
    if not healthy:
        return _calibrate_by_simulation(model, rig, seed, say)
    say("disturbances of the nominal flights", 0.0)
    disturbances, uncertainty = learn_rig(model, rig, healthy, labels)
    twin = TwinModel(model, rig, uncertainty)
    followed_flights: list[FollowedFlight] = []
    for flight, label in zip(healthy, labels, strict=True):
        say(f"evidence in {label}", 0.1)
        followed_flights.append(evidence(twin, disturbances, flight))
    healthy_s = BLOCK_s * sum(len(flight.history) for flight in followed_flights)
    if healthy_s < _MIN_FREE_s:
        raise TwinError(
            f"{healthy_s:.1f} s of free nominal flight are too short for a threshold",
            f"give flights with at least {_MIN_FREE_s:g} s in the air",
        )
    # The filter starts with uncertain states, so its first innovations are not those of a settled filter.
    first_settled = round(FILTER_SETTLING_s / BLOCK_s)
    innovations = [flight.innovations[first_settled:] for flight in followed_flights]
    histories = [flight.history_without_kicks() for flight in followed_flights]
    draws = Draws(innovations, math.ceil(drawn_s / healthy_s), np.random.default_rng([seed, _DRAWS_STREAM]))
    for number, flight in enumerate(healthy):
        say(
            f"draws along {labels[number]}", _EVIDENCE_SHARE + (1.0 - _EVIDENCE_SHARE) * number / len(healthy)
        )
        histories += drawn_evidence(twin, disturbances, flight, draws)
    return Calibration(disturbances, fit_tail(histories, healthy_s), ", ".join(labels), uncertainty)


def _calibrate_by_simulation(model: Model, rig: Rig, seed: int, say: Say) -> Calibration:
    """Set the threshold by simulated flights in the disturbances of a quiet room."""
    twin = TwinModel(model, rig)
    noisy_model = with_process_noise(twin.model, DEFAULT_DISTURBANCES)
    histories: list[list[tuple[float, float]]] = []
    for number in range(_MAX_ATTEMPTS_PER_FLIGHT * FLIGHTS):
        if len(histories) == FLIGHTS:
            break
        say(f"simulated flight {len(histories) + 1} of {FLIGHTS}", len(histories) / FLIGHTS)
        # Users choose small seeds: these flights must differ from theirs.
        flight_seed = 1_000_000 * seed + number
        try:
            flight = fly_simulated(noisy_model, rig, random_plan(flight_seed), flight_seed)
        except FlightAborted:
            continue
        histories.append(evidence(twin, DEFAULT_DISTURBANCES, flight).history)
    source = f"{FLIGHTS} simulated flights, seed {seed}"
    return Calibration(DEFAULT_DISTURBANCES, fit_tail(histories), source)
