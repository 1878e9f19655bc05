"""The term that a model lacks without a cause, as the flights show it, and the contribution of the cause.

A cause is removed from the model, and every other parameter stays. A smoother then estimates the missing
torque as a disturbance. The equation of the cause has no part in that estimate: if the two agree, the
flights confirm the equation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Prior

from heli_lab.diagnose.search import (
    KNOTS,
    QUANTITIES,
    Candidate,
    Screening,
    SplineTerm,
    bspline_basis,
    coefficient_std,
    knot_span,
    quantity_values,
    spline_candidate,
    spline_term,
)
from heli_lab.diagnose.thresholds import CURVE_SHARE
from heli_lab.diagnose.wording import display_unit, quantity_in_words
from heli_lab.estimation import Estimate, LinearisedFlight, smoothed_disturbances
from heli_lab.estimation.estimate import estimate_disturbances
from heli_lab.identify.flight_model import RigParameters, model_functions
from heli_lab.identify.model_along import model_along

TIME: Final = "time of the flight"
"""Quantity over which a term is drawn that follows no single quantity."""
_LAGS_s: Final = (0.03, 0.06, 0.1, 0.15)
"""Time constants of lags that measure how fast a thrust changes: those of rotors."""
_CURVE_POINTS: Final = 15
"""Points of the curve of an angle: two between knots."""
_PRIOR_STD_rad: Final = 0.3
"""Prior standard deviation of that curve's coefficients: wide, so that no prior biases the points to zero."""
_SPLINE_NUMBER: Final = 98
"""A number above those of a model's own spline terms, so that parameter names differ."""


@dataclass(frozen=True)
class MissingTerm:
    """Missing torque or angle on one axis at each measurement of the filter, in display units.

    The mean of a torque is subtracted, because a constant torque is a parameter of every model.

    Parameters
    ----------
    id : str
        The cause: an effect's id, or ``spline:CHANNEL:QUANTITY``.
    what, unit : str
        ``torque`` in mN m, or ``angle`` in degrees.
    axis : str
        ``elevation``, ``pitch`` or ``travel``.
    on, on_unit : str
        Quantity that the cause depends on, in words, and its display unit; `TIME` if the cause depends on
        several quantities.
    quantity : ndarray (n,)
        Values of the quantity.
    missing, std : ndarray (n,)
        Torque or angle that the model lacks without the cause, and its standard error.
    remaining : ndarray (n,)
        Torque or angle that the model lacks with the cause.
    contribution : ndarray (n,)
        Torque or angle by the equation of the cause.
    """

    id: str
    what: str
    unit: str
    axis: str
    on: str
    on_unit: str
    quantity: Floats
    missing: Floats
    std: Floats
    remaining: Floats
    contribution: Floats

    @property
    def is_spline(self) -> bool:
        """Whether the cause is a spline term, not an effect of the catalogue."""
        return self.id.startswith("spline:")

    @property
    def share(self) -> float:
        """Share of the variance of what was missing that the contribution explains, at most 1."""
        return 1.0 - float(np.var(self.missing - self.contribution)) / max(
            float(np.var(self.missing)), 1e-300
        )


def missing_term(estimate: Estimate, cause: Candidate) -> MissingTerm:
    """Compute what a model lacks without a cause.

    Parameters
    ----------
    estimate : Estimate
        The model with the cause.
    cause : Candidate
        The effect or spline term that is removed.
    """
    reduced = _without(estimate, cause.effect.name)
    flights = estimate.filtered().linearised_flights
    reduced_flights = reduced.filtered().linearised_flights
    torques_Nm = list(map(_contributed_torque, flights, reduced_flights))
    all_torques_Nm = np.concatenate(torques_Nm)
    if not all_torques_Nm.any():
        return _missing_angle(estimate, reduced, cause)
    blocks = [_MeasurementBlocks(linear) for linear in reduced_flights]
    contribution_Nm = np.concatenate([block.mean(x) for block, x in zip(blocks, torques_Nm, strict=True)])
    missing = _smoothed_torque(reduced)
    remaining = _smoothed_torque(estimate)
    # Without their means: the mean elevation torque of a thrust curve hides the pitch torque of its lag.
    unexplained_std_Nm = (missing.torque_Nm - contribution_Nm).std(axis=0)
    axis = int(np.argmax(all_torques_Nm.std(axis=0) / (unexplained_std_Nm + 1e-9)))
    quantities = [
        {name: block.mean(values) for name, values in _quantities(linear).items()}
        for block, linear in zip(blocks, flights, strict=True)
    ]
    quantity, quantity_name, quantity_unit = missing.t_s, TIME, "s"
    name = _best_quantity(quantities, contribution_Nm[:, axis], cause)
    if name is not None:
        quantity_factor, quantity_unit = display_unit(_unit(name))
        quantity = quantity_factor * np.concatenate([by_name[name] for by_name in quantities])
        quantity_name = quantity_in_words(name)
    factor, unit = display_unit("N m")
    return MissingTerm(
        id=cause.id,
        what="torque",
        unit=unit,
        axis=AXES[axis],
        on=quantity_name,
        on_unit=quantity_unit,
        quantity=quantity,
        missing=factor * _without_mean(missing.torque_Nm[:, axis]),
        std=factor * missing.std_Nm[:, axis],
        remaining=factor * _without_mean(remaining.torque_Nm[:, axis]),
        contribution=factor * _without_mean(contribution_Nm[:, axis]),
    )


