"""Estimate the parameters of a model together with its disturbances: maximum a posteriori in innovations
form.

The model is linearised along a flight (`linearised_flight.py`) and disturbed at random (`disturbances.py`).
Its Kalman filter turns the measured outputs into innovations. If the model is right, the innovations are
white, even in closed loop. The filter is linear in its signals: derivatives by the parameters are filtered
together with the measurement. A Gauss-Newton step then follows by weighted least squares with the priors. The
disturbances maximise the same likelihood. After Kristensen, Madsen and Jorgensen, Automatica 40 (2004) 225,
and Ljung, System Identification, chapter 7.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic

import numpy as np
from heli_host.data.arrays import Floats
from typing_extensions import TypeVar

from heli_lab.fit.estimation.disturbance_search import maximise
from heli_lab.fit.estimation.disturbances import DisturbanceModel
from heli_lab.fit.estimation.innovations_model import FlightErrors, InnovationsModel
from heli_lab.fit.estimation.linearised_flight import LinearisedFlight
from heli_lab.fit.estimation.model_functions import ModelFunctions
from heli_lab.fit.estimation.parameter_vector import ParameterVector
from heli_lab.fit.estimation.posterior_step import PosteriorStep, posterior_step
from heli_lab.fit.estimation.reference_trajectory import ReferenceTrajectory

_MAX_ITERATIONS: Final = 15
"""Largest number of steps of the parameters."""
_MAX_TRIALS: Final = 4
"""Largest number of lengths of a step that are tried."""
_STEP_REDUCTION: Final = 0.3
"""Factor from one of these lengths to the next."""
_MIN_GAIN: Final = 0.02
"""Share of its predicted gain that a step must gain, by Armijo's rule (Nocedal and Wright, section 3.1)."""
_FIRST_ITERATIONS: Final = 2
"""Number of estimates of the disturbances before the first step of the parameters."""
_MIN_ITERATION_GAIN_NATS: Final = 0.1
"""If parameters and disturbances together gain less in an iteration, the estimate has converged."""
_DISTURBANCE_SHARE: Final = 0.05
"""The disturbances are estimated up to this share of the gain that the next step of the parameters
promises."""
_CONVERGED_NATS: Final = 0.02
"""If the next step of the parameters promises less, the estimate has converged."""

VectorT = TypeVar("VectorT", bound=ParameterVector, default=Any)


@dataclass(frozen=True)
class Estimate(Generic[VectorT]):
    """Parameters and disturbances of largest posterior density.

    Parameters
    ----------
    parameter_vector : ParameterVector
        The free parameters with their priors.
    theta : ndarray (f,)
        Estimates of the free parameters.
    covariance : ndarray (f, f)
        Covariance of the estimates: the inverse of the Fisher information, priors included.
    log_likelihood : float
        Log-likelihood plus log-prior [nats], up to a constant that all models of the same references share.
    disturbances : DisturbanceModel
        Disturbances and quantisation.
    converged : bool
        Whether the iteration ended because a further step would not improve the posterior noticeably.
    references : tuple of ReferenceTrajectory
        The flights.
    functions : ModelFunctions
        The model's equations.
    """

    parameter_vector: VectorT
    theta: Floats
    covariance: Floats
    log_likelihood: float
    disturbances: DisturbanceModel
    converged: bool
    references: tuple[ReferenceTrajectory, ...]
    functions: ModelFunctions

    @property
    def prior_deviations(self) -> Floats:
        """Distances of the parameters from the means of their priors, in standard deviations, shape (f,)."""
        vector = self.parameter_vector
        deviations: Floats = (self.theta - vector.mean) / vector.std
        return deviations

    def filtered(self) -> InnovationsModel:
        """Linearise the model at `theta`. The result is not stored, because it takes megabytes per minute of
        flight.
        """
        return _linearised(self.parameter_vector, self.references, self.functions, self.theta)

    def other_disturbances(self) -> DisturbanceModel | None:
        """Estimate the disturbances again from the model's start values, with the parameters fixed.

        Returns
        -------
        DisturbanceModel or None
            None if the likelihood has no second, higher maximum.
        """
        filtered = self.filtered()
        errors = filtered.perturbed_residual()
        other = estimate_disturbances(filtered, errors, filtered.model.disturbance_start)
        present_nats, other_nats = filtered.log_likelihoods([self.disturbances, other], errors).sum(axis=1)
        return other if other_nats > present_nats + _MIN_ITERATION_GAIN_NATS else None


