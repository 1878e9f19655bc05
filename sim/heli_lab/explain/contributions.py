"""Contributions of causes: what a model lacks without a cause, and what the cause adds, along flights.

A cause is removed from the model, and every other parameter stays. The missing torque or angle is then
estimated from the flights, without the equation of the cause. If the estimate agrees with the contribution
of the equation, the flights confirm the equation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Prior

from heli_lab.explain.candidates import (
    KNOTS,
    QUANTITIES,
    Candidate,
    SplineTerm,
    bspline_basis,
    knot_span,
    quantity_values,
    spline_candidate,
    spline_term,
)
from heli_lab.explain.comparison import Cause
from heli_lab.explain.screening import Screening, coefficient_std
from heli_lab.explain.thresholds import CURVE_SHARE
from heli_lab.explain.wording import channel_in_words, display_unit, quantity_in_words
from heli_lab.fit.estimator import Estimate, estimate_disturbances
from heli_lab.fit.flight_model import RigParameters, model_along, model_functions
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import InnovationsModel, SmoothedDisturbances, smoothed_disturbances
from heli_lab.fit.linearised_flight import LinearisedFlight


def accelerations(estimate: Estimate, name: str, index: int = 0) -> tuple[Floats, Floats]:
    """Compute the acceleration that an effect contributes along the filtered trajectory of a flight; return
    the times, shape (n,), and the accelerations at them, shape (n, 3).
    """
    linear = estimate.filtered().linearised_flights[index]
    model = linear.model.source
    reduced_model = type(model)(tuple(effect for effect in model.effects if effect.name != name))
    states = [state.name for state in model.states]
    names = model.parameter_names

    def change_rad_s2(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
        # Difference of the models with and without the effect, at the same states and parameters.
        reduced_x = ca.vertcat(*(x[states.index(state.name)] for state in reduced_model.states))
        reduced_p = ca.vertcat(*(p[names.index(q.name)] for q in reduced_model.parameters))
        reduced_rates = reduced_model.dynamics(reduced_x, u, reduced_p, t)
        # The states are three angles and three rates; the derivative of a rate is an acceleration.
        accelerations = slice(3, 6)
        return [model.dynamics(x, u, p, t)[accelerations] - reduced_rates[accelerations]]

    (values,) = model_along(model, change_rad_s2)(linear.trajectory)
    return linear.trajectory.t_s, np.ascontiguousarray(values[:, :, 0])


_LAGS_s: Final = (0.03, 0.06, 0.1, 0.15)
"""Time constants of lags that measure how fast a thrust changes: those of rotors."""
_THRUST_CHANGE: Final = "change of "
"""Beginning of the names of quantities that state how fast a thrust changes."""


def quantities_and_thrust_changes(linear: LinearisedFlight) -> dict[str, Floats]:
    """Return the quantities that a torque may depend on, shape (n,) each, in SI units by name."""
    # These are the quantities of spline terms, and the change of the thrusts within a time, on which lags and
    # delays depend. The change is the difference between a thrust and the same thrust behind a first-order
    # lag.
    values = quantity_values(linear.model.source, linear.trajectory)
    for name, time_constant_s in itertools.product(("thrust", "thrust_difference"), _LAGS_s):
        lagged_N = _first_order_lag(values[name], linear.trajectory.step_s / time_constant_s)
        values[f"{_THRUST_CHANGE}{name} within {time_constant_s:g} s"] = values[name] - lagged_N
    return values


def quantity_unit(name: str) -> str:
    """Return the SI unit of the quantity `name` of `quantities_and_thrust_changes`."""
    return "N" if name.startswith(_THRUST_CHANGE) else QUANTITIES[name].unit


def best_quantity(
    quantities_by_flight: Sequence[Mapping[str, Floats]], contribution: Floats, cause: Candidate
) -> str | None:
    """Return the name of the quantity of which a contribution is nearly a function; None without one. Shapes:
    `contribution` (n of all flights,).
    """
    if isinstance(cause.effect, SplineTerm):
        return cause.effect.on
    shares = {
        name: _share_of_curve(over_all_flights(quantities_by_flight, name), contribution)
        for name in quantities_by_flight[0]
    }
    best = max(shares, key=lambda name: shares[name])
    return best if shares[best] >= CURVE_SHARE else None


def over_all_flights(quantities_by_flight: Sequence[Mapping[str, Floats]], name: str) -> Floats:
    """Return the quantity `name` of all flights, one after the other, from `quantities_by_flight`."""
    return np.concatenate([quantities[name] for quantities in quantities_by_flight])


def explained_share(values: Floats, fitted: Floats) -> float:
    """Return the share of the variance of `values` (n,) that `fitted` (n,) explains, at most 1 (R2)."""
    variance = max(float(np.var(values)), 1e-300)  # no division by zero for constant values
    return 1.0 - float(np.var(values - fitted)) / variance


def _share_of_curve(quantity: Floats, contribution: Floats) -> float:
    """Return the share of a contribution (n,) that a spline curve over one quantity (n,) explains."""
    basis = bspline_basis(quantity, *knot_span(quantity))
    coefficients, *_ = np.linalg.lstsq(basis, contribution, rcond=None)
    return explained_share(contribution, basis @ coefficients)


def _first_order_lag(values: Floats, step_share: float) -> Floats:
    """Return values (n,) behind a first-order lag whose output starts at the first value."""
    # `step_share` is the sampling interval divided by the time constant.
    # Without scipy.signal, whose import takes longer than this loop for an hour of flight.
    gain = -math.expm1(-step_share)
    lagged = itertools.accumulate(values.tolist(), lambda output, value: output + gain * (value - output))
    return np.fromiter(lagged, float)


TIME: Final = "time of the flight"
"""Quantity over which a term is drawn if it follows no single quantity."""


@dataclass(frozen=True)
class MissingTerm:
    """Torque about one axis, or error of one encoder, that a model lacks without one of its causes."""

    # The arrays have one row per measurement of the filter for a torque, and one row per point of a curve for
    # an angle. All values are in display units. The mean of a torque is subtracted, because every model has a
    # constant torque as a parameter.

    id: str  # The cause: an effect's id, or ``spline:CHANNEL:QUANTITY``
    what: str  # what, unit: ``torque`` in mN m, or ``angle`` in degrees
    unit: str
    axis: str  # ``elevation``, ``pitch`` or ``travel``
    on: str
    """on, on_unit: Quantity that the cause depends on, in words, and its display unit; `TIME` if the cause
    depends on several quantities."""
    on_unit: str
    quantity: Floats  # (n,): Values of the quantity
    missing: Floats
    """missing, std: (n,): Torque or angle that the model lacks without the cause, and its standard error."""
    std: Floats
    remaining: Floats  # (n,): Torque or angle that the model lacks with the cause
    contribution: Floats  # (n,): Torque or angle by the equation of the cause

    @property
    def is_spline(self) -> bool:
        """Whether the cause is a spline term, not an effect of the catalogue."""
        return self.id.startswith("spline:")

    @property
    def share(self) -> float:
        """Share of the variance of `missing` that `contribution` explains, at most 1."""
        return explained_share(self.missing, self.contribution)


_CURVE_POINTS: Final = 15
"""Points of the curve of an angle: two between knots."""
_PRIOR_STD_rad: Final = 0.3
"""Prior standard deviation of that curve's coefficients: wide, so that no prior biases the points to zero."""
_SPLINE_NUMBER: Final = 98
"""A number above those of a model's own spline terms, so that parameter names differ."""


