"""Fits a problem: Levenberg-Marquardt with the windows' initial states eliminated.

The normal equations have a block for each window's initial state, coupled only to the free parameters. Their
Schur complement is a system of the free parameters alone.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.errors import IdentifyError
from heli_lab.identify.functions import Floats, Integers
from heli_lab.identify.grid import Grid
from heli_lab.identify.problem import Evaluation, Problem
from heli_lab.identify.residual_noise import floor_axes, long_run_variance, window_weights
from heli_lab.identify.schur import bounded_solve, eliminate_states
from heli_lab.identify.uncertainty import quantisation_scatter, timing_variance
from heli_lab.identify.window_states import relax, restart, window_cost

_ROUGH: Final = 3
"""First rounds, in which the weights and much else is far off."""
_ROUNDS: Final = 8
"""Most updates of the weights."""
_FINE_ROUNDS: Final = 4
"""Most of them on every sample."""
_SETTLED: Final = 0.15
"""Weights are settled when no variance changed by more than this share."""
_SMALL_STEP: Final = 0.02
"""In standard errors."""
_LARGEST_DAMPING: Final = 1e8
_OF_STATES: Final = 0.01
"""Damping of the states, in units of their own diagonal, for each unit of the parameters'."""
_OUT_OF_LINE: Final = 1.5
"""A window whose mean square is this many times the median window's is started again from elsewhere."""
_TOO_WRONG: Final = 9.0
"""Mean square of the median window, in units of the rounding, above which the model is to blame."""
_RESTARTS: Final = 2
_SPREADS: Final = 3
"""Turns between variances and weights; a window out of line must not widen what it is measured against."""
_ASTRAY: Final = 1.1
"""A window whose cost grows by this factor in a step did not follow it."""
_ASTRAY_SHARE: Final = 1e-3
"""And by this share of the whole cost."""
_IDLE_GAIN: Final = 1e-3
"""A fit whose cost falls by less than this share in each of two steps goes no further, small steps or not."""
_RELAXED: Final = 0.99
"""Where windows alone lower the cost to less than this share, the next step starts from there."""


@dataclass(frozen=True)
class Budget:
    """How much a fit may cost.

    Parameters
    ----------
    evaluations : int
        Most predictions of all flights with derivatives.
    seconds : float
        Most time.
    """

    evaluations: int = 80
    seconds: float = math.inf


@dataclass(frozen=True)
class Progress:
    """Where a fit is.

    Parameters
    ----------
    stage : str
        What it does, in a few words.
    done : float
        Share of the work done, 0 to 1; an estimate.
    cost : float
        Sum of squares, weighted.
    """

    stage: str
    done: float
    cost: float


@dataclass(frozen=True)
class Fit:
    """What a fit found.

    Parameters
    ----------
    problem : Problem
        What was fitted.
    theta : ndarray (f,)
        Free parameters.
    covariance : ndarray (f, f)
        Their covariance, priors included.
    information : ndarray (f, f)
        What the flights alone say: inverse covariance without priors.
    states : tuple of ndarray (w, states)
        Initial states of the windows of each record.
    variance : tuple of ndarray (3,)
        For each record, what the squared residuals of each axis were divided by; 1 where nothing but the
        rounding is left.
    weights : tuple of ndarray (w,)
        Weights of the windows of each record.
    cost : float
        Weighted sum of squares plus priors.
    at_bound : tuple of str
        Names of parameters that lie on a bound.
    evaluations : int
        Predictions of all flights with derivatives.
    seconds : float
        Time taken.
    converged : bool
        False when the budget ran out first.
    """

    problem: Problem
    theta: Floats
    covariance: Floats
    information: Floats
    states: tuple[Floats, ...]
    variance: tuple[Floats, ...]
    weights: tuple[Floats, ...]
    cost: float
    at_bound: tuple[str, ...]
    evaluations: int
    seconds: float
    converged: bool

    @property
    def values(self) -> dict[str, float]:
        """Free parameters by name."""
        return dict(zip(self.problem.names, map(float, self.theta), strict=True))

    @property
    def std(self) -> dict[str, float]:
        """Standard errors by name."""
        return dict(zip(self.problem.names, map(float, np.sqrt(np.diag(self.covariance))), strict=True))

    @property
    def correlation(self) -> Floats:
        """Correlations of the free parameters, shape (f, f)."""
        std = np.sqrt(np.diag(self.covariance))
        result: Floats = self.covariance / np.outer(std, std)
        return result


@dataclass
class _Point:
    """A guess with everything that the next step needs."""

    theta: Floats
    states: list[Floats]
    evaluations: list[Evaluation]
    cost: float = math.inf