def estimate_disturbances(
    filtered: InnovationsModel,
    errors: FlightErrors,
    start: DisturbanceModel,
    tolerance_nats: float = _CONVERGED_NATS,
    start_values: Floats | None = None,
) -> DisturbanceModel:
    """Estimate the disturbances by maximum likelihood, with the parameters fixed.

    Parameters
    ----------
    filtered : InnovationsModel
        The model along the flights.
    errors : sequence of sequence of ModelErrors
        Errors of the model, from `InnovationsModel.perturbed_residual`.
    start, tolerance_nats, start_values
        As in `disturbance_search.maximise`.
    """
    return maximise(
        lambda disturbance_models: filtered.log_likelihoods(disturbance_models, errors),
        start,
        filtered.model.disturbance_std_range,
        tolerance_nats,
        start_values,
    )


def _linearised(
    parameter_vector: ParameterVector,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
) -> InnovationsModel:
    """Linearise a model with free parameters `theta`, shape (f,), along each flight."""
    linearised_flights = [
        LinearisedFlight(reference, functions, parameter_vector.parameters(theta, index))
        for index, reference in enumerate(references)
    ]
    return InnovationsModel(linearised_flights, parameter_vector.columns, len(theta))


@dataclass
class _Iterate:
    """One point of the search."""

    theta: Floats  # (f,): Free parameters
    disturbances: DisturbanceModel  # Disturbances and quantisation
    filtered: InnovationsModel | None
    """The model linearised at `theta`. None after its memory is released: ten minutes of flight take 100 MB.
    """
    step: PosteriorStep  # Gauss-Newton step from this point
    log_posterior: float  # Logarithm of the posterior density [nats], without its constant
    log_likelihoods: Floats  # (m,): Log-likelihood of each output's innovations [nats]