class _SplineCoefficients(NamedTuple):
    """Estimated coefficients of a spline, shape (KNOTS,), and their covariance, shape (KNOTS, KNOTS)."""

    coefficients: Floats
    covariance: Floats


def missing_angle(estimate: Estimate, reduced: Estimate, cause: Candidate) -> MissingTerm:
    """Estimate the error of an encoder that a model lacks without a cause, as a spline over one quantity."""
    screening, reduced_screening = Screening(estimate), Screening(reduced)
    flights = screening.filtered.linearised_flights
    contribution_rad = _contributed_angles_rad(flights, reduced_screening.filtered.linearised_flights)
    axis = int(np.argmax(contribution_rad.std(axis=0)))
    quantities_by_flight = [quantity_values(linear.model.source, linear.nodes) for linear in flights]
    # If the error depends on no quantity clearly, it is drawn over the angle of the encoder.
    name = best_quantity(quantities_by_flight, contribution_rad[:, axis], cause) or AXES[axis]
    quantity = over_all_flights(quantities_by_flight, name)
    low, step = knot_span(quantity)

    # Splines of what is missing without the cause, of what remains with it, and of what it contributes.
    candidate = _spline_on_encoder(AXES[axis], name, low, step)
    missing, missing_covariance = _spline_coefficients(reduced_screening, candidate)
    remaining, _ = _spline_coefficients(screening, candidate)
    flight_basis = bspline_basis(quantity, low, step)
    contribution, *_ = np.linalg.lstsq(flight_basis, contribution_rad[:, axis], rcond=None)

    # KNOTS cubic splines cover KNOTS - 3 intervals.
    curve_points = np.linspace(low, low + step * (KNOTS - 3), _CURVE_POINTS)
    basis = bspline_basis(curve_points, low, step)
    basis -= basis.mean(axis=0)  # a constant angle is a parameter of every model
    std_rad = np.sqrt(np.einsum("ni,ij,nj->n", basis, missing_covariance, basis))
    factor, unit = display_unit("rad")
    quantity_factor, quantity_display_unit = display_unit(quantity_unit(name))
    return MissingTerm(
        id=cause.id,
        what="angle",
        unit=unit,
        axis=AXES[axis],
        on=quantity_in_words(name),
        on_unit=quantity_display_unit,
        quantity=quantity_factor * curve_points,
        missing=factor * (basis @ missing),
        std=factor * std_rad,
        remaining=factor * (basis @ remaining),
        contribution=factor * (basis @ contribution),
    )