class _Solver:
    def __init__(
        self, problem: Problem, budget: Budget, robust: bool, on_progress: Callable[[Progress], None] | None
    ) -> None:
        self.problem = problem
        self.robust = robust
        self.budget = budget
        self.on_progress = on_progress
        self.started_s = time.perf_counter()
        self.evaluations = 0
        self.damping = 0.0
        self.fine = False
        self.variance: list[Floats] = []
        self.weights: list[Floats] = []
        self.reference: list[Floats] = []
        self.held = np.zeros(len(problem.free), bool)

    def out_of_budget(self) -> bool:
        seconds = time.perf_counter() - self.started_s
        return self.evaluations >= self.budget.evaluations or seconds >= self.budget.seconds

    def evaluate(self, theta: Floats, states: list[Floats]) -> _Point:
        evaluations = [
            self.problem.evaluation(index, theta, start, fine=self.fine) for index, start in enumerate(states)
        ]
        self.evaluations += 1
        point = _Point(theta, states, evaluations)
        point.cost = self.cost(point) if self.variance else math.inf
        return point

    def reweight(self, point: _Point) -> float:
        """Update variances and weights; return the largest relative change of a variance."""
        variance, weights = [], []
        for index, evaluation in enumerate(point.evaluations):
            grid = self.problem.grid(index, self.fine, point.theta)
            found, weight = self.spread(evaluation, grid)
            variance.append(found)
            weights.append(weight)
        change = (
            max(
                float(np.max(np.abs(new / old - 1))) for new, old in zip(variance, self.variance, strict=True)
            )
            if self.variance
            else math.inf
        )
        self.variance, self.weights = variance, weights
        point.cost = self.cost(point)
        return change

    def spread(self, evaluation: Evaluation, grid: Grid) -> tuple[Floats, Floats]:
        """Variance of a record's axes, and weights of its windows, neither of them deciding about itself."""
        weight = np.ones(len(grid.slices))
        for _ in range(_SPREADS if self.robust else 1):
            rows = np.repeat(weight, grid.inputs.steps)[:, None]
            share = float(np.mean(rows))
            kept = evaluation.residual * np.sqrt(rows)
            found = np.maximum(1.0, long_run_variance(kept, grid.slices, grid.inputs.step_s) / share)
            found = floor_axes(found, np.mean(kept**2, axis=0) / share, grid.record.sigma_rad)
            before = weight
            if self.robust:
                weight = window_weights(evaluation.residual, grid.slices, found)
            if np.array_equal(weight, before):
                break
        return found, weight

    def cost(self, point: _Point) -> float:
        problem = self.problem
        prior = (point.theta - problem.prior_mean) / problem.prior_std
        total = float(prior @ prior)
        total += float(sum(self.window_cost(point, index).sum() for index in range(len(point.evaluations))))
        return total if math.isfinite(total) else math.inf

    def state_prior(self, point: _Point) -> None:
        """Tie effects' states to what the flight before their windows says, with the numbers found so far."""
        if self.problem.state_count > 6:
            self.reference = self.problem.first_states(point.theta)

    def window_cost(self, point: _Point, index: int) -> Floats:
        of_record = self.reference[index], self.variance[index], self.weights[index]
        return window_cost(self.problem, point.evaluations[index], point.states[index], *of_record)

    def relax(self, point: _Point, index: int, which: Integers, before: Floats | None, most: int) -> None:
        """Let some windows of a point find their own way."""
        of_record = self.reference[index], self.variance[index], which
        point.states[index], point.evaluations[index] = relax(
            self.problem,
            index,
            point.theta,
            point.states[index],
            point.evaluations[index],
            *of_record,
            before=before,
            fine=self.fine,
            most=most,
        )
        point.cost = self.cost(point)

    def gather(self, point: _Point, before: _Point) -> None:
        """Help windows that did not follow a step."""
        for index in range(len(point.evaluations)):
            old, new = self.window_cost(before, index), self.window_cost(point, index)
            with np.errstate(invalid="ignore"):
                astray = (new > _ASTRAY * old) & (new - old > _ASTRAY_SHARE * before.cost)
            if astray.any():
                self.relax(point, index, np.flatnonzero(astray), before.states[index], 4)

    def reoptimise_states(self, point: _Point) -> _Point | None:
        """Let all windows find their own way; None where they are there."""
        other = _Point(point.theta, list(point.states), list(point.evaluations), point.cost)
        for index, states in enumerate(point.states):
            self.relax(other, index, np.arange(len(states)), None, 6)
        return other if other.cost < _RELAXED * point.cost else None

    def rescue(self, point: _Point) -> bool:
        """Start windows that are out of line again from elsewhere; say whether that found a better valley."""
        before = point.cost
        for index in range(len(point.evaluations)):
            of_record = self.reference[index], self.variance[index]
            # The second time the window before may have found its own valley.
            for turn in range(_RESTARTS):
                normal_matrix = point.evaluations[index].normal_matrix
                assert normal_matrix is not None
                steps = self.problem.grid(index, self.fine, point.theta).inputs.steps
                squares = normal_matrix[:, :, -1, -1].sum(axis=1) / (3 * steps)
                usual = float(np.median(squares))
                lost = np.flatnonzero(squares > _OUT_OF_LINE * usual)
                if not len(lost) or usual > _TOO_WRONG:
                    break
                others = self.problem.other_starts(index, point.theta, point.states[index])
                for other in others if turn == 0 else others[:1]:
                    point.states[index], point.evaluations[index] = restart(
                        self.problem,
                        index,
                        point.theta,
                        point.states[index],
                        point.evaluations[index],
                        *of_record,
                        lost,
                        other,
                        fine=self.fine,
                    )
        point.cost = self.cost(point)
        return point.cost < _RELAXED * before

    def reduce(
        self, point: _Point, damping: float = 0.0
    ) -> tuple[Floats, Floats, list[tuple[Floats, Floats]]]:
        of_records = point.evaluations, point.states, self.reference, self.variance, self.weights
        return eliminate_states(self.problem, *of_records, damping=damping)

    def step(self, point: _Point) -> tuple[Floats, list[Floats], Floats]:
        """A damped Gauss-Newton step, and the standard errors."""
        problem = self.problem
        information, gradient, follow = self.reduce(point, _OF_STATES * self.damping)
        weight = 1.0 / problem.prior_std**2
        right = gradient + weight * (problem.prior_mean - point.theta)
        # Damped in units of the priors: weak combinations of known numbers may move that far and no more.
        matrix = information + np.diag((1.0 + self.damping) * weight)
        room = [np.where(self.held, 0.0, bound - point.theta) for bound in problem.bounds]
        move = bounded_solve(matrix, right, *room)
        states = [
            start + free - np.einsum("wsf,f->ws", slave, move[columns])
            for start, (free, slave), columns in zip(point.states, follow, problem.columns, strict=True)
        ]
        std = np.sqrt(np.diag(np.linalg.inv(matrix))) if len(move) else np.zeros(0)
        return move, states, std

    def descend(
        self, point: _Point, stage: str, share: tuple[float, float], most: int = 30
    ) -> tuple[_Point, bool]:
        """Step until steps are small."""
        growth, settled, idle = 2.0, False, 0
        for number in range(most):
            if self.on_progress is not None:
                done = share[0] + (share[1] - share[0]) * (1 - 0.5**number)
                self.on_progress(Progress(stage, done, point.cost))
            move, states, std = self.step(point)
            if self.out_of_budget():
                return point, False
            other = self.evaluate(point.theta + move, states)
            self.gather(other, point)
            small = not len(move) or bool(np.all(np.abs(move) < _SMALL_STEP * std))
            if not other.cost < point.cost * (1 + 1e-12):
                if not settled:
                    settled, nearer = True, self.reoptimise_states(point)
                    if nearer is not None:
                        point = nearer
                        continue
                if self.damping > _LARGEST_DAMPING or (small and len(move)):
                    return point, True
                self.damping = max(1.0, growth * self.damping)
                growth *= 2.0
                continue
            gain = (point.cost - other.cost) / max(other.cost, 1e-300)
            # After a rejected step the damping comes down slowly, or every second step is rejected.
            self.damping *= 0.2 if growth == 2.0 else 0.5
            self.damping = self.damping if self.damping > 0.05 else 0.0
            growth, settled, point = 2.0, False, other
            idle = idle + 1 if gain < (0.2 if self.fine else 1.0) * _IDLE_GAIN else 0
            if idle == 2 or (self.damping < 1.0 and (gain < 1e-6 or (small and gain < 1e-3))):
                return point, True
        return point, True


