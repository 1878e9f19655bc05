"""Disturbances learned from calm flights are at least those that the quantisation hides."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.estimation import DisturbanceModel
from heli_lab.twin.changes import all_changes
from heli_lab.twin.draws import Draws
from heli_lab.twin.learn import DETECTABLE_WITHIN_s, at_least_rounding
from heli_lab.twin.likelihood_ratio import ONSETS, Innovation, LikelihoodRatio
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import derivatives, trim
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig, load_rig
from scipy.integrate import solve_ivp

COUNT_rad = np.full(3, 2 * np.pi / 4096)
ROUNDING_rad = COUNT_rad / np.sqrt(12.0)
CALM = DisturbanceModel(np.full(3, 2e-5), np.full(3, 0.03), np.full(3, 2e-5), np.array([0.02, 0.5, 1.7]))


def floored(disturbances: DisturbanceModel) -> DisturbanceModel:
    return at_least_rounding(disturbances, MultibodyModel(), load_rig("makki2024"), COUNT_rad)


def moved_rad(rig: Rig, axis: int, torque_Nm: float) -> float:
    """How far a torque moves an axis from hover within `DETECTABLE_WITHIN_s`, by the equations of motion."""
    model = MultibodyModel()
    hover = trim(model, rig)
    pushed = rig.replace(**{f"torque_{AXES[axis]}": rig[f"torque_{AXES[axis]}"].value + torque_Nm})
    run = solve_ivp(
        lambda _, state: derivatives(model, pushed, state, hover.volts_V).rates,
        (0, DETECTABLE_WITHIN_s),
        hover.state,
    )
    return float(run.y[axis, -1] - hover.state[axis])


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_the_least_gust_moves_its_axis_by_the_rounding(axis: int) -> None:
    least = floored(CALM)
    moved = moved_rad(load_rig("makki2024"), axis, float(least.fast_std[axis]))
    # Pitch is a pendulum and damped: in half a second that takes a fifth.
    assert 0.75 * ROUNDING_rad[axis] < moved < 1.05 * ROUNDING_rad[axis]
    assert least.correlation_time_s[axis] == DETECTABLE_WITHIN_s


def test_rounding_is_no_less_than_that_of_an_encoder() -> None:
    assert floored(CALM).quantisation.tolist() == [1.0, 1.0, 1.7]


def test_visible_disturbances_are_kept_as_estimated() -> None:
    room = DisturbanceModel(
        np.array([0.006, 0.002, 0.004]), np.array([0.3, 1.2, 0.6]), np.full(3, 1e-3), np.full(3, 1.2)
    )
    found = floored(room)
    assert np.array_equal(found.fast_std, room.fast_std) and np.array_equal(
        found.correlation_time_s, room.correlation_time_s
    )
    assert np.array_equal(found.slow_std, room.slow_std)


def test_a_gust_too_short_to_show_is_raised_too() -> None:
    """Three times the least for a thirtieth of the time moves an axis less than the least does."""
    short = DisturbanceModel(
        3.0 * floored(CALM).fast_std, np.full(3, DETECTABLE_WITHIN_s / 30), CALM.slow_std, np.ones(3)
    )
    assert np.array_equal(floored(short).fast_std, floored(CALM).fast_std)
    long = DisturbanceModel(
        3.0 * floored(CALM).fast_std, np.full(3, DETECTABLE_WITHIN_s / 10), CALM.slow_std, np.ones(3)
    )
    assert np.array_equal(floored(long).fast_std, long.fast_std)


def test_draws_are_pieces_of_the_innovations_without_kicks() -> None:
    rng = np.random.default_rng(7)
    innovations = rng.normal(size=(2000, 3))
    innovations = np.clip(innovations, -3.5, 3.5)
    innovations[900:903, 1] = 12.0, -9.0, 6.0
    draws = Draws([innovations], 50, np.random.default_rng(8))
    drawn = np.array([draws.next() for _ in range(400)])
    assert drawn.shape == (400, 50, 3)
    # The kick is an event of its own; days differ by a tenth.
    assert np.abs(drawn).max() < 3.5 * np.exp(4 * 0.1)
    assert np.allclose(np.sqrt(np.mean(drawn**2, axis=(0, 1))), 1.0, atol=0.1)
    # Both signs of each piece occur, so a mean that a flight happens to have is not kept.
    assert np.all(np.abs(drawn.mean(axis=(0, 1))) < 0.1)


def test_draws_followed_together_have_the_evidence_of_each_alone() -> None:
    rng = np.random.default_rng(9)
    changes = all_changes()
    columns = sum(len(change.numbers) for change in changes)
    values = rng.normal(size=(10, 4, 3))
    sensitivity = rng.normal(size=(10, 3, columns, ONSETS))
    together = LikelihoodRatio(changes, COUNT_rad, 4)
    alone = [LikelihoodRatio(changes, COUNT_rad) for _ in range(4)]
    for block in range(10):
        for ratio in (together, *alone):
            ratio.begin_onset(block, np.zeros((2, columns, ONSETS)))
        each = [
            ratio.update(Innovation(values[block, draw], sensitivity[block]))
            for draw, ratio in enumerate(alone)
        ]
        assert np.allclose(together.update_draws(values[block], sensitivity[block]), each)