def _contributed_angles_rad(
    flights: Sequence[LinearisedFlight], reduced_flights: Sequence[LinearisedFlight]
) -> Floats:
    """Return the angles that an effect adds to the encoders of all flights, shape (n of all flights, 3)."""
    return np.concatenate(
        [
            _measured_angles_rad(linear) - _measured_angles_rad(reduced_linear)
            for linear, reduced_linear in zip(flights, reduced_flights, strict=True)
        ]
    )


def _measured_angles_rad(linear: LinearisedFlight) -> Floats:
    """Return the angles that the encoders of a model would measure along its trajectory, (n, 3) [rad]."""
    model = linear.model.source
    (angles,) = model_along(model, lambda x, u, p, t: [model.measurement(x, u, p, t)])(linear.nodes)
    return np.ascontiguousarray(angles[:, :, 0])


def _spline_on_encoder(axis: str, quantity: str, low: float, step: float) -> Candidate:
    """Make a spline term with wide priors on an encoder; `low` and `step` are those of `knot_span`."""
    term = spline_term(f"measurement.{axis}", quantity, low, step, _SPLINE_NUMBER)
    wide_priors = {name: Prior(0.0, _PRIOR_STD_rad) for name in term.priors}
    return spline_candidate(replace(term, priors=wide_priors))


def _spline_coefficients(screening: Screening, candidate: Candidate) -> _SplineCoefficients:
    """Estimate the coefficients of a spline term by a score test."""
    ((information, score),) = screening.spline_information([candidate])
    precision = np.diag(coefficient_std(candidate) ** -2.0)
    covariance = np.asarray(np.linalg.inv(information + precision), float)
    return _SplineCoefficients(covariance @ score, covariance)


class _DrawnQuantity(NamedTuple):
    """Quantity over which a torque is drawn, in words: values (k,) in its display unit."""

    name: str
    unit: str
    values: Floats


class _MeasurementBlocks:
    """Steps of a flight, grouped by measurements of the filter; a measurement covers several steps."""

    def __init__(self, linear: LinearisedFlight) -> None:
        first_steps = np.concatenate([block.rows for block in linear.blocks])
        self._steps = first_steps[:, None] + np.arange(linear.block)  # (measurements, steps of each)

    def mean(self, values: Floats) -> Floats:
        """Return the means, shape (measurements, ...), of values of the steps, shape (n, ...)."""
        means: Floats = values[self._steps].mean(axis=1)
        return means


def contributed_torques_Nm(estimate: Estimate, reduced: Estimate) -> list[Floats]:
    """Compute the torque that is equivalent to an effect along each flight. Returns shape (n, 3)."""
    # The torque causes the difference between the accelerations with and without the effect.
    return [
        flight_without.disturbance_for(_accelerations_rad_s2(flight) - _accelerations_rad_s2(flight_without))
        for flight, flight_without in zip(
            estimate.filtered().linearised_flights, reduced.filtered().linearised_flights, strict=True
        )
    ]