def solve(
    problem: Problem,
    *,
    start: Fit | Mapping[str, float] | None = None,
    budget: Budget | None = None,
    robust: bool = True,
    fine: bool = True,
    scatter: bool = True,
    on_progress: Callable[[Progress], None] | None = None,
) -> Fit:
    """Fit the free parameters and the windows' initial states.

    The squares of each axis are divided by their variance as `noise.inflation` estimates it from the
    residuals themselves, so that standard errors stay honest when the model is wrong or a count stands for
    many samples.

    Parameters
    ----------
    problem : Problem
        What to fit.
    start : Fit or Mapping[str, float], optional
        Where to start: an earlier fit, perhaps of another problem, or values by name; unknown names are
        passed over.
    budget : Budget, optional
        What it may cost.
    robust : bool
        Whether windows that fall out of line lose weight.
    fine : bool
        Finish on every sample, not on the coarse grid.
    scatter : bool
        Widen standard errors by what the rounding may do, which takes as long as two steps.
    on_progress : callable, optional
        Told where the fit is.

    Returns
    -------
    Fit
        The result, also when the budget ran out.

    Raises
    ------
    IdentifyError
        When the model cannot predict the flights at all from the start values.
    """
    solver = _Solver(problem, budget or Budget(), robust, on_progress)
    theta, states = _start(problem, start)
    solver.reference = [array.copy() for array in problem.first_states(theta)]
    point = solver.evaluate(theta, states)
    solver.reweight(point)
    if not math.isfinite(point.cost):
        raise IdentifyError(
            "the model's free run diverges from the start values; check the rig's numbers and units"
        )
    rounds = _ROUNDS
    converged = True
    searched = {name for effect in problem.model.effects for name in effect.multimodal}
    for number in range(rounds):
        # Beside sizes that are still wrong, a frequency or a moment would run away.
        solver.held[:] = [number < _ROUGH and one.quantity in searched for one in problem.free]
        share = (0.6 * number / rounds, 0.6 * (number + 1) / rounds)
        # Far from the answer the weights are rough: only the last rounds need small steps.
        point, finished = solver.descend(
            point, f"coarse fit, round {number + 1}", share, most=4 if number < _ROUGH else 30
        )
        converged = finished
        rescued = number in (2, 3) and finished and solver.rescue(point)
        solver.state_prior(point)
        change = solver.reweight(point)
        solver.damping = 0.0
        if not finished or (number >= _ROUGH - 1 + bool(searched) and change < _SETTLED and not rescued):
            break
    if fine and not solver.out_of_budget():
        solver.fine = True
        point = solver.evaluate(point.theta, point.states)
        solver.reweight(point)
        for number in range(_FINE_ROUNDS):
            share = (0.6 + 0.4 * number / _FINE_ROUNDS, 1.0)
            point, finished = solver.descend(point, "every sample", share, most=10)
            converged = converged and finished
            rescued = number < 2 and finished and solver.rescue(point)
            solver.state_prior(point)
            change = solver.reweight(point)
            if not finished or not (rescued or change >= _SETTLED):
                break
    return _result(solver, point, converged, scatter)


