"""Learning: disturbances that an encoder cannot show are raised, and evidence is drawn along a flight."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.learn import DETECTABLE_WITHIN_s, Draws, at_least_rounding
from heli_lab.watch.likelihood_ratio import CUT_OFF_STD, ONSETS, Innovation, LikelihoodRatio
from heli_lab.watch.twin_model import all_changes
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import derivatives, trim
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig, load_rig
from scipy.integrate import solve_ivp

COUNT_rad = np.full(3, 2 * np.pi / 4096)
ROUNDING_STD_rad = COUNT_rad / np.sqrt(12.0)
CALM = DisturbanceModel(
    fast_std=np.full(3, 2e-5),
    correlation_time_s=np.full(3, 0.03),
    slow_std=np.full(3, 2e-5),
    quantisation=np.array([0.02, 0.5, 1.7]),
)
"""Estimates from a flight without disturbances, all below the smallest detectable ones."""


def with_lower_bound(disturbances: DisturbanceModel) -> DisturbanceModel:
    return at_least_rounding(disturbances, MultibodyModel(), load_rig("makki2024"), COUNT_rad)


def motion_rad(rig: Rig, axis: int, torque_Nm: float) -> float:
    """Integrate the equations of motion from hover with an additional torque, and return how far the axis
    moves within `DETECTABLE_WITHIN_s` [rad].
    """
    model = MultibodyModel()
    hover = trim(model, rig)
    torque_name = f"torque_{AXES[axis]}"
    rig_with_torque = rig.replace(**{torque_name: rig[torque_name].value + torque_Nm})
    solution = solve_ivp(
        lambda _, state: derivatives(model, rig_with_torque, state, hover.volts_V).rates,
        (0, DETECTABLE_WITHIN_s),
        hover.state,
    )
    return float(solution.y[axis, -1] - hover.state[axis])


@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_the_smallest_gust_moves_its_axis_by_the_rounding(axis: int) -> None:
    smallest = with_lower_bound(CALM)
    moved_rad = motion_rad(load_rig("makki2024"), axis, float(smallest.fast_std[axis]))
    # Pitch is a damped pendulum, which moves a fifth less in half a second than a free axis.
    assert 0.75 * ROUNDING_STD_rad[axis] < moved_rad < 1.05 * ROUNDING_STD_rad[axis]
    assert smallest.correlation_time_s[axis] == DETECTABLE_WITHIN_s


def test_rounding_is_at_least_that_of_an_encoder() -> None:
    assert with_lower_bound(CALM).quantisation.tolist() == [1.0, 1.0, 1.7]


def test_detectable_disturbances_stay_as_estimated() -> None:
    estimated = DisturbanceModel(
        fast_std=np.array([0.006, 0.002, 0.004]),
        correlation_time_s=np.array([0.3, 1.2, 0.6]),
        slow_std=np.full(3, 1e-3),
        quantisation=np.full(3, 1.2),
    )
    bounded = with_lower_bound(estimated)
    for name in ("fast_std", "correlation_time_s", "slow_std"):
        assert np.array_equal(getattr(bounded, name), getattr(estimated, name))


@pytest.mark.parametrize(("shortening", "is_raised"), [(30, True), (10, False)])
def test_a_short_gust_needs_more_torque_to_be_detectable(shortening: int, is_raised: bool) -> None:
    """A gust with three times the smallest detectable torque moves an axis too little if it is 30 times
    shorter, and enough if it is 10 times shorter.
    """
    smallest = with_lower_bound(CALM)
    short = DisturbanceModel(
        fast_std=3.0 * smallest.fast_std,
        correlation_time_s=np.full(3, DETECTABLE_WITHIN_s / shortening),
        slow_std=CALM.slow_std,
        quantisation=np.ones(3),
    )
    expected = smallest if is_raised else short
    assert np.array_equal(with_lower_bound(short).fast_std, expected.fast_std)


def test_draws_are_pieces_of_the_innovations_without_kicks() -> None:
    innovations = np.clip(np.random.default_rng(7).normal(size=(2000, 3)), -3.5, 3.5)
    innovations[900:903, 1] = 12.0, -9.0, 6.0  # a kick
    assert np.abs(innovations[900:903, 1]).min() > CUT_OFF_STD
    draws = Draws([innovations], 50, np.random.default_rng(8))
    drawn = np.array([draws.next() for _ in range(400)])
    assert drawn.shape == (400, 50, 3)
    # Each draw has its own scale, with a standard deviation of a tenth: no value of the kick is among them.
    assert np.abs(drawn).max() < 3.5 * np.exp(4 * 0.1)
    assert np.allclose(np.sqrt(np.mean(drawn**2, axis=(0, 1))), 1.0, atol=0.1)
    # Each piece occurs with both signs, so that the mean of a single flight has no effect.
    assert np.all(np.abs(drawn.mean(axis=(0, 1))) < 0.1)


def test_parallel_draws_have_the_evidence_of_separate_ones() -> None:
    rng = np.random.default_rng(9)
    changes = all_changes()
    columns = sum(len(change.parameters) for change in changes)
    blocks, draws, order = 10, 4, 2
    values = rng.normal(size=(blocks, draws, 3))
    sensitivity = rng.normal(size=(blocks, 3, columns, ONSETS))
    parallel = LikelihoodRatio(changes, COUNT_rad, draws)
    separate = [LikelihoodRatio(changes, COUNT_rad) for _ in range(draws)]
    for block in range(blocks):
        for ratio in (parallel, *separate):
            ratio.begin_onset(block, np.zeros((order, columns, ONSETS)))
        expected_nats = [
            ratio.update(Innovation(values[block, draw], sensitivity[block]))
            for draw, ratio in enumerate(separate)
        ]
        assert np.allclose(parallel.update_draws(values[block], sensitivity[block]), expected_nats)
