"""Gusts are told from causes: the filter against dense algebra, and flights with one or the other hidden."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from heli_sim.diagnose import Diagnosis, diagnose
from heli_sim.diagnose.chance import dependences, one_axis
from heli_sim.diagnose.coloured import Colour, Filter, coloured
from heli_sim.diagnose.hypothesis import Bench
from heli_sim.identify import Fit, Problem, prepare, solve
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
    fit, held = flights(_GUST)
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held], labels=["fit", "held out"])


def _dense(fit: Fit, size_Nm: np.ndarray, memory_s: float) -> float:
    """Logarithm of the likelihood of the first window's errors, all of them in one normal distribution."""
    filter_ = Filter(fit)
    blocks = int(filter_.alive[:, 0].sum())
    keep = np.exp(-filter_.step_s / memory_s)
    nx = filter_.over.shape[2]
    # Everything that is random: the initial state and torque, and what joins the torque in each block.
    count = nx + 3 + 3 * blocks
    state = np.zeros((nx + 3, count))
    state[range(nx + 3), range(nx + 3)] = 1.0
    rows = []
    for k in range(blocks):
        rows.append(filter_.see[k, 0] @ state)
        torque = keep * state[nx:]
        torque[:, nx + 3 + 3 * k : nx + 6 + 3 * k] += np.sqrt(1.0 - keep**2) * np.eye(3)
        state = np.vstack((filter_.over[k, 0] @ state, torque))
    std = np.concatenate(([0.02] * 3, [0.3] * (nx - 3), np.tile(size_Nm, blocks + 1)))
    mixing = np.vstack(rows) * std
    covariance = mixing @ mixing.T + 0.3 * np.eye(3 * blocks)
    tangent = filter_.tangents[0]
    errors = tangent.residual[tangent.windows[0]][: 4 * blocks].reshape(blocks, 4, 3).mean(axis=1)
    return float(multivariate_normal.logpdf(errors.ravel(), cov=covariance))


def test_filter_gives_the_likelihood_that_dense_algebra_gives() -> None:
    fit = _fit()
    size_Nm, memory_s = np.array([0.01, 0.003, 0.02]), 0.4
    filter_ = Filter(fit)
    blocks = int(filter_.alive[:, 0].sum())
    innovations, _ = filter_.innovations(size_Nm, memory_s)
    # The first window alone: rows are sorted by block, then by window.
    place = np.repeat(np.argwhere(filter_.alive)[:, 1] == 0, 3)
    error = innovations[place, len(fit.theta)]
    other = Filter(fit)
    other.alive[:, 1:] = False
    _, logarithm = other.innovations(size_Nm, memory_s)
    found = -0.5 * (error @ error + logarithm + 3 * blocks * np.log(2.0 * np.pi))
    assert found == pytest.approx(_dense(fit, size_Nm, memory_s), abs=1e-3)


def test_gust_is_a_random_torque_of_its_size_and_nothing_that_imitates_it() -> None:
    numbers = _gust().json()
    assert numbers["verdict"] == "cause_found"
    (cause,) = numbers["causes"]
    assert cause["effect"] == "random_torque.travel"
    size = cause["parameters"]["random_torque_travel_Nm"]
    assert abs(size["value"] - 0.03) < 3.0 * size["std"]


def test_gust_depends_on_nothing_and_pushes_about_one_axis() -> None:
    search = _gust().search
    assert search.chance is not None
    colour, filter_ = search.chance
    axis, lost, gained = one_axis(filter_, colour)
    assert axis == "travel"
    assert gained > 1000.0
    assert lost < 15.0
    assert not [one.what for one in dependences(filter_, colour) if one.gain > one.price]


def test_what_is_missing_and_no_gust_is_foretold_by_what_it_depends_on() -> None:
    rig = load_rig("makki2024")
    fit, held = (prepare(one, rig, name) for one, name in zip(flights(off_list=True), "ab", strict=True))
    bench = Bench(MultibodyModel(), rig, [fit], [held])
    colour, filter_ = coloured(bench, bench.try_out([]))
    first, *_ = dependences(filter_, colour)
    assert first.what == "torque.pitch on elevation"
    assert first.gain > 2.0 * first.price


def test_likeliest_torques_beat_their_neighbours() -> None:
    filter_ = Filter(_fit())
    best = filter_.likeliest()
    for factor in (0.7, 1.4):
        other = Colour(0.0, best.size_Nm * np.array([1.0, 1.0, factor]), best.memory_s)
        assert filter_.likelihood(other.size_Nm, other.memory_s)[0] < best.likelihood
