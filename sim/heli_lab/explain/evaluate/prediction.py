"""Open-loop simulation (free run) of a model with known parameters over the fitted and the held-out
flights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.evaluate.free_run import windows_problem
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.problem import Fit
from heli_lab.fit.records import Record
from heli_lab.fit.shooting import solve


@dataclass(frozen=True)
class NormalisedError:
    """Root mean square free-run error, in standard deviations of the encoders' quantisation.

    It is 1 if the model is right.
    """

    total: float  # Over all axes
    axes: Floats  # (3,): By axis: elevation, pitch, travel


@dataclass(frozen=True, eq=False)
class Prediction:
    """Free runs of a model whose parameters are estimated, and their errors."""

    fit: Fit  # Parameters with their covariance, and free runs over the fitted flights
    held_out_fit: Fit | None
    """Free runs over the held-out flights, for which only encoder zeros, constant torques and initial states
    were estimated; None if no flight is held out."""
    train: NormalisedError
    """train, held_out: Errors on the fitted and on the held-out flights; the same if no flight is held out.
    """
    held_out: NormalisedError


def predict(estimate: Estimate, train: Sequence[Record], held_out: Sequence[Record]) -> Prediction:
    """Simulate flights in free runs of 2 s with the parameters of an estimate in innovations form.

    Quantities that differ from flight to flight (encoder zeros, a constant torque about each axis) are
    estimated from the free runs themselves, because innovations carry little information about constants.
    """
    fit = _free_run(estimate, train, own_calibration=True)
    held_out_fit = _free_run(estimate, held_out, own_calibration=False) if held_out else None
    train_error = normalised_error(fit)
    held_out_error = normalised_error(held_out_fit) if held_out_fit else train_error
    return Prediction(fit, held_out_fit, train_error, held_out_error)


def normalised_error(fit: Fit) -> NormalisedError:
    """Measure the errors of a fit over every sample of its flights."""
    samples = normalised_samples(fit)
    return NormalisedError(float(np.sqrt(np.mean(samples**2))), np.sqrt(np.mean(samples**2, axis=0)))


def normalised_samples(fit: Fit) -> Floats:
    """Return the open-loop errors of a fit at every sample of its flights, shape (n, 3).

    The unit is the standard deviation of each encoder's quantisation.
    """
    return np.concatenate(
        [fit.problem.residual(index, fit.theta, states, fine=True) for index, states in enumerate(fit.states)]
    )


def _free_run(estimate: Estimate, records: Sequence[Record], own_calibration: bool) -> Fit:
    """Simulate `records` in free runs with the parameters of an estimate.

    Only zeros, constant torques and initial states are fitted. `own_calibration` states whether the records
    are those of the estimate; the result then has the parameters and the covariance of the estimate.
    """
    parameter_vector = estimate.parameter_vector
    flight_priors = {
        parameter.quantity: parameter.prior
        for parameter in parameter_vector.free
        if parameter.record is not None
    }
    values = parameter_vector.shared_by_name(estimate.theta)
    problem = windows_problem(
        parameter_vector.model, parameter_vector.rig, values, records, flight_priors, None
    )
    fit = solve(problem, robust=False, scatter=False, warm_start=True)
    return _with_estimate(fit, estimate) if own_calibration else fit


def _with_estimate(fit: Fit, estimate: Estimate) -> Fit:
    """Put parameters and covariance of an `estimate` into a `fit` of the same flights.

    The fit keeps its own zeros and constant torques.
    """
    vector = estimate.parameter_vector
    calibrated = {
        (parameter.quantity, parameter.record): value
        for parameter, value in zip(fit.problem.free, fit.theta, strict=True)
    }
    low, high = vector.bounds
    return replace(
        fit,
        problem=fit.problem.with_free(vector.free),
        theta=np.array(
            [
                value if parameter.record is None else calibrated[parameter.quantity, parameter.record]
                for parameter, value in zip(vector.free, estimate.theta, strict=True)
            ]
        ),
        covariance=estimate.covariance,
        information=np.asarray(np.linalg.inv(estimate.covariance) - np.diag(vector.std**-2.0), float),
        at_bound=tuple(np.array(vector.names)[(estimate.theta <= low) | (estimate.theta >= high)].tolist()),
    )