class _GaussNewton:
    """Search for the largest posterior density: Gauss-Newton steps of the parameters alternate with Newton
    steps of the disturbances, and no step reduces the density.
    """

    def __init__(
        self,
        parameter_vector: ParameterVector,
        references: Sequence[ReferenceTrajectory],
        functions: ModelFunctions,
    ) -> None:
        self.parameter_vector, self.functions = parameter_vector, functions
        self.linearised = functools.partial(_linearised, parameter_vector, references, functions)
        """The model along all flights as a function of the free parameters, shape (f,)."""
        self.retries_failed_steps = bool(functions.model.known_directions)
        """Whether a failed step is repeated under new disturbances. This helps if the model has a play, whose
        size also changes the variance of measurements. A Gauss-Newton step neglects this, and may fail under
        disturbances that were estimated without the play."""

    def iterate_at(
        self, theta: Floats, disturbances: DisturbanceModel, filtered: InnovationsModel
    ) -> _Iterate:
        """Compute the log-posterior and the Gauss-Newton step at one point of the search. Shapes: `theta`
        (f,).
        """
        innovations = filtered.innovations(disturbances)
        information, score = innovations.information(), innovations.score()
        vector, per_flight = self.parameter_vector, innovations.per_flight
        step = posterior_step(vector, theta, information, score, per_flight=per_flight)
        log_likelihoods = innovations.log_likelihoods
        log_prior = -0.5 * float(np.sum(((theta - vector.mean) / vector.std) ** 2))
        log_posterior = float(log_likelihoods.sum()) + log_prior
        if not np.isfinite(log_posterior):
            # A model that diverges loses each comparison.
            log_posterior = -np.inf
        return _Iterate(theta, disturbances, filtered, step, log_posterior, log_likelihoods)

    def first(self, theta: Floats, disturbances: DisturbanceModel | None) -> _Iterate:
        """Compute the first iterate, at the start values `theta`, shape (f,).

        If no `disturbances` are given, they are estimated for the parameters that the first step predicts.
        """
        filtered = self.linearised(theta)
        iterate = self.iterate_at(theta, disturbances or self.functions.model.disturbance_start, filtered)
        if disturbances is None:
            for _ in range(_FIRST_ITERATIONS):
                errors = filtered.perturbed_residual(iterate.step.move)
                better = estimate_disturbances(filtered, errors, iterate.disturbances)
                iterate = self.iterate_at(theta, better, filtered)
        return iterate

    def with_next_parameters(self, iterate: _Iterate) -> _Iterate | None:
        """Take a step of the parameters with backtracking.

        The linearised model of `iterate` is released first, because two need too much memory.
        """
        iterate.filtered = None
        share = 1.0
        for _ in range(_MAX_TRIALS):
            theta = iterate.theta + share * iterate.step.move
            after = self.iterate_at(theta, iterate.disturbances, self.linearised(theta))
            required_nats = _MIN_GAIN * share * iterate.step.promised_nats
            if after.log_posterior > iterate.log_posterior + required_nats:
                return after
            after.filtered = None
            share *= _STEP_REDUCTION
        return None

    def with_next_disturbances(self, iterate: _Iterate, tolerance_nats: float) -> _Iterate:
        """Maximise the likelihood over the disturbances, to within `tolerance_nats`."""
        filtered = iterate.filtered or self.linearised(iterate.theta)
        disturbances = estimate_disturbances(
            filtered,
            filtered.perturbed_residual(),
            iterate.disturbances,
            tolerance_nats,
            iterate.log_likelihoods,
        )
        return self.iterate_at(iterate.theta, disturbances, filtered)

    def run(self, iterate: _Iterate) -> tuple[_Iterate, bool]:
        """Search from an `iterate`; return the last iterate, and whether the search has converged."""
        last_log_posterior = -np.inf
        for _ in range(_MAX_ITERATIONS):
            if iterate.log_posterior == -np.inf:
                return iterate, False
            if iterate.step.promised_nats > _CONVERGED_NATS:
                after = self.with_next_parameters(iterate)
                if after is None:
                    # A step may fail under wrong disturbances, and succeed under better ones.
                    with_better_disturbances = self.with_next_disturbances(iterate, _CONVERGED_NATS)
                    gained_nats = with_better_disturbances.log_posterior - iterate.log_posterior
                    if not self.retries_failed_steps or gained_nats < _MIN_ITERATION_GAIN_NATS:
                        return with_better_disturbances, False
                    iterate = with_better_disturbances
                    continue
                iterate = after
            # As long as the parameters change much, rough disturbances are enough.
            tolerance_nats = max(_CONVERGED_NATS, _DISTURBANCE_SHARE * iterate.step.promised_nats)
            iterate = self.with_next_disturbances(iterate, tolerance_nats)
            gained_nats = iterate.log_posterior - last_log_posterior
            if iterate.step.promised_nats < _CONVERGED_NATS and gained_nats < _MIN_ITERATION_GAIN_NATS:
                return iterate, True
            last_log_posterior = iterate.log_posterior
        return iterate, False


def estimate(
    parameter_vector: VectorT,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
    disturbances: DisturbanceModel | None = None,
) -> Estimate[VectorT]:
    """Estimate a model's free parameters together with its disturbances, maximum a posteriori.

    Parameters
    ----------
    parameter_vector : ParameterVector
        Free parameters of the model in these flights.
    references : sequence of ReferenceTrajectory
        The flights.
    functions : ModelFunctions
        The model's equations, with derivatives by `parameter_vector.quantities`.
    theta : ndarray (f,)
        Parameters to start from.
    disturbances : DisturbanceModel, optional
        Disturbances to start from. The estimate is at least as likely as this start.
    """
    search = _GaussNewton(parameter_vector, references, functions)
    last, converged = search.run(search.first(theta, disturbances))
    return Estimate(
        parameter_vector=parameter_vector,
        theta=last.theta,
        covariance=last.step.covariance,
        log_likelihood=last.log_posterior,
        disturbances=last.disturbances,
        converged=converged,
        references=tuple(references),
        functions=functions,
    )