def _without_mean(values: Floats) -> Floats:
    """Return values less their mean."""
    centred: Floats = values - values.mean()
    return centred


class _MeasurementBlocks:
    """Steps of a flight, grouped by measurements of the filter."""

    def __init__(self, linear: LinearisedFlight) -> None:
        first_steps = np.concatenate([block.rows for block in linear.blocks])
        self._steps = first_steps[:, None] + np.arange(linear.block)  # (measurements, steps of each)

    def mean(self, values: Floats) -> Floats:
        """Return the means, shape (measurements, ...), of values of the steps, shape (n, ...)."""
        means: Floats = values[self._steps].mean(axis=1)
        return means


def _without(estimate: Estimate, name: str) -> Estimate:
    """Return the estimate without the effect `name`: other parameters stay, disturbances are re-estimated."""
    whole = estimate.parameter_vector.model
    model = type(whole)(tuple(effect for effect in whole.effects if effect.name != name))
    reduced = _with_model(estimate, model, {})
    filtered = reduced.filtered()
    disturbances = estimate_disturbances(filtered, filtered.perturbed_residual(), estimate.disturbances)
    return replace(reduced, disturbances=disturbances)


def _with_model(estimate: Estimate, model: Model, fixed: Mapping[str, float]) -> Estimate:
    """Return the estimate of another model at the same parameters, of which those in `fixed`, by name, are
    not free.
    """
    values = estimate.parameter_vector.by_name(estimate.theta)
    records = [reference.record for reference in estimate.references]
    vector = RigParameters(model, estimate.parameter_vector.rig, records, fixed=fixed)
    start = zip(vector.names, vector.start, strict=True)
    return replace(
        estimate,
        parameter_vector=vector,
        theta=np.array([values.get(name, value) for name, value in start]),
        covariance=np.diag(vector.std**2),
        functions=model_functions(model, vector.quantities),
    )


def _coefficients(screening: Screening, candidate: Candidate) -> tuple[Floats, Floats]:
    """Estimate the coefficients of a spline term by a score test.

    Returns
    -------
    ndarray (KNOTS,)
        Coefficients.
    ndarray (KNOTS, KNOTS)
        Their covariance.
    """
    ((information, score),) = screening.spline_information([candidate])
    precision = np.diag(coefficient_std(candidate) ** -2.0)
    covariance = np.asarray(np.linalg.inv(information + precision), float)
    return covariance @ score, covariance


class _SmoothedTorque(NamedTuple):
    """Smoothed disturbances of all flights: times (k,), torques and standard errors (k, 3) [N m]."""

    t_s: Floats
    torque_Nm: Floats
    std_Nm: Floats


def _smoothed_torque(estimate: Estimate) -> _SmoothedTorque:
    """Estimate the disturbance torques about the three axes by a fixed-interval smoother."""
    by_flight = smoothed_disturbances(estimate.filtered(), estimate.disturbances)
    t_s, torque_Nm, std_Nm = (np.concatenate(values) for values in zip(*by_flight, strict=True))
    return _SmoothedTorque(t_s, torque_Nm, std_Nm)


def _contributed_torque(flight: LinearisedFlight, flight_without: LinearisedFlight) -> Floats:
    """Return the torque that is equivalent to an effect, along the trajectory, shape (n, 3) [N m].

    It causes the difference of the accelerations with and without the effect.
    """
    change_rad_s2 = _accelerations(flight) - _accelerations(flight_without)
    return flight_without.disturbance_for(change_rad_s2)


def _accelerations(linear: LinearisedFlight) -> Floats:
    """Return the angular accelerations of the model along its trajectory, shape (n, 3) [rad/s2]."""
    model = linear.model.source
    (rates,) = model_along(model, lambda x, u, p, t: [model.dynamics(x, u, p, t)[3:6]])(linear.trajectory)
    return np.ascontiguousarray(rates[:, :, 0])


def _quantities(linear: LinearisedFlight) -> dict[str, Floats]:
    """Quantities that a cause may depend on, shape (n,), by name: those of spline terms, and how fast the
    thrust changes, on which lags and delays depend.
    """
    values = quantity_values(linear.model.source, linear.trajectory)
    for name, time_s in itertools.product(("thrust", "thrust_difference"), _LAGS_s):
        lagged = _lagged(values[name], linear.trajectory.step_s / time_s)
        values[f"change of {name} within {time_s:g} s"] = values[name] - lagged
    return values


