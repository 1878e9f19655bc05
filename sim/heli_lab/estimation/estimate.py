"""Maximum a posteriori estimate in innovations form: parameters of a model together with its disturbances.

The Kalman filter of a model linearised along a flight (`linearised_flight.py`), with random disturbances
(`disturbances.py`), turns measured outputs into innovations, which are white where the model is right, also
in closed loop. The filter is linear in its signals: derivatives by the parameters are filtered together with
the measurement, and a Gauss-Newton step follows by weighted least squares with the priors. The disturbances
maximise the same likelihood. After Kristensen, Madsen and Jorgensen, Automatica 40 (2004) 225, and Ljung,
System Identification, chapter 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final, Generic

import numpy as np
from heli_host.arrays import Floats
from typing_extensions import TypeVar

from heli_lab.estimation.disturbance_search import maximise
from heli_lab.estimation.disturbances import DisturbanceModel
from heli_lab.estimation.innovations_model import InnovationsModel
from heli_lab.estimation.linearised_flight import LinearisedFlight, ModelFunctions
from heli_lab.estimation.parameter_vector import ParameterVector
from heli_lab.estimation.posterior_step import PosteriorStep, posterior_step
from heli_lab.estimation.reference_trajectory import ReferenceTrajectory

_MAX_MOVES: Final = 15
_HALVINGS: Final = 4
_MIN_GAIN: Final = 0.02
"""Share of the promised gain that a step must bring, of Armijo's rule (Nocedal and Wright, section 3.1)."""
_FIRST_TURNS: Final = 2
_TURN_NATS: Final = 0.1
"""Gain of one more turn of parameters and disturbances below which the estimate has converged."""
_DISTURBANCE_SHARE: Final = 0.05
"""Disturbances are sought to this share of the gain that the next step of the parameters promises."""
_CONVERGED_NATS: Final = 0.02
"""Gain that one more step of the parameters may promise when the estimate has converged."""

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
        Their covariance, the inverse of the Fisher information with the priors'.
    log_likelihood : float
        In nats, with the priors, up to a constant that all models of the same references share.
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

    def filtered(self) -> InnovationsModel:
        """Linearise the model at `theta`; not kept, because it takes megabytes per minute of flight."""
        return _linearised(self.parameter_vector, self.references, self.functions, self.theta)

    def other_disturbances(self) -> DisturbanceModel | None:
        """Estimate the disturbances again from the model's start values with the parameters fixed; None
        where the result is not more likely.
        """
        filtered = self.filtered()
        error = filtered.perturbed_residual()
        other = estimate_disturbances(filtered, error, filtered.model.disturbance_start)
        now, then = filtered.log_likelihoods([self.disturbances, other], error).sum(axis=1)
        return other if then > now + _TURN_NATS else None


def estimate_disturbances(
    filtered: InnovationsModel,
    error: Sequence[Sequence[tuple[Floats, Floats]]],
    start: DisturbanceModel,
    enough_nats: float = _CONVERGED_NATS,
    known: Floats | None = None,
) -> DisturbanceModel:
    """Maximise the likelihood of the innovations of an `error`, as `InnovationsModel.perturbed_residual`
    gives it, over the disturbances, from `start` on to `enough_nats`. The log-likelihoods of `start` by
    output, shape (m,), may be `known`.
    """
    return maximise(
        lambda disturbance_models: filtered.log_likelihoods(disturbance_models, error),
        start,
        filtered.model.disturbance_std_range,
        enough_nats,
        known,
    )


def _linearised(
    parameter_vector: ParameterVector,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
) -> InnovationsModel:
    linearised_flights = [
        LinearisedFlight(reference, functions, parameter_vector.parameters(theta, index))
        for index, reference in enumerate(references)
    ]
    return InnovationsModel(linearised_flights, parameter_vector.columns, len(theta))


@dataclass
class _Iterate:
    """Parameters and disturbances, and the model linearised there, unless it was released: ten minutes of
    flight take 100 MB.
    """

    theta: Floats
    disturbances: DisturbanceModel
    filtered: InnovationsModel | None
    step: PosteriorStep
    value: float
    """Log-posterior, nats."""
    by_output: Floats
    """Log-likelihood of each output's innovations, nats."""


