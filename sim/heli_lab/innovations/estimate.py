"""Maximum likelihood in innovations form: parameters of a model and the weather, estimated together.

The Kalman filter of a model linearised along a flight (`linearised_flight.py`) with random disturbances
(`disturbances.py`) turns measured angles into
innovations, which are white where the model is right, also in closed loop. It is linear in what drives it:
derivatives by the parameters are filtered beside the measurement, and the parameters follow by weighted least
squares with the rig's priors. The weather's numbers maximise the same likelihood. After Kristensen, Madsen
and Jorgensen, Automatica 40 (2004) 225, and Ljung, System Identification, chapter 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.estimation.arrowhead import invert_arrowhead
from heli_lab.estimation.bounded_solve import bounded_solve
from heli_lab.innovations.disturbances import DisturbanceModel, maximise
from heli_lab.innovations.innovations_model import Innovations, InnovationsModel
from heli_lab.innovations.linearised_flight import LinearisedFlight, ModelFunctions
from heli_lab.innovations.parameter_vector import ParameterVector
from heli_lab.innovations.reference_trajectory import ReferenceTrajectory

_MAX_MOVES: Final = 15
_HALVINGS: Final = 4
_LEAST_GAIN: Final = 0.02
"""Share of the gain that derivatives promise that a move must bring."""
_FIRST_TURNS: Final = 2
_TURN_NATS: Final = 0.1
"""Gain of one more turn of parameters and weather below which the estimate counts as converged."""
_WEATHER_SHARE: Final = 0.05
"""Share of what the parameters' next move promises to which the weather is sought before it."""
_CONVERGED_NATS: Final = 0.02
"""Gain that one more move of the parameters may promise before the estimate counts as converged."""


@dataclass(frozen=True)
class Estimate:
    """Parameters and weather of largest posterior likelihood.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    covariance : ndarray (f, f)
        Their covariance.
    log_likelihood : float
        In nats, up to a constant that all models of the same courses share; priors included.
    converged : bool
        Whether the last move promised next to nothing.
    references : tuple of ReferenceTrajectory
        The flights.
    functions : ModelFunctions
        The model's equations.
    """

    parameter_vector: ParameterVector
    theta: Floats
    covariance: Floats
    log_likelihood: float
    disturbances: DisturbanceModel
    converged: bool
    references: tuple[ReferenceTrajectory, ...]
    functions: ModelFunctions

    def filtered(self) -> InnovationsModel:
        """Linearise the model at `theta`; not kept, because of every flight it takes megabytes a minute."""
        return _linearised(self.parameter_vector, self.references, self.functions, self.theta)

    def other_disturbances(self) -> DisturbanceModel | None:
        """Look for the weather afresh with the parameters as they are; None where it is none that is likelier
        than what was found.
        """
        filtered = self.filtered()
        error = filtered.perturbed_residual(np.zeros(len(self.theta)))
        other = estimate_disturbances(filtered, error, DisturbanceModel.start())
        now, then = filtered.log_likelihoods([self.disturbances, other], error).sum(axis=1)
        return other if then > now + _TURN_NATS else None


def solve(
    parameter_vector: ParameterVector, theta: Floats, innovations: Innovations
) -> tuple[Floats, Floats, float]:
    """Solve for the move of the parameters that maximises the posterior.

    Parameters
    ----------
    parameter_vector : ParameterVector
        Priors and bounds.
    theta : ndarray (f,)
        Parameters at which the model is linearised.

    Returns
    -------
    move : ndarray (f,)
        Within the bounds.
    covariance : ndarray (f, f)
        Of the parameters.
    value : float
        Logarithm of the posterior at `theta`, nats.
    """
    precision, per_flight = parameter_vector.std**-2.0, innovations.own
    offset = theta - parameter_vector.mean
    information = innovations.information() + np.diag(precision)
    gradient = innovations.score() - precision * offset
    value = innovations.log_likelihoods.sum() - 0.5 * (offset @ (precision * offset))
    low, high = parameter_vector.bounds
    move = bounded_solve(information, gradient, low - theta, high - theta, per_flight)
    covariance = invert_arrowhead(information, per_flight)
    return move, covariance, float(value)