def _lagged(values: Floats, step: float) -> Floats:
    """Return values (n,) behind a first-order lag that starts at rest; `step` is the sampling interval over
    its time constant.
    """
    # Without scipy.signal, whose import takes longer than this loop for an hour of flight.
    gain = -math.expm1(-step)
    lagged = itertools.accumulate(values.tolist(), lambda output, value: output + gain * (value - output))
    return np.fromiter(lagged, float)


def _best_quantity(
    quantities: Sequence[Mapping[str, Floats]], contribution: Floats, cause: Candidate
) -> str | None:
    """Return the quantity of which a contribution is nearly a function; None if there is none.

    `quantities` are those of each flight by name; `contribution` has the values of all flights.
    """
    if isinstance(cause.effect, SplineTerm):
        return cause.effect.on
    shares = {
        name: _explained_share(np.concatenate([by_name[name] for by_name in quantities]), contribution)
        for name in quantities[0]
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] >= CURVE_SHARE else None


def _unit(name: str) -> str:
    """Return the SI unit of a quantity of `_quantities`."""
    return "N" if name.startswith("change of ") else QUANTITIES[name][1]


def _explained_share(quantity: Floats, contribution: Floats) -> float:
    """Return the coefficient of determination (R2) of a spline of one quantity for a contribution."""
    low, step = knot_span(quantity)
    basis = bspline_basis(quantity, low, step)
    fitted = basis @ np.linalg.lstsq(basis, contribution, rcond=None)[0]
    return 1.0 - float(np.var(contribution - fitted)) / max(float(np.var(contribution)), 1e-300)


def _missing_angle(estimate: Estimate, reduced: Estimate, cause: Candidate) -> MissingTerm:
    """Estimate the missing angle of an effect on an encoder: a spline in the place of the effect.

    `reduced` is the estimate without the effect.
    """
    # The effect's parameters are fixed: free, they would explain the angle that the spline is to show.
    values = estimate.parameter_vector.by_name(estimate.theta)
    fixed = {name: values[name] for name in cause.effect.values if name in values}
    screening = Screening(_with_model(estimate, estimate.parameter_vector.model, fixed))
    reduced_screening = Screening(reduced)
    flights = screening.filtered.linearised_flights
    contribution_rad = np.concatenate(
        [
            _measured_angles(linear) - _measured_angles(reduced_linear)
            for linear, reduced_linear in zip(
                flights, reduced_screening.filtered.linearised_flights, strict=True
            )
        ]
    )
    axis = int(np.argmax(contribution_rad.std(axis=0)))
    quantities = [quantity_values(linear.model.source, linear.nodes) for linear in flights]
    name = _best_quantity(quantities, contribution_rad[:, axis], cause) or AXES[axis]
    quantity = np.concatenate([by_name[name] for by_name in quantities])
    low, step = knot_span(quantity)
    term = spline_term(f"measurement.{AXES[axis]}", name, low, step, _SPLINE_NUMBER)
    term = replace(term, priors={prior_name: Prior(0.0, _PRIOR_STD_rad) for prior_name in term.priors})
    candidate = spline_candidate(term)
    curve_points = np.linspace(low, low + step * (KNOTS - 3), _CURVE_POINTS)
    basis = bspline_basis(curve_points, low, step)
    basis -= basis.mean(axis=0)
    missing, covariance = _coefficients(reduced_screening, candidate)
    remaining, _ = _coefficients(screening, candidate)
    std_rad = np.sqrt(np.einsum("ni,ij,nj->n", basis, covariance, basis))
    flight_basis = bspline_basis(quantity, low, step)
    contribution = np.linalg.lstsq(flight_basis, contribution_rad[:, axis], rcond=None)[0]
    factor, unit = display_unit("rad")
    quantity_factor, quantity_unit = display_unit(_unit(name))
    return MissingTerm(
        id=cause.id,
        what="angle",
        unit=unit,
        axis=AXES[axis],
        on=quantity_in_words(name),
        on_unit=quantity_unit,
        quantity=quantity_factor * curve_points,
        missing=factor * (basis @ missing),
        std=factor * std_rad,
        remaining=factor * (basis @ remaining),
        contribution=factor * (basis @ contribution),
    )


def _measured_angles(linear: LinearisedFlight) -> Floats:
    """Return the angles that the encoders of a model would measure along its trajectory, (n, 3) [rad]."""
    model = linear.model.source
    (angles,) = model_along(model, lambda x, u, p, t: [model.measurement(x, u, p, t)])(linear.nodes)
    return np.ascontiguousarray(angles[:, :, 0])
