"""Solve an estimation problem by multiple shooting: parameters and initial states are fitted together.

The normal equations have a block for the initial state of each window, which is coupled to the free
parameters only. Eliminating these blocks (Schur complement) leaves a system of the free parameters alone
(Bock, 1987). The fit begins on the coarse grid, which is cheap, and ends on every sample; search and estimate
of the noise alternate.

A joint Gauss-Newton step of all windows and parameters is accepted or rejected as a whole. If the model has
kinks, as with dry friction and backlash, a single window may diverge, and every joint step would be rejected.
A few damped steps of that window alone correct this.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.errors import IdentifyError
from heli_lab.fit import thresholds
from heli_lab.fit.normal_equations import DampedStep, minimise, posterior_step
from heli_lab.fit.problem import (
    RIGID_STATES,
    Budget,
    Evaluation,
    Fit,
    FitProgress,
    Problem,
    alternative_states,
    initial_state_guess,
)
from heli_lab.fit.uncertainty import (
    floor_axes,
    long_run_variance,
    quantisation_scatter,
    timing_variance,
    window_weights,
)
from heli_lab.fit.windows import Grid


class WorkShares(NamedTuple):
    """Shares of the whole fit that are done before and after a part of it, from 0 to 1."""

    before: float
    after: float


@dataclass
class Iterate:
    """Values of the parameters and initial states, with everything that the next step needs."""

    theta: Floats  # (f,): Free parameters
    states: list[Floats]  # (w, states): Initial states of the windows of each record
    evaluations: list[Evaluation]  # Predictions of each record with their derivatives
    cost: float = math.inf  # Weighted sum of squares plus priors


def window_cost(
    problem: Problem,
    squares: Floats,
    states: Floats,
    prior_mean: Floats,
    variance: Floats,
    weights: Floats | float = 1.0,
) -> Floats:
    """Compute the cost of each window of a record, shape (w,): the weighted sum of squared residuals, plus
    the prior of the initial states; infinite if a prediction diverges. Shapes: `squares` (w, 3), `states` (w,
    states), `prior_mean` (w, states), `variance` (3,), `weights` (w,).
    """
    deviation = (states - prior_mean)[:, RIGID_STATES:] / problem.state_std
    cost = weights * (squares / variance).sum(axis=1) + (deviation**2).sum(axis=1)
    return np.where(np.isfinite(cost), cost, np.inf)


class ShootingCost:
    """Cost of multiple shooting: each window is predicted from its own initial state. `variance` has shape
    (3,). `weights` has shape (w,). `state_prior` has shape (w, states).
    """

    def __init__(self, problem: Problem, robust: bool) -> None:
        self.problem, self.robust = problem, robust
        self.fine = False
        self.variance: list[Floats] = []
        self.weights: list[Floats] = []
        self.state_prior: list[Floats] = []
        self.evaluations = 0
        self._last_guess: tuple[Floats, list[Floats]] | None = None
        """Free parameters of the last guess of the initial states, and that guess."""

    def initial_state_guess(self, theta: Floats) -> list[Floats]:
        """Guess the initial states from the angles, with free parameters `theta`, shape (f,)."""
        if self._last_guess is None or not np.array_equal(self._last_guess[0], theta):
            self._last_guess = theta.copy(), initial_state_guess(self.problem, theta)
        _, guess = self._last_guess
        return [states.copy() for states in guess]

    def evaluate(self, theta: Floats, states: list[Floats]) -> Iterate:
        """Predict all records, and return residuals, derivatives and cost. Shapes: `theta` (f,), `states`
        (w, states).
        """
        evaluations = [
            self.problem.evaluation(index, theta, start, fine=self.fine) for index, start in enumerate(states)
        ]
        self.evaluations += 1
        iterate = Iterate(theta, states, evaluations)
        iterate.cost = self.cost(iterate) if self.variance else math.inf
        return iterate

    def cost(self, iterate: Iterate) -> float:
        """Cost of an `iterate` with the present weights; infinite if a prediction diverges."""
        vector = self.problem.parameter_vector
        prior = (iterate.theta - vector.mean) / vector.std
        total = float(prior @ prior)
        total += float(sum(self.window_cost(iterate, i).sum() for i in range(len(iterate.evaluations))))
        return total if math.isfinite(total) else math.inf

    def window_cost(self, iterate: Iterate, index: int) -> Floats:
        """Cost of each window of record `index`, shape (w,)."""
        return window_cost(
            self.problem,
            iterate.evaluations[index].squares,
            iterate.states[index],
            self.state_prior[index],
            self.variance[index],
            self.weights[index],
        )

    def reweight(self, iterate: Iterate) -> float:
        """Estimate variances and weights from the residuals of an `iterate`, and update its cost with
        them.
        """
        before = self.variance
        estimates = [
            self._variance_and_weights(evaluation, self.problem.grid(index, self.fine, iterate.theta))
            for index, evaluation in enumerate(iterate.evaluations)
        ]
        self.variance = [variance for variance, _ in estimates]
        self.weights = [weights for _, weights in estimates]
        iterate.cost = self.cost(iterate)
        # `before` is empty at first: the change then counts as infinite.
        changes = [
            float(np.max(np.abs(new / old - 1))) for new, old in zip(self.variance, before, strict=False)
        ]
        return max(changes, default=math.inf)

    def _variance_and_weights(self, evaluation: Evaluation, grid: Grid) -> tuple[Floats, Floats]:
        """Estimate the long-run variance of each axis, shape (3,), and the robust weight of each window,
        shape (w,), of a record.
        """
        weights = np.ones(len(grid.slices))
        for _ in range(thresholds.WEIGHT_TURNS if self.robust else 1):
            row_weights = np.repeat(weights, grid.inputs.steps)[:, None]
            mean_weight = float(np.mean(row_weights))
            weighted = evaluation.residual * np.sqrt(row_weights)
            # At least the variance of the quantisation, which is 1.
            variance = np.maximum(
                1.0, long_run_variance(weighted, grid.slices, grid.inputs.step_s) / mean_weight
            )
            mean_square = np.mean(weighted**2, axis=0) / mean_weight
            variance = floor_axes(variance, mean_square, grid.record.sigma_rad)
            weights_before = weights
            if self.robust:
                weights = window_weights(evaluation.residual, grid.slices, variance)
            if np.array_equal(weights, weights_before):
                break  # further turns change nothing
        return variance, weights

    def update_state_prior(self, iterate: Iterate) -> None:
        """Set the prior means of effects' states: simulate the flight before each window with the parameters
        of an `iterate`.
        """
        if self.problem.state_count > RIGID_STATES:
            self.state_prior = self.initial_state_guess(iterate.theta)


SINGULAR_GUARD: Final = 1e-12
"""Added to the diagonal of a block, as a share of its largest entry. It keeps the block regular if a
state has no influence on the measured angles. It is far above the rounding of doubles, and far below any
information."""


def eliminate(matrices: Floats, count: int, guard: float = 0.0) -> tuple[Floats, Floats]:
    """Eliminate the leading unknowns of symmetric systems [[A, B], [B', C]] by the Schur complement. Shapes:
    `matrices` (..., m, m); returns `complement` (..., m - count, m - count), `gain` (..., count, m - count).
    """
    # The right-hand side may be appended to a system as its last row and column. The last column of the
    # complement is then the right-hand side of the reduced system. The last column of the gain is A^-1 times
    # the first part of the right-hand side.
    leading = matrices[..., :count, :count].copy()
    coupling = matrices[..., :count, count:]
    diagonal = np.arange(count)
    if guard:
        leading[..., diagonal, diagonal] += guard * leading[..., diagonal, diagonal].max(
            axis=-1, keepdims=True
        )
    gain: Floats = np.linalg.solve(leading, coupling).astype(np.float64, copy=False)
    return matrices[..., count:, count:] - np.swapaxes(coupling, -1, -2) @ gain, gain


def add_state_prior(
    problem: Problem, normal: Floats, states: Floats, reference: Floats, damping: float | Floats = 0.0
) -> None:
    """Add the prior of the effects' initial states to the windows' normal equations, and damp the states.
    Shapes: `normal` (w, m, m), `states` (w, states), `reference` (w, states), `damping` (w,).
    """
    state_count = problem.state_count
    diagonal, effect_rows = np.arange(state_count), np.arange(RIGID_STATES, state_count)
    precision = 1.0 / problem.state_std**2
    normal[:, effect_rows, effect_rows] += precision
    prior_gradient = precision * (reference - states)[:, RIGID_STATES:]
    # The last row and the last column of the normal equations are the right-hand side.
    normal[:, effect_rows, -1] += prior_gradient
    normal[:, -1, effect_rows] += prior_gradient
    normal[:, diagonal, diagonal] *= 1.0 + np.reshape(damping, (-1, 1))


@dataclass(frozen=True)
class ReducedSystem:
    """Normal equations of the free parameters, from which the windows' initial states are eliminated."""

    information: Floats  # (f, f): Normal matrix of the free parameters, without priors
    gradient: Floats  # (f,): Negative gradient of half the sum of squares, without priors
    state_steps: list[Floats]
    """(w, states): For each record, the step of the initial states if the parameters stay fixed."""
    state_responses: list[Floats]
    """(w, states, k): For each record, minus the change of the initial states per unit of each of the k
    parameters that the record depends on."""
    predicted_reduction: float  # Reduction of the sum of squares by `state_steps`, if the sum were quadratic


def eliminate_states(cost: ShootingCost, iterate: Iterate, damping: float = 0.0) -> ReducedSystem:
    """Eliminate the windows' initial states from the normal equations of all records."""
    problem = cost.problem
    state_count, free_count = problem.state_count, len(problem.free)
    information, gradient = np.zeros((free_count, free_count)), np.zeros(free_count)
    state_steps, state_responses, predicted_reduction = [], [], 0.0
    for index, evaluation in enumerate(iterate.evaluations):
        # Sum over the axes a, each divided by its variance: shape (w, z + 1, z + 1).
        scale = cost.weights[index][:, None] / cost.variance[index]
        normal = np.einsum("wa,waij->wij", scale, evaluation.normal_matrix)
        add_state_prior(problem, normal, iterate.states[index], cost.state_prior[index], damping)
        complement, gain = eliminate(normal, state_count, SINGULAR_GUARD)
        columns = problem.columns[index]
        information[np.ix_(columns, columns)] += complement[:, :-1, :-1].sum(axis=0)
        gradient[columns] += complement[:, :-1, -1].sum(axis=0)
        predicted_reduction += float(np.sum(normal[:, :state_count, -1] * gain[:, :, -1]))
        state_steps.append(gain[:, :, -1])
        state_responses.append(gain[:, :, :-1])
    return ReducedSystem(information, gradient, state_steps, state_responses, predicted_reduction)


_DAMPING: Final = 1e-3
"""Damping of a window's first step, as a share of the diagonal of its normal matrix."""
_RESTART_STEPS: Final = 12
"""Largest number of steps from another start: three times those of a refinement, because the start is far."""


def refine_states(
    cost: ShootingCost,
    iterate: Iterate,
    index: int,
    windows: Integers,
    *,
    before: Floats | None = None,
    max_steps: int = 4,
) -> None:
    """Improve the initial states of some windows of an `iterate`, each by its own Levenberg-Marquardt steps.
    Shapes: `windows` (k,), `before` (w, states).
    """
    search = _WindowSearch(cost, iterate, index, windows)
    if before is not None:
        search.replace_if_better(before[windows])
    search.descend(max_steps, thresholds.WINDOW_PATIENCE)
    search.write_back(cost, iterate, index)


def restart_states(
    cost: ShootingCost, iterate: Iterate, index: int, windows: Integers, start: Floats
) -> None:
    """Optimise some windows of an `iterate` from other initial states, and keep the result if it is better.
    Shapes: `start` (w, states).
    """
    present = _WindowSearch(cost, iterate, index, windows)
    restarted = _WindowSearch(cost, iterate, index, windows)
    # An infinite cost makes the search accept the other states, even if they are worse at first.
    restarted.cost[:] = np.inf
    restarted.replace_if_better(start[windows])
    restarted.descend(_RESTART_STEPS, thresholds.RESTART_PATIENCE)
    present.merge_better(restarted)
    present.write_back(cost, iterate, index)


class _WindowSearch:
    """Best initial states so far of some windows of a record, each window with its own cost."""

    # `steps` has shape (m,). `variance` has shape (3,). `parameters` has shape (p,). `prior_mean` has shape
    # (k, states). `normal_matrix` has shape (k, 3, z + 1, z + 1). `residual` has shape (m, 3).

    def __init__(self, cost: ShootingCost, iterate: Iterate, index: int, windows: Integers) -> None:
        problem, evaluation = cost.problem, iterate.evaluations[index]
        record_grid = problem.grid(index, cost.fine, iterate.theta)
        self._problem, self.windows, self.variance = problem, windows, cost.variance[index]
        self.grid, self.steps = record_grid.only(windows), record_grid.steps_of(windows)
        self.parameters = problem.parameters(iterate.theta, index)
        self.prior_mean = cost.state_prior[index][windows]
        self.states = iterate.states[index][windows].copy()
        self.normal_matrix = evaluation.normal_matrix[windows].copy()
        self.residual = evaluation.residual[self.steps].copy()
        self.cost = self._window_costs(self.states, evaluation.squares[windows])

    def replace_if_better(self, states: Floats) -> Booleans:
        """Replace the states of those windows for which other `states`, shape (k, states), cost less.
        Returns shape (k,).
        """
        evaluation = self._problem.evaluate_grid(self.grid, states, self.parameters)
        cost = self._window_costs(states, evaluation.squares)
        is_better: Booleans = cost < self.cost
        self._replace(is_better, states, evaluation.normal_matrix, cost, evaluation.residual)
        return is_better

    def merge_better(self, other: _WindowSearch) -> None:
        """Replace the states of those windows for which an `other` search of the same windows costs less."""
        is_better = other.cost < self.cost
        self._replace(is_better, other.states, other.normal_matrix, other.cost, other.residual)

    def _replace(
        self, is_better: Booleans, states: Floats, normal_matrix: Floats, cost: Floats, residual: Floats
    ) -> None:
        """Replace the states of the windows `is_better`, shape (k,), with all that depends on them."""
        self.states[is_better] = states[is_better]
        self.normal_matrix[is_better] = normal_matrix[is_better]
        self.cost[is_better] = cost[is_better]
        steps = np.repeat(is_better, self.grid.inputs.steps)
        self.residual[steps] = residual[steps]

    def descend(self, max_steps: int, patience: int) -> None:
        """Take damped steps until `patience` steps in a row reduced the cost too little."""
        damping, idle_steps = np.full(len(self.windows), _DAMPING), 0
        for _ in range(max_steps):
            if not np.isfinite(self.cost).all() or idle_steps == patience:
                break  # a window diverges, or the search has converged
            cost_before = float(self.cost.sum())
            is_better = self.replace_if_better(self._states_after_step(damping))
            damping = np.where(is_better, 0.2 * damping, 30.0 * damping)
            reduction = cost_before - float(self.cost.sum())
            idle_steps = 0 if reduction > thresholds.WORTHWHILE_GAIN * cost_before else idle_steps + 1

    def _states_after_step(self, damping: Floats) -> Floats:
        """Return the states after a Levenberg-Marquardt step of each window, shape (k, states). Shapes:
        `damping` (k,).
        """
        state_count = self._problem.state_count
        normal = np.einsum("a,waij->wij", 1.0 / self.variance, self.normal_matrix)
        add_state_prior(self._problem, normal, self.states, self.prior_mean, damping)
        # The parameters are fixed: keep the rows and columns of the states and of the right-hand side.
        kept_rows = [*range(state_count), normal.shape[1] - 1]
        _, gain = eliminate(normal[:, kept_rows][:, :, kept_rows], state_count, SINGULAR_GUARD)
        return self.states + gain[:, :, 0]

    def write_back(self, cost: ShootingCost, iterate: Iterate, index: int) -> None:
        """Write these windows into record `index` of an `iterate`, and update the cost of the iterate."""
        evaluation = iterate.evaluations[index]
        states = iterate.states[index].copy()
        residual, normal_matrix = evaluation.residual.copy(), evaluation.normal_matrix.copy()
        states[self.windows] = self.states
        residual[self.steps] = self.residual
        normal_matrix[self.windows] = self.normal_matrix
        # New arrays, because other iterates may share the old ones.
        iterate.states[index] = states
        iterate.evaluations[index] = Evaluation(residual, normal_matrix)
        iterate.cost = cost.cost(iterate)

    def _window_costs(self, states: Floats, squares: Floats) -> Floats:
        """Cost of each window, shape (k,), from its initial states and its sum of squares per axis."""
        return window_cost(self._problem, squares, states, self.prior_mean, self.variance)


def recover_windows(cost: ShootingCost, iterate: Iterate, before: Iterate) -> None:
    """Optimise the diverged windows of an `iterate` separately; the others stay unchanged."""
    for index in range(len(iterate.evaluations)):
        old_cost, new_cost = cost.window_cost(before, index), cost.window_cost(iterate, index)
        with np.errstate(invalid="ignore"):
            is_raised = new_cost - old_cost > thresholds.DIVERGED_SHARE * before.cost
        diverged = np.flatnonzero(is_raised & (new_cost > thresholds.DIVERGED_FACTOR * old_cost))
        if len(diverged):
            refine_states(cost, iterate, index, diverged, before=before.states[index])


def reoptimise_states(cost: ShootingCost, iterate: Iterate) -> Iterate | None:
    """Optimise all initial states of an `iterate`, with its parameters fixed; None if they have converged."""
    refined = Iterate(iterate.theta, list(iterate.states), list(iterate.evaluations), iterate.cost)
    for index, states in enumerate(iterate.states):
        refine_states(cost, refined, index, np.arange(len(states)), max_steps=6)
    return refined if refined.cost < (1.0 - thresholds.WORTHWHILE_GAIN) * iterate.cost else None


def restart_outliers(cost: ShootingCost, iterate: Iterate) -> bool:
    """Optimise the outlying windows of an `iterate` from alternative initial states; change it in place."""
    problem, cost_before = cost.problem, iterate.cost
    for index in range(len(iterate.evaluations)):
        for turn in range(thresholds.RESTARTS):
            steps = problem.grid(index, cost.fine, iterate.theta).inputs.steps
            # Mean over the three angles and the steps of each window.
            mean_square = iterate.evaluations[index].squares.sum(axis=1) / (3 * steps)
            median = float(np.median(mean_square))
            outlying = np.flatnonzero(mean_square > thresholds.RESTART_OUTLIER * median)
            if not len(outlying) or median > thresholds.MAX_RESTART_MEDIAN:
                break  # no window is wrong, or the model is
            alternatives = alternative_states(problem, index, iterate.theta, iterate.states[index])
            # In later turns only the first alternative is new: the end of the previous window, which may have
            # left its own wrong minimum.
            for start in alternatives if turn == 0 else alternatives[:1]:
                restart_states(cost, iterate, index, outlying, start)
    return iterate.cost < (1.0 - thresholds.WORTHWHILE_GAIN) * cost_before


_FINE_IDLE_SHARE: Final = 0.2
"""Factor on the smallest gain of a step that counts, when every sample is compared. Two steps below it
end the search. It is less than 1 because the fit on the coarse grid is already near the minimum."""


class MultipleShooting:
    """Gauss-Newton steps of a multiple-shooting fit, for the Levenberg-Marquardt search in `minimise`.
    `is_fixed` has shape (f,).
    """

    def __init__(
        self, cost: ShootingCost, budget: Budget, on_progress: Callable[[FitProgress], None] | None
    ) -> None:
        self.cost = cost
        self.damping = 0.0
        self.is_fixed = np.zeros(len(cost.problem.free), bool)
        self.started_s = time.perf_counter()
        self._budget = budget
        self._on_progress = on_progress or (lambda progress: None)

    def is_out_of_budget(self) -> bool:
        """Whether the fit has used all its evaluations or all its time."""
        elapsed_s = time.perf_counter() - self.started_s
        budget = self._budget
        return self.cost.evaluations >= budget.max_evaluations or elapsed_s >= budget.max_time_s

    def step(self, iterate: Iterate, damping: float) -> DampedStep[Iterate]:
        """Linearise the model at an `iterate`, and solve for a Levenberg-Marquardt step with this
        `damping`.
        """
        cost, problem = self.cost, self.cost.problem
        reduced = eliminate_states(cost, iterate, thresholds.STATE_DAMPING * damping)
        step = posterior_step(
            problem.parameter_vector,
            iterate.theta,
            reduced.information,
            reduced.gradient,
            damping=damping,
            is_fixed=self.is_fixed,
        )

        def iterate_after_step() -> Iterate:
            """Evaluate the model after the step, and recover the windows that diverge there."""
            states = []
            for index, columns in enumerate(problem.columns):
                # Shape (w, states): change of the initial states because the parameters change.
                response = np.einsum("wsf,f->ws", reduced.state_responses[index], step.move[columns])
                states.append(iterate.states[index] + reduced.state_steps[index] - response)
            after = cost.evaluate(iterate.theta + step.move, states)
            recover_windows(cost, after, iterate)
            return after

        # The cost is twice the negative log-posterior.
        predicted_reduction = reduced.predicted_reduction + 2.0 * step.promised_nats
        return DampedStep(step.move, step.std, predicted_reduction, iterate_after_step)

    def with_states_refined(self, iterate: Iterate) -> Iterate | None:
        """Optimise the initial states of an `iterate` alone; None if they have converged."""
        return reoptimise_states(self.cost, iterate)

    def descend(
        self, iterate: Iterate, stage: str, shares: WorkShares, max_steps: int
    ) -> tuple[Iterate, bool]:
        """Reduce the cost by Levenberg-Marquardt steps until the steps are small."""
        # Returns `iterate`, `converged`.

        def report(number: int, cost: float) -> None:
            """Report the progress after step `number`."""
            # The number of steps is not known: each one counts for half of the work that remains.
            done = shares.before + (shares.after - shares.before) * (1 - 0.5**number)
            self._on_progress(FitProgress(stage, done, cost))

        minimum = minimise(
            self,
            iterate,
            damping=self.damping,
            max_steps=max_steps,
            idle_share=_FINE_IDLE_SHARE if self.cost.fine else 1.0,
            on_step=report,
        )
        self.damping = minimum.damping
        return minimum.iterate, minimum.converged


_ROUGH_STEPS: Final = 4
"""Largest number of steps in a rough round: the minimum moves anyway when the weights change."""
_COARSE_STEPS: Final = 30
"""Largest number of steps in a later round on the coarse grid, hardly ever reached."""
_FINE_STEPS: Final = 10
"""Largest number of steps in a round on every sample: the coarse fit is near the minimum."""
_RESTART_ROUNDS: Final = (2, 3)
"""Rounds on the coarse grid that restart outlying windows from other initial states."""
_COARSE_SHARE: Final = 0.6
"""Share of the work that the coarse grid takes, for the progress."""


def solve(
    problem: Problem,
    *,
    start: Fit | Mapping[str, float] | None = None,
    budget: Budget | None = None,
    robust: bool = True,
    fine: bool = True,
    scatter: bool = True,
    warm_start: bool = False,
    on_progress: Callable[[FitProgress], None] | None = None,
) -> Fit:
    """Estimate the free parameters and the windows' initial states by multiple shooting.

    The search for the minimum alternates with estimates of the weights, first on the coarse grid, then on
    every sample. The squares of each axis are divided by the long-run variance of its own residuals
    (`heli_lab.fit.uncertainty.long_run_variance`). Standard errors are then not too small if the model is
    wrong, or if the same count stays for many samples.

    Parameters
    ----------
    problem : Problem
        The model with its free parameters, and the windows of the flights.
    start : Fit or Mapping[str, float], optional
        Start values: an earlier fit, perhaps of another problem, or values by name; unknown names are
        ignored.
    budget : Budget, optional
        Limits of the work. If they are reached, the result is the best iterate, marked as not converged.
    robust : bool
        Whether outlying windows lose weight.
    fine : bool
        Finish on every sample, not on the coarse grid.
    scatter : bool
        Widen standard errors by the effect of quantisation, which takes as long as two steps.
    warm_start : bool
        Stop after one round on the coarse grid: enough for a start near the minimum, for example if only
        constants and initial states are free.
    on_progress : callable, optional
        Called with the progress of the fit.

    Raises
    ------
    IdentifyError
        When the model cannot predict the flights at all from the start values.
    """
    cost = ShootingCost(problem, robust)
    shooting = MultipleShooting(cost, budget or Budget(), on_progress)
    theta, states = _start_point(cost, start)
    cost.state_prior = cost.initial_state_guess(theta)
    iterate = cost.evaluate(theta, states)
    cost.reweight(iterate)
    if not math.isfinite(iterate.cost):
        raise IdentifyError(
            "the model's free run diverges from the start values", "check the rig parameters and units"
        )
    last = _fit_coarse_grid(shooting, iterate, warm_start)
    # The single round of a warm start does not wait for its weights.
    converged = last.search_converged if warm_start else last.converged
    if fine:
        # What the coarse grid left open does not matter if every sample is then fitted.
        converged = False
        if not shooting.is_out_of_budget():
            last = _fit_every_sample(shooting, last.iterate)
            converged = last.converged
    return _collect_fit(shooting, last.iterate, converged, scatter)


@dataclass(frozen=True)
class _RoundResult:
    """Result of one search for the minimum, and of the estimate of the weights after it."""

    iterate: Iterate  # The best parameters and initial states
    search_converged: bool  # False if the budget or the largest number of steps ended the search
    weights_settled: bool  # Whether the weights changed so little that no further round is needed

    @property
    def converged(self) -> bool:
        """Whether neither a further step nor a further round would change the estimates noticeably."""
        return self.search_converged and self.weights_settled


def _fit_coarse_grid(shooting: MultipleShooting, iterate: Iterate, warm_start: bool) -> _RoundResult:
    """Fit on the coarse grid, in rounds until the weights settle; return the last round."""
    problem, round_count = shooting.cost.problem, thresholds.ROUNDS
    multimodal = {name for effect in problem.model.effects for name in effect.multimodal}
    min_rounds = thresholds.ROUGH_ROUNDS + bool(multimodal)
    for number in range(round_count):
        # While amplitudes are still wrong, a frequency or a moment would converge to a wrong local minimum.
        is_rough = number < thresholds.ROUGH_ROUNDS
        shooting.is_fixed[:] = [is_rough and parameter.quantity in multimodal for parameter in problem.free]
        shares = WorkShares(_COARSE_SHARE * number / round_count, _COARSE_SHARE * (number + 1) / round_count)
        max_steps = _ROUGH_STEPS if is_rough else _COARSE_STEPS
        stage = f"coarse fit, round {number + 1}"
        last = _fit_round(shooting, iterate, stage, shares, max_steps, restart=number in _RESTART_ROUNDS)
        iterate = last.iterate
        shooting.damping = 0.0
        is_settled = number + 1 >= min_rounds and last.weights_settled
        if warm_start or shooting.is_out_of_budget() or is_settled:
            break
    return last


def _fit_every_sample(shooting: MultipleShooting, iterate: Iterate) -> _RoundResult:
    """Fit on every sample from an `iterate` of the coarse grid, until the weights settle; return the last
    round.
    """
    cost, round_count = shooting.cost, thresholds.FINE_ROUNDS
    cost.fine = True
    iterate = cost.evaluate(iterate.theta, iterate.states)
    cost.reweight(iterate)
    for number in range(round_count):
        shares = WorkShares(_COARSE_SHARE + (1.0 - _COARSE_SHARE) * number / round_count, 1.0)
        last = _fit_round(shooting, iterate, "every sample", shares, _FINE_STEPS, restart=number < 2)
        iterate = last.iterate
        if last.weights_settled or shooting.is_out_of_budget():
            break
    return last


def _fit_round(
    shooting: MultipleShooting,
    iterate: Iterate,
    stage: str,
    shares: WorkShares,
    max_steps: int,
    *,
    restart: bool,
) -> _RoundResult:
    """Search for the minimum from an `iterate`, then estimate weights and state priors again."""
    cost = shooting.cost
    iterate, search_converged = shooting.descend(iterate, stage, shares, max_steps)
    restarted = restart and not shooting.is_out_of_budget() and restart_outliers(cost, iterate)
    cost.update_state_prior(iterate)
    change = cost.reweight(iterate)
    return _RoundResult(iterate, search_converged, change < thresholds.SETTLED_CHANGE and not restarted)


def _start_point(cost: ShootingCost, start: Fit | Mapping[str, float] | None) -> tuple[Floats, list[Floats]]:
    """Return start values of the free parameters, shape (f,), and the initial states of each record's
    windows, shape (w, states).
    """
    problem = cost.problem
    values = start.params if isinstance(start, Fit) else start or {}
    theta = problem.parameter_vector.started_from(values)
    states = cost.initial_state_guess(theta)
    # A fit of as many records is taken for one of the same records. If it is not, its states are poor start
    # values, no more.
    if isinstance(start, Fit) and len(start.states) == len(states):
        _copy_states(start, problem, states)
    return theta, states


def _copy_states(start: Fit, problem: Problem, states: list[Floats]) -> None:
    """Copy the initial states of an earlier fit into `states`, for the states and windows that both have."""
    # An effect's state is copied together with the rates of the arm, because the two compensate for each
    # other.
    old_columns = {state.name: column for column, state in enumerate(start.problem.model.states)}
    for new_column, state in enumerate(problem.model.states):
        if state.name not in old_columns:
            continue  # an effect that the earlier fit did not have
        for new, old in zip(states, start.states, strict=True):
            if len(new) == len(old):
                new[:, new_column] = old[:, old_columns[state.name]]


def _collect_fit(shooting: MultipleShooting, iterate: Iterate, converged: bool, scatter: bool) -> Fit:
    """Compute the covariance of the estimates, and collect the result of the fit."""
    cost, problem = shooting.cost, shooting.cost.problem
    information = eliminate_states(cost, iterate).information
    prior_information = np.diag(1.0 / problem.parameter_vector.std**2)
    covariance: Floats = np.linalg.inv(information + prior_information).astype(np.float64)
    # On the coarse grid, the fit is only a start for another one.
    if scatter and cost.fine and len(problem.free):
        scattered = quantisation_scatter(
            problem, iterate.theta, iterate.states, cost.variance, cost.weights, covariance
        )
        factors = np.maximum(1.0, scattered / np.sqrt(np.diag(covariance)))
        covariance = covariance * np.outer(factors, factors)
        covariance = covariance + np.diag(timing_variance(problem))
    low, high = problem.parameter_vector.bounds
    is_at_bound = (iterate.theta <= low) | (iterate.theta >= high)
    return Fit(
        problem=problem,
        theta=iterate.theta,
        covariance=covariance,
        information=information,
        states=tuple(iterate.states),
        variance=tuple(cost.variance),
        weights=tuple(cost.weights),
        cost=iterate.cost,
        at_bound=tuple(name for name, flag in zip(problem.names, is_at_bound, strict=True) if flag),
        evaluations=cost.evaluations,
        elapsed_s=time.perf_counter() - shooting.started_s,
        converged=converged,
    )