def _start(problem: Problem, start: Fit | Mapping[str, float] | None) -> tuple[Floats, list[Floats]]:
    theta = problem.start
    given = start.values if isinstance(start, Fit) else start or {}
    for index, name in enumerate(problem.names):
        if name in given:
            theta[index] = given[name]
    theta = np.clip(theta, *problem.bounds).astype(np.float64)
    states = problem.first_states(theta)
    if isinstance(start, Fit) and len(start.states) == len(states):
        # An effect's state and the rates beside it make up for each other: one without the other is worse
        # than neither.
        places = {state.name: i for i, state in enumerate(start.problem.model.states)}
        known = [(i, places[s.name]) for i, s in enumerate(problem.model.states) if s.name in places]
        for own, old in zip(states, start.states, strict=True):
            if len(own) == len(old):
                for new_place, old_place in known:
                    own[:, new_place] = old[:, old_place]
    return theta, states


def _result(solver: _Solver, point: _Point, converged: bool, scatter: bool) -> Fit:
    problem = solver.problem
    information, _, _ = solver.reduce(point)
    weight = np.diag(1.0 / problem.prior_std**2)
    covariance: Floats = np.linalg.inv(information + weight).astype(np.float64)
    if scatter and solver.fine and len(problem.free):
        rounded = quantisation_scatter(
            problem, point.theta, point.states, solver.variance, solver.weights, covariance
        )
        wider = np.maximum(1.0, rounded / np.sqrt(np.diag(covariance)))
        covariance = covariance * np.outer(wider, wider)
        covariance = covariance + np.diag(timing_variance(problem))
    low, high = problem.bounds
    bound = (point.theta <= low) | (point.theta >= high)
    return Fit(
        problem,
        point.theta,
        covariance,
        information,
        tuple(point.states),
        tuple(solver.variance),
        tuple(solver.weights),
        point.cost,
        tuple(name for name, there in zip(problem.names, bound, strict=True) if there),
        solver.evaluations,
        time.perf_counter() - solver.started_s,
        converged,
    )
