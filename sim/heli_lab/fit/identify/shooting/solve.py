"""Fit a problem by multiple shooting: search for the minimum and estimate the noise in turn.

The fit begins on the coarse grid, which is cheap, and ends on every sample.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.errors import IdentifyError
from heli_lab.fit.identify import thresholds
from heli_lab.fit.identify.estimation_problem import Budget, Fit, FitProgress, Problem
from heli_lab.fit.identify.estimation_problem.uncertainty import quantisation_scatter, timing_variance
from heli_lab.fit.identify.shooting.multiple_shooting import MultipleShooting
from heli_lab.fit.identify.shooting.schur import eliminate_states
from heli_lab.fit.identify.shooting.shooting_cost import Iterate, ShootingCost
from heli_lab.fit.identify.shooting.window_recovery import restart_outliers

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
    (`residual_noise.long_run_variance`). Standard errors are then not too small if the model is wrong, or if
    the same count stays for many samples.

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
        work_done = (_COARSE_SHARE * number / round_count, _COARSE_SHARE * (number + 1) / round_count)
        max_steps = _ROUGH_STEPS if is_rough else _COARSE_STEPS
        stage = f"coarse fit, round {number + 1}"
        last = _fit_round(shooting, iterate, stage, work_done, max_steps, restart=number in _RESTART_ROUNDS)
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
        work_done = (_COARSE_SHARE + (1.0 - _COARSE_SHARE) * number / round_count, 1.0)
        last = _fit_round(shooting, iterate, "every sample", work_done, _FINE_STEPS, restart=number < 2)
        iterate = last.iterate
        if last.weights_settled or shooting.is_out_of_budget():
            break
    return last


def _fit_round(
    shooting: MultipleShooting,
    iterate: Iterate,
    stage: str,
    work_done: tuple[float, float],
    max_steps: int,
    *,
    restart: bool,
) -> _RoundResult:
    """Search for the minimum from an `iterate`, then estimate weights and state priors again."""
    cost = shooting.cost
    iterate, search_converged = shooting.descend(iterate, stage, work_done, max_steps)
    restarted = restart and not shooting.is_out_of_budget() and restart_outliers(cost, iterate)
    cost.update_state_prior(iterate)
    change = cost.reweight(iterate)
    return _RoundResult(iterate, search_converged, change < thresholds.SETTLED_CHANGE and not restarted)


def _start_point(cost: ShootingCost, start: Fit | Mapping[str, float] | None) -> tuple[Floats, list[Floats]]:
    """Return start values of the free parameters, shape (f,), and the initial states of each record's
    windows, shape (w, states).
    """
    problem = cost.problem
    values = start.values if isinstance(start, Fit) else start or {}
    theta = problem.parameter_vector.started_from(values)
    states = cost.initial_state_guess(theta)
    if isinstance(start, Fit) and len(start.states) == len(states):
        _copy_states(start, problem, states)
    return theta, states


def _copy_states(start: Fit, problem: Problem, states: list[Floats]) -> None:
    """Copy the initial states of an earlier fit into `states`, for the states and windows that both have.

    An effect's state is copied together with the rates of the arm, because the two compensate for each other.
    """
    old_columns = {state.name: column for column, state in enumerate(start.problem.model.states)}
    for new_column, state in enumerate(problem.model.states):
        if state.name not in old_columns:
            continue
        for new, old in zip(states, start.states, strict=True):
            if len(new) == len(old):
                new[:, new_column] = old[:, old_columns[state.name]]


def _collect_fit(shooting: MultipleShooting, iterate: Iterate, converged: bool, scatter: bool) -> Fit:
    """Compute the covariance of the estimates, and collect the result of the fit."""
    cost, problem = shooting.cost, shooting.cost.problem
    information = eliminate_states(cost, iterate).information
    prior_information = np.diag(1.0 / problem.parameter_vector.std**2)
    covariance: Floats = np.linalg.inv(information + prior_information).astype(np.float64)
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
