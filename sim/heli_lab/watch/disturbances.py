"""Disturbances of flights of a rig whose parameters are known, and when the voltages of their logs act.

A log that is slower than its control loop has samples of the voltages that acted, as
`heli_lab.fit.voltage_timing` describes. Only constants of each flight and disturbances are estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.model.linear import derivatives
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.explain.assessment import estimated_advance
from heli_lab.explain.screening import Screening
from heli_lab.fit.estimator import Estimate, estimate
from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions, without_random_effects
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.reference_trajectory import ReferenceTrajectory
from heli_lab.fit.voltage_timing import may_be_slower, sampled, slow_log_notes, with_acting_voltages

DETECTABLE_WITHIN_s: Final = 0.5
"""Time within which a gust must move an axis by the rounding of its encoder to be detectable, s. It equals
the correlation time of the gusts of a quiet room. Longer: the lower bound admits gusts that no flight shows.
Shorter: the lower bound exceeds the gusts of a quiet room."""


class FixedRigEstimate(NamedTuple):
    """Disturbances and constants of flights, estimated with the parameters of the rig fixed."""

    model: Model  # Equations without random disturbances
    records: Sequence[Record]
    references: list[ReferenceTrajectory]
    all_parameters: RigParameters  # Parameters of the rig, then the constants of each flight
    fixed: dict[str, float]  # Value of each parameter of the rig
    estimate: Estimate  # Encoder zeros and constant torques of each flight, and its disturbances
    disturbances: DisturbanceModel  # The same disturbances, at least those that the encoders can show


def estimate_with_fixed_rig(model: Model, rig: Rig, records: Sequence[Record]) -> FixedRigEstimate:
    """Estimate the disturbances and the constants of each flight."""
    # Effects with random inputs are left out: the estimated disturbances take their place.
    deterministic = without_random_effects(model)
    references = [filter_record(record) for record in records]
    all_parameters = RigParameters(deterministic, rig, records)
    names = deterministic.parameter_names
    rig_values = dict(zip(names, deterministic.parameter_values(rig), strict=True))
    shared_names = [parameter.quantity for parameter in all_parameters.free if parameter.is_shared]
    fixed = {name: float(rig_values[name]) for name in shared_names}
    flight_constants = RigParameters(deterministic, rig, records, fixed)
    functions = model_functions(deterministic, flight_constants.quantities)
    constants = estimate(flight_constants, references, functions, flight_constants.start)
    count_rad = np.min([record.count_rad for record in records], axis=0)
    disturbances = at_least_rounding(constants.disturbances, deterministic, rig, count_rad)
    return FixedRigEstimate(
        deterministic, records, references, all_parameters, fixed, constants, disturbances
    )


def learn_disturbances(model: Model, rig: Rig, flight: Flight, label: str) -> DisturbanceModel:
    """Estimate the disturbances of a flight with the parameters of the rig fixed."""
    return estimate_with_fixed_rig(model, rig, [prepare(flight, rig, label)]).disturbances


def at_least_rounding(
    disturbances: DisturbanceModel, model: Model, rig: Rig, count_rad: Floats
) -> DisturbanceModel:
    """Raise disturbances to the smallest ones that the encoders can show. Shapes: `count_rad` (3,)."""
    # A gust is not detectable if it moves an axis within `DETECTABLE_WITHIN_s` by less than the standard
    # deviation of the rounding, a count over the root of 12. Estimates below that bound are arbitrary.
    model_without_effects = type(model)()
    names = model_without_effects.parameter_names
    torques = [names.index(f"torque_{axis}") for axis in AXES]
    # The inertias of the level arm at rest depend on no voltage, so a rig that cannot hover has them too.
    level = np.zeros(len(model_without_effects.states))
    accelerations = slice(3, 6)  # The states are three angles, then their rates
    by_torque = derivatives(model_without_effects, rig, level, np.zeros(2)).P[accelerations, torques]
    rounding_rad = count_rad / 12.0**0.5
    # A constant torque moves an axis at rest by acceleration * t^2 / 2.
    min_Nm = 2.0 * rounding_rad / (np.abs(np.diagonal(by_torque)) * DETECTABLE_WITHIN_s**2)
    # A shorter gust moves an axis less. Gusts of the variance s^2 and the correlation time T act as white
    # noise of the intensity 2 s^2 T, and move the axis with the variance 2 s^2 T t^3 / 3 instead of
    # s^2 t^4 / 4.
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


def with_likely_advance(
    model: Model, rig: Rig, records: Sequence[Record], loop_Hz: float | None
) -> tuple[Record, ...]:
    """Return flights whose voltages act earlier within their rows, if the flights are much more likely so."""
    # `loop_Hz` is the rate of the control loop; if it is None, the flights show whether their log is slower.
    # The logs are of one logger.
    present = tuple(records) if loop_Hz is None else sampled(records, loop_Hz)
    if model.delay or not any(may_be_slower(record, loop_Hz) for record in records):
        return present  # a delay is a negative advance
    screening = Screening(estimate_with_fixed_rig(model, rig, present).estimate)
    best = estimated_advance([screening], loop_Hz)
    screening.release()
    if not best.is_significant:
        return present
    return tuple(
        replace(record, advance_rows=best.rows if may_be_slower(record, loop_Hz) else 0.0)
        for record in records
    )


def acting_flights(
    model: Model, rig: Rig, flights: Sequence[Flight], labels: Sequence[str], loop_Hz: float | None
) -> tuple[list[Flight], list[str]]:
    """Return flights of one logger with the mean voltages that acted from row to row, and what their logs
    lack, one sentence for each kind of log.
    """
    # `loop_Hz` is as in `with_likely_advance`.
    result, notes = [], list[str]()
    for flight, label in zip(flights, labels, strict=True):
        try:
            (record,) = with_likely_advance(model, rig, [prepare(flight, rig, label)], loop_Hz)
        except IdentifyError:
            # A flight that cannot be fitted does not show when its voltages act: it stays as logged.
            result.append(flight)
            continue
        notes += slow_log_notes([record])
        # A twin reads whole flights: of the record for a fit, it needs only when the voltages act.
        result.append(with_acting_voltages(flight, record.advance_rows))
    return result, list(dict.fromkeys(notes))  # logs of one kind share a note
