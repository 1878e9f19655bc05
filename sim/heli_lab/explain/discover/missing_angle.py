"""The encoder error that a model lacks without a cause, estimated as a spline over one quantity."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES
from heli_sim.rig import Prior

from heli_lab.explain.discover.curve_quantities import best_quantity, over_all_flights, quantity_unit
from heli_lab.explain.discover.missing import MissingTerm
from heli_lab.explain.search.candidate import Candidate
from heli_lab.explain.search.regressors import spline_candidate
from heli_lab.explain.search.screening import Screening, coefficient_std
from heli_lab.explain.search.splines import KNOTS, bspline_basis, knot_span, quantity_values, spline_term
from heli_lab.explain.wording import display_unit, quantity_in_words
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.flight_model import model_along
from heli_lab.fit.linearised_flight import LinearisedFlight

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
    name = best_quantity(quantities_by_flight, contribution_rad[:, axis], cause) or AXES[axis]
    quantity = over_all_flights(quantities_by_flight, name)
    low, step = knot_span(quantity)

    candidate = _spline_on_encoder(AXES[axis], name, low, step)
    missing, missing_covariance = _spline_coefficients(reduced_screening, candidate)
    remaining, _ = _spline_coefficients(screening, candidate)
    flight_basis = bspline_basis(quantity, low, step)
    contribution = np.linalg.lstsq(flight_basis, contribution_rad[:, axis], rcond=None)[0]

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
