"""Fit a problem: searches for the minimum in turn with estimates of the noise, first on the coarse grid."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.errors import IdentifyError
from heli_lab.identify import thresholds
from heli_lab.identify.estimation_problem import Budget, Fit, FitProgress, Problem
from heli_lab.identify.estimation_problem.uncertainty import quantisation_scatter, timing_variance
from heli_lab.identify.shooting.multiple_shooting import MultipleShooting
from heli_lab.identify.shooting.schur import eliminate_states
from heli_lab.identify.shooting.shooting_cost import Iterate, ShootingCost
from heli_lab.identify.shooting.window_recovery import restart_outliers

_ROUGH_STEPS: Final = 4
"""Most steps of a rough round: more are lost when the weights change."""
_COARSE_STEPS: Final = 30
"""Most steps of a later round on the coarse grid, hardly ever reached."""
_FINE_STEPS: Final = 10
"""Most steps of a round on every sample: the coarse fit is near."""


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
    """Fit the free parameters and the windows' initial states; there is a result also when the budget ran
    out.

    The squares of each axis are divided by the long-run variance of its own residuals
    (`residual_noise.long_run_variance`). Standard errors are then not too small if the model is wrong, or if
    the same count stays for many samples.

    Parameters
    ----------
    start : Fit or Mapping[str, float], optional
        Where to start: an earlier fit, perhaps of another problem, or values by name; unknown names are
        passed over.
    robust : bool
        Whether outlying windows lose weight.
    fine : bool
        Finish on every sample, not on the coarse grid.
    scatter : bool
        Widen standard errors by the effect of quantisation, which takes as long as two steps.
    warm_start : bool
        The start is near, as where constants and initial states alone are free: one round on the coarse grid
        is enough.
    on_progress : callable, optional
        Called with the progress of the fit.

    Raises
    ------
    IdentifyError
        When the model cannot predict the flights at all from the start values.
    """
    cost = ShootingCost(problem, robust)
    shooting = MultipleShooting(cost, budget or Budget(), on_progress)
    theta, states = _start(cost, start)
    cost.state_prior = cost.initial_state_guess(theta)
    iterate = cost.evaluate(theta, states)
    cost.reweight(iterate)
    if not math.isfinite(iterate.cost):
        raise IdentifyError(
            "the model's free run diverges from the start values", "check the rig parameters and units"
        )
    rounds = thresholds.ROUNDS
    converged = True
    multimodal = {name for effect in problem.model.effects for name in effect.multimodal}
    for number in range(rounds):
        # While amplitudes are still wrong, a frequency or a moment would leave its basin of attraction.
        rough = number < thresholds.ROUGH_ROUNDS
        shooting.is_fixed[:] = [rough and parameter.quantity in multimodal for parameter in problem.free]
        words, share = f"coarse fit, round {number + 1}", (0.6 * number / rounds, 0.6 * (number + 1) / rounds)
        # Far from the solution the weights are rough: only later rounds need small steps.
        most = _ROUGH_STEPS if rough else _COARSE_STEPS
        iterate, converged, settled = _round(shooting, iterate, words, share, most, number in (2, 3))
        shooting.damping = 0.0
        enough = number >= thresholds.ROUGH_ROUNDS - 1 + bool(multimodal)
        if warm_start or not converged or (enough and settled):
            break
    if fine and not shooting.is_out_of_budget():
        cost.fine = True
        iterate = cost.evaluate(iterate.theta, iterate.states)
        cost.reweight(iterate)
        for number in range(thresholds.FINE_ROUNDS):
            share = (0.6 + 0.4 * number / thresholds.FINE_ROUNDS, 1.0)
            iterate, finished, settled = _round(
                shooting, iterate, "every sample", share, _FINE_STEPS, number < 2
            )
            converged = converged and finished
            if settled or not finished:
                break
    return _result(shooting, iterate, converged, scatter)


def _round(
    shooting: MultipleShooting,
    iterate: Iterate,
    words: str,
    share: tuple[float, float],
    most_steps: int,
    restart: bool,
) -> tuple[Iterate, bool, bool]:
    """Search the minimum, and estimate the weights again: the iterate, whether the search finished, and
    whether the weights stay. `words` and `share` report the progress; `restart` allows other initial states.
    """
    cost = shooting.cost
    iterate, finished = shooting.descend(iterate, words, share, most_steps)
    restarted = restart and finished and restart_outliers(cost, iterate)
    cost.update_state_prior(iterate)
    change = cost.reweight(iterate)
    return iterate, finished, change < thresholds.SETTLED_CHANGE and not restarted


def _start(cost: ShootingCost, start: Fit | Mapping[str, float] | None) -> tuple[Floats, list[Floats]]:
    problem = cost.problem
    given = start.values if isinstance(start, Fit) else start or {}
    theta = problem.parameter_vector.started_from(given)
    states = cost.initial_state_guess(theta)
    if isinstance(start, Fit) and len(start.states) == len(states):
        # An effect's state and the rates beside it compensate for each other: one without the other is worse
        # than neither.
        places = {state.name: i for i, state in enumerate(start.problem.model.states)}
        known = [(i, places[s.name]) for i, s in enumerate(problem.model.states) if s.name in places]
        for new, old in zip(states, start.states, strict=True):
            if len(new) == len(old):
                for new_place, old_place in known:
                    new[:, new_place] = old[:, old_place]
    return theta, states


def _result(shooting: MultipleShooting, iterate: Iterate, converged: bool, scatter: bool) -> Fit:
    cost, problem = shooting.cost, shooting.cost.problem
    information, *_ = eliminate_states(cost, iterate)
    weight = np.diag(1.0 / problem.parameter_vector.std**2)
    covariance: Floats = np.linalg.inv(information + weight).astype(np.float64)
    if scatter and cost.fine and len(problem.free):
        scattered = quantisation_scatter(
            problem, iterate.theta, iterate.states, cost.variance, cost.weights, covariance
        )
        wider = np.maximum(1.0, scattered / np.sqrt(np.diag(covariance)))
        covariance = covariance * np.outer(wider, wider)
        covariance = covariance + np.diag(timing_variance(problem))
    low, high = problem.parameter_vector.bounds
    bound = (iterate.theta <= low) | (iterate.theta >= high)
    return Fit(
        problem,
        iterate.theta,
        covariance,
        information,
        tuple(iterate.states),
        tuple(cost.variance),
        tuple(cost.weights),
        iterate.cost,
        tuple(name for name, there in zip(problem.names, bound, strict=True) if there),
        cost.evaluations,
        time.perf_counter() - shooting.started_s,
        converged,
    )