class _GaussNewton:
    """Gauss-Newton steps of the parameters in turn with Newton steps of the disturbances. No step reduces the
    posterior density.
    """

    def __init__(
        self,
        parameter_vector: ParameterVector,
        references: Sequence[ReferenceTrajectory],
        functions: ModelFunctions,
    ) -> None:
        self.parameter_vector, self.references, self.functions = parameter_vector, references, functions
        # The size of a play changes the variance of measurements too, which a step leaves out: it may fail
        # under the disturbances of a model without the play, and succeed under better ones.
        self.retries = bool(functions.model.known_directions)

    def linearised(self, theta: Floats) -> InnovationsModel:
        return _linearised(self.parameter_vector, self.references, self.functions, theta)

    def at(self, theta: Floats, disturbances: DisturbanceModel, filtered: InnovationsModel) -> _Iterate:
        innovations = filtered.innovations(disturbances)
        information, score = innovations.information(), innovations.score()
        vector, per_flight = self.parameter_vector, innovations.per_flight
        step = posterior_step(vector, theta, information, score, per_flight=per_flight)
        by_output = innovations.log_likelihoods
        value = float(by_output.sum()) - 0.5 * float(np.sum(((theta - vector.mean) / vector.std) ** 2))
        return _Iterate(theta, disturbances, filtered, step, value, by_output)

    def first(self, theta: Floats, disturbances: DisturbanceModel | None) -> _Iterate:
        """Begin; without disturbances these are estimated first, the parameters following to first order."""
        filtered = self.linearised(theta)
        iterate = self.at(theta, disturbances or self.functions.model.disturbance_start, filtered)
        if disturbances is None:
            for _ in range(_FIRST_TURNS):
                better = estimate_disturbances(
                    filtered, filtered.perturbed_residual(iterate.step.move), iterate.disturbances
                )
                iterate = self.at(theta, better, filtered)
        return iterate

    def with_next_parameters(self, iterate: _Iterate) -> _Iterate | None:
        """Step with backtracking; None if no shorter step improves the posterior enough. The linearised model
        of `iterate` is released first, because two are hardly ever needed at the same time.
        """
        iterate.filtered = None
        share = 1.0
        for _ in range(_HALVINGS):
            theta = iterate.theta + share * iterate.step.move
            after = self.at(theta, iterate.disturbances, self.linearised(theta))
            if after.value > iterate.value + _MIN_GAIN * share * iterate.step.promised_nats:
                return after
            after.filtered = None
            share *= 0.3
        return None

    def with_next_disturbances(self, iterate: _Iterate, enough_nats: float) -> _Iterate:
        """Maximise the likelihood over the disturbances, to `enough_nats`."""
        filtered = iterate.filtered or self.linearised(iterate.theta)
        error = filtered.perturbed_residual()
        disturbances = estimate_disturbances(
            filtered, error, iterate.disturbances, enough_nats, iterate.by_output
        )
        return self.at(iterate.theta, disturbances, filtered)

    def run(self, iterate: _Iterate) -> tuple[_Iterate, bool]:
        last = -np.inf
        for _ in range(_MAX_MOVES):
            if iterate.step.promised_nats > _CONVERGED_NATS:
                after = self.with_next_parameters(iterate)
                if after is None:
                    other = self.with_next_disturbances(iterate, _CONVERGED_NATS)
                    if not self.retries or other.value < iterate.value + _TURN_NATS:
                        return other, False
                    iterate = other
                    continue
                iterate = after
            # While parameters still move far the disturbances follow roughly; then to convergence.
            enough_nats = max(_CONVERGED_NATS, _DISTURBANCE_SHARE * iterate.step.promised_nats)
            iterate = self.with_next_disturbances(iterate, enough_nats)
            if iterate.step.promised_nats < _CONVERGED_NATS and iterate.value - last < _TURN_NATS:
                return iterate, True
            last = iterate.value
        return iterate, False


def estimate(
    parameter_vector: VectorT,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
    disturbances: DisturbanceModel | None = None,
) -> Estimate[VectorT]:
    """Estimate parameters and disturbances.

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
        Disturbances to start from; the estimate is never less likely than they and `theta`.

    Returns
    -------
    Estimate
    """
    search = _GaussNewton(parameter_vector, references, functions)
    last, converged = search.run(search.first(theta, disturbances))
    return Estimate(
        parameter_vector,
        last.theta,
        last.step.covariance,
        last.value,
        last.disturbances,
        converged,
        tuple(references),
        functions,
    )
