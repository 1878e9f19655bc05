"""Estimate the parameters of a model together with its disturbances: maximum a posteriori in innovations
form.

The model is linearised along a flight (`LinearisedFlight`) and disturbed at random (`DisturbanceModel`).
Its Kalman filter turns the measured outputs into innovations. If the model is right, the innovations are
white, even in closed loop. The filter is linear in its signals: derivatives by the parameters are filtered
together with the measurement. A Gauss-Newton step then follows by weighted least squares with the priors. The
disturbances maximise the same likelihood. After Kristensen, Madsen and Jorgensen, Automatica 40 (2004) 225,
and Ljung, System Identification, chapter 7.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, Generic

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from typing_extensions import TypeVar

from heli_lab.fit.grey_box import DisturbanceModel, SLOW_CORRELATION_TIME_s
from heli_lab.fit.innovations import FlightErrors, InnovationsModel
from heli_lab.fit.linearised_flight import LinearisedFlight
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.normal_equations import PosteriorStep, posterior_step
from heli_lab.fit.parameters import ParameterVector
from heli_lab.fit.reference_trajectory import ReferenceTrajectory

# Bounds of the search: far outside of what flights show.
_CORRELATION_TIME_RANGE_s: Final = (0.03, 5.0)
_QUANTISATION_RANGE: Final = (0.02, 4.0)
_GAIN_STD_RANGE: Final = (1e-4, 0.3)
_GAIN_CORRELATION_TIME_RANGE_s: Final = (0.03, SLOW_CORRELATION_TIME_s)

_DIFFERENCE: Final = 0.03
"""Change of a logarithm in numerical derivatives: 3 % of each parameter."""
_LONGEST_MOVE: Final = 1.2
"""Largest change of a logarithm in one step."""
_LONG_MOVE: Final = 0.5
"""Change of a logarithm after which the curvature is computed again."""
_ARMIJO_SHARE: Final = 0.1
"""Share of the predicted gain that a step must reach (Armijo's rule)."""
_MIN_CURVATURE: Final = 0.5
"""Smallest curvature that a step uses, in nats for a change by the factor e. A parameter with less is hardly
determined, and a Newton step of it would be far too long."""
_SHARES: Final = (1.0, 0.4, 0.16, 0.06)
"""Shares of a step that are evaluated together; the longest one that gains enough is taken."""
_MAX_STEPS: Final = 25
_DISTURBANCES_CONVERGED_NATS: Final = 0.02
"""A step that gains less ends the search: such a gain changes no decision, because the closest decisions
differ by tenths of a nat."""


@dataclass(frozen=True)
class _IndependentDisturbances:
    """Disturbances that affect innovations of different outputs, so that they are differentiated together."""

    parameters: Integers
    """(k, n): Indices of the n parameters of each disturbance in the vector of all logarithms."""
    affected: Booleans  # (k, m): Outputs whose innovations each disturbance affects

    def likelihoods(self, values: Floats) -> Floats:
        """Add up the log-likelihoods of the outputs that each disturbance affects, shape (k,), from those of
        all outputs, `values`, shape (m,).
        """
        by_disturbance = np.broadcast_to(values, self.affected.shape)
        return np.asarray(by_disturbance.sum(axis=1, where=self.affected))


class _Likelihood:
    """Log-likelihood of the innovations as a function of the logarithms of the disturbances' parameters."""

    # Derivatives are numerical. The disturbance of one output hardly affects the innovations of another one,
    # so that the disturbances of all outputs are differentiated together: their four parameters cost four
    # evaluations. A disturbance of a gain affects all innovations, and its two parameters cost two
    # evaluations.

    def __init__(
        self,
        value: Callable[[Sequence[DisturbanceModel]], Floats],
        start: DisturbanceModel,
        std_range: tuple[float, float],
    ) -> None:
        self._value, self._start = value, start
        outputs, gains = len(start.fast_std), len(start.gains)
        output_ranges = (std_range, _CORRELATION_TIME_RANGE_s, std_range, _QUANTISATION_RANGE)
        gain_ranges = (_GAIN_STD_RANGE, _GAIN_CORRELATION_TIME_RANGE_s)
        self.low, self.high = np.log([*output_ranges * outputs, *gain_ranges * gains]).T
        by_output, by_gain = np.split(np.arange(len(self.low)), [4 * outputs])
        self.groups = [
            _IndependentDisturbances(by_output.reshape(-1, 4), np.eye(outputs, dtype=bool)),
            *(
                _IndependentDisturbances(pair[None], np.ones((1, outputs), bool))
                for pair in by_gain.reshape(-1, 2)
            ),
        ]

    def at(self, *points: Floats) -> Floats:
        """Evaluate the log-likelihood of each output's innovations at w points, shape (w, m)."""
        return self._value([self._start.with_logarithms(self.inside(point)) for point in points])

    def inside(self, point: Floats) -> Floats:
        """Return the nearest point within the bounds, shape (f,)."""
        return np.clip(point, self.low, self.high)

    def gradient(self, point: Floats, values: Floats) -> Floats:
        """Differentiate the log-likelihood by the logarithms. Shapes: `point` (f,), `values` (m,); returns
        (f,).
        """
        # Near the upper bound, a difference goes downwards.
        steps = np.where(point > self.high - _DIFFERENCE, -_DIFFERENCE, _DIFFERENCE)
        # Parameters that are differentiated together, shape (k,): one of each disturbance of a group.
        differences = [(group, parameters) for group in self.groups for parameters in group.parameters.T]
        shifted = self.at(
            *(_point_with_step(point, parameters, steps[parameters]) for _, parameters in differences)
        )
        gradient = np.zeros(len(point))
        for (group, parameters), shifted_values in zip(differences, shifted, strict=True):
            # Shape (k,): each disturbance changes the log-likelihood of the outputs that it affects.
            change = group.likelihoods(shifted_values) - group.likelihoods(values)
            gradient[parameters] = change / steps[parameters]
        # A parameter on its bound stays there if the gradient points outwards.
        gradient[(point <= self.low + 1e-9) & (gradient < 0.0)] = 0.0
        gradient[(point >= self.high - 1e-9) & (gradient > 0.0)] = 0.0
        return gradient

    def curvature(self, point: Floats) -> tuple[Floats, Floats]:
        """Compute the log-likelihood at a point, and its negative second derivatives near it. Returns shape
        `values` (m,), `curvature` (f, f).
        """
        # Differences of step h of the likelihood L: L'' = (L(x+h) - 2 L(x) + L(x-h)) / h^2, and for two
        # parameters (L(x+h, y+h) - L(x+h, y) - L(x, y+h) + L(x, y)) / h^2. A second difference needs a larger
        # step than a first one, because rounding errors are divided by the square.
        h = 3 * _DIFFERENCE
        inside = np.clip(point, self.low + h, self.high - h)
        points = [point, inside]
        for group in self.groups:
            columns = group.parameters.T
            points += [_point_with_step(inside, column, h) for column in columns]
            points += [_point_with_step(inside, column, -h) for column in columns]
            points += [
                _point_with_step(_point_with_step(inside, first, h), second, h)
                for first, second in combinations(columns, 2)
            ]
        values, inside_values, *shifted_values = self.at(*points)
        # Consumed below in the order of `points`.
        shifted = iter(shifted_values)
        curvature = np.zeros((len(point), len(point)))
        for group in self.groups:
            columns, middle = group.parameters.T, group.likelihoods(inside_values)
            up = [group.likelihoods(next(shifted)) for _ in columns]
            down = [group.likelihoods(next(shifted)) for _ in columns]
            for i, column in enumerate(columns):
                curvature[column, column] = -(up[i] - 2 * middle + down[i]) / h**2
            for i, j in combinations(range(len(columns)), 2):
                # This forward difference has an error of third order; the diagonals above have none.
                mixed = -(group.likelihoods(next(shifted)) - up[i] - up[j] + middle) / h**2
                curvature[columns[i], columns[j]] = curvature[columns[j], columns[i]] = mixed
        return values, curvature

    def newton_move(self, gradient: Floats, curvature: Floats) -> Floats:
        """Compute a Newton step of the logarithms, shape (f,), separately for each disturbance. Shapes:
        `gradient` (f,), `curvature` (f, f).
        """
        move = np.zeros(len(gradient))
        for group in self.groups:
            for parameters in group.parameters:
                free = parameters[gradient[parameters] != 0.0]
                if len(free):
                    move[free] = _newton_step(gradient[free], curvature[np.ix_(free, free)])
        return move


def maximise(
    value: Callable[[Sequence[DisturbanceModel]], Floats],
    start: DisturbanceModel,
    std_range: tuple[float, float],
    tolerance_nats: float = _DISTURBANCES_CONVERGED_NATS,
    start_values: Floats | None = None,
) -> DisturbanceModel:
    """Maximise a likelihood over the disturbances by Newton's method with backtracking. Shapes: `std_range`
    (float, float), `start_values` (m,).
    """
    # `start_values` are the log-likelihoods at `start`, None if they are not known.
    likelihood = _Likelihood(value, start, std_range)
    point, curvature = likelihood.inside(start.logarithms), start.curvature
    has_new_curvature = curvature is None
    if curvature is None:
        values, curvature = likelihood.curvature(point)
    else:
        values = likelihood.at(point)[0] if start_values is None else start_values
    for _ in range(_MAX_STEPS):
        gradient = likelihood.gradient(point, values)
        if not (np.isfinite(gradient).all() and np.isfinite(curvature).all()):
            # The model diverges, and no disturbances improve that.
            return start.with_logarithms(point, None)
        move = likelihood.newton_move(gradient, curvature)
        predicted_gain = 0.5 * float(gradient @ move)
        if predicted_gain < tolerance_nats:
            break  # converged
        trials = likelihood.at(*(point + share * move for share in _SHARES))
        gains = trials.sum(axis=1) - values.sum()
        # The longest acceptable step is taken.
        acceptable = [
            i for i, share in enumerate(_SHARES) if gains[i] > _ARMIJO_SHARE * share * predicted_gain
        ]
        if not acceptable:
            # A new curvature may give a better step; without a new one, the search ends.
            if has_new_curvature:
                break
            values, curvature = likelihood.curvature(point)
            has_new_curvature = True
            continue
        best = acceptable[0]
        point, values = likelihood.inside(point + _SHARES[best] * move), trials[best]
        if gains[best] < tolerance_nats:
            break  # converged
        # After a shortened or a long step, the curvature of the last point is too inaccurate.
        has_new_curvature = _SHARES[best] < 1.0 or bool(np.abs(move).max() > _LONG_MOVE)
        if has_new_curvature:
            values, curvature = likelihood.curvature(point)
    return start.with_logarithms(point, curvature)


def _point_with_step(point: Floats, columns: Integers, step: float | Floats) -> Floats:
    """Return the `point`, shape (f,), with a `step` added to the elements `columns`."""
    result = point.copy()
    result[columns] += step
    return result


def _newton_step(gradient: Floats, curvature: Floats) -> Floats:
    """Compute the Newton step of one disturbance, shape (n,): uphill along every eigenvector of the
    curvature, and of limited length.
    """
    values, vectors = np.linalg.eigh(curvature)
    move: Floats = vectors @ ((vectors.T @ gradient) / np.maximum(np.abs(values), _MIN_CURVATURE))
    longest = float(np.abs(move).max())
    return move * min(1.0, _LONGEST_MOVE / max(longest, 1e-12))


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
    def params(self) -> dict[str, float]:
        """Free parameters by name."""
        return self.parameter_vector.by_name(self.theta)

    @property
    def std(self) -> dict[str, float]:
        """Standard errors by name."""
        return self.parameter_vector.by_name(np.sqrt(np.diag(self.covariance)))

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
        As in `maximise`.
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
        """Compute the first iterate, at the start values `theta`, shape (f,)."""
        filtered = self.linearised(theta)
        iterate = self.iterate_at(theta, disturbances or self.functions.model.disturbance_start, filtered)
        if disturbances is None:
            for _ in range(_FIRST_ITERATIONS):
                errors = filtered.perturbed_residual(iterate.step.move)
                better = estimate_disturbances(filtered, errors, iterate.disturbances)
                iterate = self.iterate_at(theta, better, filtered)
        return iterate

    def with_next_parameters(self, iterate: _Iterate) -> _Iterate | None:
        """Take a step of the parameters with backtracking; None if no length of it gains enough."""
        # The linearised model of `iterate` is released first, because two need too much memory.
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
        # `promised_nats` is the gain of the next step of the parameters as the linearised model predicts it.
        # An iteration is a step of the parameters, if it promises enough, then one of the disturbances.
        previous_log_posterior = -np.inf
        for _ in range(_MAX_ITERATIONS):
            if iterate.log_posterior == -np.inf:
                return iterate, False  # the model diverges
            if iterate.step.promised_nats > _CONVERGED_NATS:
                after_step = self.with_next_parameters(iterate)
                if after_step is None:
                    # A step may fail under wrong disturbances, and succeed under better ones.
                    with_better_disturbances = self.with_next_disturbances(iterate, _CONVERGED_NATS)
                    disturbance_gain_nats = with_better_disturbances.log_posterior - iterate.log_posterior
                    if not self.retries_failed_steps or disturbance_gain_nats < _MIN_ITERATION_GAIN_NATS:
                        return with_better_disturbances, False
                    iterate = with_better_disturbances
                    continue  # the step is still due, so that the search cannot have converged
                iterate = after_step
            # As long as the parameters change much, rough disturbances are enough.
            tolerance_nats = max(_CONVERGED_NATS, _DISTURBANCE_SHARE * iterate.step.promised_nats)
            iterate = self.with_next_disturbances(iterate, tolerance_nats)
            iteration_gain_nats = iterate.log_posterior - previous_log_posterior
            is_promise_small = iterate.step.promised_nats < _CONVERGED_NATS
            if is_promise_small and iteration_gain_nats < _MIN_ITERATION_GAIN_NATS:
                return iterate, True
            previous_log_posterior = iterate.log_posterior
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
