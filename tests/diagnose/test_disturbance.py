"""Disturbances are told from causes: the coloured-noise model, and flights with one or the other hidden."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from heli_lab.diagnose import Diagnosis, diagnose, to_json
from heli_lab.diagnose.model_comparison import Comparison
from heli_lab.diagnose.noise_model import DisturbanceModel, InnovationsFilter, fit_disturbance
from heli_lab.diagnose.whiteness import best_single_axis, score_dependences
from heli_lab.identify import Fit, Problem, prepare, solve
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig
from scipy.stats import multivariate_normal

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

_GUST = "random_torque.travel=0.03"


@cache
def _fit() -> Fit:
    rig = load_rig("makki2024")
    return solve(Problem(MultibodyModel(), rig, [prepare(flights(_GUST)[0], rig)]))


@cache
def _gust() -> Diagnosis:
    fit, held_out = flights(_GUST)
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], labels=["fit", "held out"])


def _dense(fit: Fit, sigma_Nm: np.ndarray, correlation_time_s: float) -> float:
    """Log-likelihood of the first window's errors, all of them in one normal distribution."""
    innovations_filter = InnovationsFilter(fit)
    blocks = int(innovations_filter.alive[:, 0].sum())
    rho = np.exp(-innovations_filter.step_s / correlation_time_s)
    nx = innovations_filter.Phi.shape[2]
    # Everything that is random: the initial state and torque, and what joins the torque in each block.
    count = nx + 3 + 3 * blocks
    state = np.zeros((nx + 3, count))
    state[range(nx + 3), range(nx + 3)] = 1.0
    rows = []
    for k in range(blocks):
        rows.append(innovations_filter.C[k, 0] @ state)
        torque = rho * state[nx:]
        torque[:, nx + 3 + 3 * k : nx + 6 + 3 * k] += np.sqrt(1.0 - rho**2) * np.eye(3)
        moved = innovations_filter.Phi[k, 0] @ state[:nx] + innovations_filter.Gamma[k, 0] @ state[nx:]
        state = np.vstack((moved, torque))
    std = np.concatenate(([0.02] * 3, [0.3] * (nx - 3), np.tile(sigma_Nm, blocks + 1)))
    mixing = np.vstack(rows) * std
    covariance = mixing @ mixing.T + 0.3 * np.eye(3 * blocks)
    linearisation = innovations_filter.linearisations[0]
    errors = linearisation.residual[linearisation.windows[0]][: 4 * blocks]
    errors = errors.reshape(blocks, 4, 3).mean(axis=1)
    return float(multivariate_normal.logpdf(errors.ravel(), cov=covariance))


def test_innovations_give_the_likelihood_that_dense_algebra_gives() -> None:
    fit = _fit()
    sigma_Nm, correlation_time_s = np.array([0.01, 0.003, 0.02]), 0.4
    innovations_filter = InnovationsFilter(fit)
    blocks = int(innovations_filter.alive[:, 0].sum())
    innovations, _ = innovations_filter.innovations(sigma_Nm, correlation_time_s)
    # The first window alone: rows are sorted by block, then by window.
    place = np.repeat(np.argwhere(innovations_filter.alive)[:, 1] == 0, 3)
    error = innovations[place, len(fit.theta)]
    other = InnovationsFilter(fit)
    other.alive[:, 1:] = False
    _, log_determinant = other.innovations(sigma_Nm, correlation_time_s)
    found = -0.5 * (error @ error + log_determinant + 3 * blocks * np.log(2.0 * np.pi))
    assert found == pytest.approx(_dense(fit, sigma_Nm, correlation_time_s), abs=1e-3)


def test_gust_is_a_random_torque_of_its_size_and_nothing_that_imitates_it() -> None:
    numbers = to_json(_gust())
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "random_torque.travel"
    sigma = cause["parameters"]["random_torque_travel_Nm"]
    assert abs(sigma["value"] - 0.03) < 3.0 * sigma["std"]


def test_innovations_of_a_gust_are_white_and_it_acts_about_one_axis() -> None:
    disturbance = _gust().search.disturbance
    assert disturbance is not None
    axis, loss, gain = best_single_axis(disturbance)
    assert axis == "travel"
    assert gain > 1000.0
    assert loss < 15.0
    dependences = score_dependences(disturbance)
    assert not [one.what for one in dependences if one.log_likelihood_gain > one.penalty]


def test_innovations_of_unmodelled_dynamics_correlate_with_what_these_depend_on() -> None:
    rig = load_rig("makki2024")
    fit, held_out = (prepare(one, rig, name) for one, name in zip(flights(off_list=True), "ab", strict=True))
    comparison = Comparison(MultibodyModel(), rig, [fit], [held_out])
    first, *_ = score_dependences(fit_disturbance(comparison, comparison.refit([])))
    assert first.what == "torque.pitch on elevation"
    assert first.log_likelihood_gain > 2.0 * first.penalty


def test_estimated_torques_are_likelier_than_their_neighbours() -> None:
    innovations_filter = InnovationsFilter(_fit())
    best = innovations_filter.estimate()
    for factor in (0.7, 1.4):
        other = DisturbanceModel(0.0, best.sigma_Nm * np.array([1.0, 1.0, factor]), best.correlation_time_s)
        likelihood = innovations_filter.log_likelihood(other.sigma_Nm, other.correlation_time_s)[0]
        assert likelihood < best.log_likelihood