def missing_torque(
    estimate: Estimate, reduced: Estimate, cause: Candidate, torques_Nm: Sequence[Floats]
) -> MissingTerm:
    """Estimate the torque that a model lacks without a cause. Shapes: `torques_Nm` (n, 3)."""
    filtered, reduced_filtered = estimate.filtered(), reduced.filtered()
    blocks_by_flight = [_MeasurementBlocks(linear) for linear in reduced_filtered.linearised_flights]
    contribution_Nm = np.concatenate(
        [blocks.mean(torque_Nm) for blocks, torque_Nm in zip(blocks_by_flight, torques_Nm, strict=True)]
    )
    missing = _smoothed_torques(reduced_filtered, reduced.disturbances)
    remaining = _smoothed_torques(filtered, estimate.disturbances)
    axis = _most_explained_axis(np.concatenate(torques_Nm), missing.values, contribution_Nm)
    quantity = _drawn_quantity(filtered.linearised_flights, blocks_by_flight, contribution_Nm[:, axis], cause)
    if quantity is None:  # The torque depends on no quantity clearly
        quantity = _DrawnQuantity(TIME, "s", missing.t_s)
    factor, unit = display_unit("N m")
    return MissingTerm(
        id=cause.id,
        what="torque",
        unit=unit,
        axis=AXES[axis],
        on=quantity.name,
        on_unit=quantity.unit,
        quantity=quantity.values,
        missing=factor * _without_mean(missing.values[:, axis]),
        std=factor * missing.std[:, axis],
        remaining=factor * _without_mean(remaining.values[:, axis]),
        contribution=factor * _without_mean(contribution_Nm[:, axis]),
    )


def _smoothed_torques(filtered: InnovationsModel, disturbances: DisturbanceModel) -> SmoothedDisturbances:
    """Estimate the mean disturbance torques of each measurement's block, all flights one after the other."""
    # The contribution of a cause is a mean over the block, too. At the first step of a block, a fast
    # disturbance is larger: with a correlation time of 40 ms and blocks of 20 ms by 27 %.
    by_flight = smoothed_disturbances(filtered, disturbances, block_means=True)
    return SmoothedDisturbances(*(np.concatenate(arrays) for arrays in zip(*by_flight, strict=True)))


def _accelerations_rad_s2(linear: LinearisedFlight) -> Floats:
    """Return the angular accelerations of the model along its trajectory, shape (n, 3) [rad/s2]."""
    model = linear.model.source
    (rates,) = model_along(model, lambda x, u, p, t: [model.dynamics(x, u, p, t)[3:6]])(linear.trajectory)
    return np.ascontiguousarray(rates[:, :, 0])


def _most_explained_axis(torque_Nm: Floats, missing_Nm: Floats, contribution_Nm: Floats) -> int:
    """Return the index of the axis on which a cause explains the missing torque best."""
    # This is the axis with the largest ratio of the torque of the cause, `torque_Nm` (n, 3), to the torque
    # that it leaves unexplained; `missing_Nm` and `contribution_Nm` have the shape (measurements, 3).
    # Standard deviations leave out the means: the mean elevation torque of a thrust curve would hide the
    # pitch torque of its lag.
    unexplained_std_Nm = (missing_Nm - contribution_Nm).std(axis=0)
    return int(np.argmax(torque_Nm.std(axis=0) / (unexplained_std_Nm + 1e-9)))


def _drawn_quantity(
    flights: Sequence[LinearisedFlight],
    blocks_by_flight: Sequence[_MeasurementBlocks],
    contribution_Nm: Floats,
    cause: Candidate,
) -> _DrawnQuantity | None:
    """Return the quantity of which a contribution (measurements,) is nearly a function; None without one."""
    quantities_by_flight = [
        {name: blocks.mean(values) for name, values in quantities_and_thrust_changes(linear).items()}
        for blocks, linear in zip(blocks_by_flight, flights, strict=True)
    ]
    name = best_quantity(quantities_by_flight, contribution_Nm, cause)
    if name is None:
        return None
    factor, unit = display_unit(quantity_unit(name))
    return _DrawnQuantity(
        quantity_in_words(name), unit, factor * over_all_flights(quantities_by_flight, name)
    )


def _without_mean(values: Floats) -> Floats:
    """Return values less their mean."""
    centred: Floats = values - values.mean()
    return centred