def estimate_disturbances(
    filtered: InnovationsModel,
    error: Sequence[Sequence[tuple[Floats, Floats]]],
    start: DisturbanceModel,
    enough_nats: float = _CONVERGED_NATS,
    known: Floats | None = None,
) -> DisturbanceModel:
    """Maximise the likelihood of the innovations of an `error`, as `InnovationsModel.perturbed_residual`
    gives it, over the disturbances, from `start` on to `enough_nats`. The log-likelihoods of `start` by axis,
    shape (3,), may be `known`.
    """
    return maximise(
        lambda disturbance_models: filtered.log_likelihoods(disturbance_models, error),
        start,
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
class _Point:
    """Parameters and weather, and the model linearised there, unless it was let go: of ten minutes it takes
    100 MB.
    """

    theta: Floats
    disturbances: DisturbanceModel
    filtered: InnovationsModel | None
    move: Floats
    covariance: Floats
    value: float
    promised: float
    by_axis: Floats
    """Log-likelihood of each axis' innovations, nats."""


class _Ascent:
    """Parameters by Gauss-Newton steps and weather by Newton steps in turn, neither ever downhill."""

    def __init__(
        self,
        parameter_vector: ParameterVector,
        references: Sequence[ReferenceTrajectory],
        functions: ModelFunctions,
    ) -> None:
        self.parameter_vector, self.references, self.functions = parameter_vector, references, functions

    def linearised(self, theta: Floats) -> InnovationsModel:
        return _linearised(self.parameter_vector, self.references, self.functions, theta)

    def at(self, theta: Floats, disturbances: DisturbanceModel, filtered: InnovationsModel) -> _Point:
        innovations = filtered.innovations_by_flight(disturbances)
        move, covariance, value = solve(self.parameter_vector, theta, innovations)
        squares = sum(float(residual @ residual) for residual in innovations.left(move))
        offset = theta + move - self.parameter_vector.mean
        prior = offset @ (self.parameter_vector.std**-2.0 * offset)
        after = -0.5 * (squares + prior + innovations.log_variances.sum())
        promised = float(after) - value
        return _Point(
            theta, disturbances, filtered, move, covariance, value, promised, innovations.log_likelihoods
        )

    def begun(self, theta: Floats, disturbances: DisturbanceModel | None) -> _Point:
        """Where to begin; without weather it is estimated at once, parameters following to first order."""
        filtered = self.linearised(theta)
        point = self.at(theta, disturbances or DisturbanceModel.start(), filtered)
        if disturbances is None:
            for _ in range(_FIRST_TURNS):
                weather_ = estimate_disturbances(
                    filtered, filtered.perturbed_residual(point.move), point.disturbances
                )
                point = self.at(theta, weather_, filtered)
        return point

    def perturbed_residual(self, point: _Point) -> _Point | None:
        """Move the parameters, half as far where that leads down; None where nothing leads up. The point lets
        go of the model linearised there: two at once are hardly ever needed.
        """
        point.filtered = None
        share = 1.0
        for _ in range(_HALVINGS):
            theta = point.theta + share * point.move
            after = self.at(theta, point.disturbances, self.linearised(theta))
            if after.value > point.value + _LEAST_GAIN * share * point.promised:
                return after
            after.filtered = None
            share *= 0.3
        return None

    def weathered(self, point: _Point, enough_nats: float) -> _Point:
        """The weather as likely as it can be, to `enough_nats`."""
        filtered = point.filtered or self.linearised(point.theta)
        error = filtered.perturbed_residual(np.zeros(len(point.theta)))
        disturbances = estimate_disturbances(filtered, error, point.disturbances, enough_nats, point.by_axis)
        return self.at(point.theta, disturbances, filtered)

    def run(self, point: _Point) -> tuple[_Point, bool]:
        last = -np.inf
        for _ in range(_MAX_MOVES):
            if point.promised > _CONVERGED_NATS:
                after = self.perturbed_residual(point)
                if after is None:
                    return self.weathered(point, _CONVERGED_NATS), False
                point = after
            # While parameters still move far the weather follows roughly; then to the end.
            point = self.weathered(point, max(_CONVERGED_NATS, _WEATHER_SHARE * point.promised))
            if point.promised < _CONVERGED_NATS and point.value - last < _TURN_NATS:
                return point, True
            last = point.value
        return point, False


def estimate(
    parameter_vector: ParameterVector,
    references: Sequence[ReferenceTrajectory],
    functions: ModelFunctions,
    theta: Floats,
    disturbances: DisturbanceModel | None = None,
) -> Estimate:
    """Estimate parameters and weather.

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
        Weather to start from; what comes out is never less likely than this and `theta`.
    """
    ascent = _Ascent(parameter_vector, references, functions)
    point, converged = ascent.run(ascent.begun(theta, disturbances))
    return Estimate(
        parameter_vector,
        point.theta,
        point.covariance,
        point.value,
        point.disturbances,
        converged,
        tuple(references),
        functions,
    )