def missing_term(estimate: Estimate, cause: Candidate) -> MissingTerm:
    """Compute what a model lacks without one of its causes."""
    reduced = _without_effect(estimate, cause.effect.name)
    torques_Nm = contributed_torques_Nm(estimate, reduced)
    if any(torque_Nm.any() for torque_Nm in torques_Nm):
        return missing_torque(estimate, reduced, cause, torques_Nm)
    return missing_angle(_with_fixed_effect(estimate, cause), reduced, cause)


def _without_effect(estimate: Estimate, name: str) -> Estimate:
    """Return the estimate without the effect `name`: other parameters stay, disturbances are re-estimated."""
    model = estimate.parameter_vector.model
    reduced_model = type(model)(tuple(effect for effect in model.effects if effect.name != name))
    reduced = _with_model(estimate, reduced_model, {})
    filtered = reduced.filtered()
    disturbances = estimate_disturbances(filtered, filtered.perturbed_residual(), estimate.disturbances)
    return replace(reduced, disturbances=disturbances)


def _with_fixed_effect(estimate: Estimate, cause: Candidate) -> Estimate:
    """Return the estimate with the parameters of a cause fixed."""
    # If they were free, they would explain the angle that `missing_angle` estimates as a spline.
    values = estimate.parameter_vector.by_name(estimate.theta)
    fixed = {name: values[name] for name in cause.effect.values if name in values}
    return _with_model(estimate, estimate.parameter_vector.model, fixed)


def _with_model(estimate: Estimate, model: Model, fixed: Mapping[str, float]) -> Estimate:
    """Return the estimate of another model at the same values of all parameters that it shares."""
    # `fixed` has the parameters that are not free, by name. The covariance is that of the priors.
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


_SPLINE_POINTS: Final = 200
"""Points of a drawn curve."""


@dataclass(frozen=True)
class SplineCurve:
    """A torque, a share of the thrust or an angle as a curve over one quantity."""

    channel: str  # Channel on which it acts, such as ``torque.pitch``
    on: str  # Quantity that it depends on, such as ``elevation``
    quantity: Floats
    """quantity, value, std: (n,): The quantity over its range in the fitted flights, the curve less its mean,
    and its standard error."""
    value: Floats
    std: Floats
    quantity_unit: str  # quantity_unit, value_unit: Display units: degrees, mN m, per cent
    value_unit: str

    @property
    def what(self) -> str:
        """Sentence with the range of the quantity and of the values."""
        dependence = f"{channel_in_words(self.channel)} by {quantity_in_words(self.on)}"
        return (
            f"{dependence}, covered from {self.quantity[0]:.3g} to {self.quantity[-1]:.3g} "
            f"{self.quantity_unit}: "
            f"{self.value.min():.2g} to {self.value.max():.2g} {self.value_unit}"
        )


def _spline_curve(effect: SplineTerm, estimate: Estimate) -> SplineCurve:
    """Evaluate a spline term over the range of its quantity, with the coefficients of an `estimate`."""
    low, step = effect.knots
    quantity = np.linspace(low, low + step * (KNOTS - 3), _SPLINE_POINTS)
    basis = bspline_basis(quantity, low, step)
    # A constant torque, thrust or angle is a parameter of the rig already, so the curve has no mean.
    basis -= basis.mean(axis=0)
    names = list(estimate.parameter_vector.names)
    columns = [names.index(f"{effect.name}_{i}") for i in range(KNOTS)]
    covariance = estimate.covariance[np.ix_(columns, columns)]
    variance = np.einsum("ni,ij,nj->n", basis, covariance, basis)
    unit = next(q.unit for q in effect.parameters if q.name == f"{effect.name}_0")
    factor, value_unit = display_unit(unit)
    quantity_factor, quantity_unit = display_unit(QUANTITIES[effect.on].unit)
    return SplineCurve(
        channel=effect.channel,
        on=effect.on,
        quantity=quantity_factor * quantity,
        value=factor * (basis @ estimate.theta[columns]),
        std=factor * np.sqrt(np.maximum(variance, 0.0)),
        quantity_unit=quantity_unit,
        value_unit=value_unit,
    )


def spline_curves_of(causes: Iterable[Cause], estimate: Estimate) -> list[SplineCurve]:
    """Evaluate those of the `causes` in the model of an `estimate` that are spline terms, in their order."""
    effects = (cause.candidate.effect for cause in causes)
    return [_spline_curve(effect, estimate) for effect in effects if isinstance(effect, SplineTerm)]
