"""Evidence is the logarithm of a ratio of Gaussian likelihoods; the threshold gives the stated alarm rate."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.watch.calibration import SEGMENT_s, Tail, fit_tail
from heli_lab.watch.disturbances import DETECTABLE_WITHIN_s, at_least_rounding
from heli_lab.watch.learn import Draws
from heli_lab.watch.likelihood_ratio import (
    CUT_OFF_STD,
    KEPT,
    ONSETS,
    RECENT,
    ChangeCandidate,
    Innovation,
    LikelihoodRatio,
)
from heli_lab.watch.twin_model import Change, all_changes
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig, load_rig
from scipy.integrate import solve_ivp

from tests.estimation.pendulum import log_density

CHANGES = all_changes()
COUNT_rad = np.full(3, 2 * np.pi / 4096)
COLUMNS = sum(len(change.parameters) for change in CHANGES)
ORDER = 4
"""Order of the filter's state; any number will do, because no filter runs here."""


def change_of(name: str) -> Change:
    (change,) = (change for change in CHANGES if change.id == name)
    return change


def columns_of(name: str) -> slice:
    """Return the columns of the sensitivities that belong to a change."""
    first = 0
    for change in CHANGES:
        if change.id == name:
            return slice(first, first + len(change.parameters))
        first += len(change.parameters)
    raise KeyError(name)


def candidate_of(ratio: LikelihoodRatio, name: str) -> ChangeCandidate:
    (candidate,) = (candidate for candidate in ratio.ranking() if candidate.change.id == name)
    return candidate


def ratio_with_one_onset(innovations: np.ndarray, sensitivities: np.ndarray) -> LikelihoodRatio:
    """Return the ratio after `innovations`, (n, 3), with `sensitivities`, (n, 3, columns). The only onset is
    before the first innovation.
    """
    ratio = LikelihoodRatio(CHANGES, COUNT_rad)
    ratio.begin_onset(0, np.zeros((ORDER, COLUMNS, ONSETS)))
    for value, sensitivity in zip(innovations, sensitivities, strict=True):
        ratio.update(Innovation(value, np.repeat(sensitivity[:, :, None], ONSETS, axis=2)))
    return ratio


@pytest.mark.parametrize("name", ["thrust_step.front", "cable_spring.travel"])
def test_evidence_is_the_ratio_of_two_gaussian_densities(name: str) -> None:
    rng = np.random.default_rng(1)
    innovations, sensitivities = rng.normal(size=(6, 3)), rng.normal(size=(6, 3, COLUMNS))
    ratio = ratio_with_one_onset(innovations, sensitivities)
    response = sensitivities[:, :, columns_of(name)].reshape(18, -1)
    # A change whose size is normal with the prior's variance adds to the covariance of the white innovations.
    prior_covariance = np.diag(np.square(change_of(name).sizes))
    covariance_with_change = np.eye(18) + response @ prior_covariance @ response.T
    log_density_with_change = log_density(innovations.ravel(), covariance_with_change)
    log_density_without_change = log_density(innovations.ravel(), np.eye(18))
    expected_nats = log_density_with_change - log_density_without_change
    assert candidate_of(ratio, name).log_evidence == pytest.approx(expected_nats)


def test_a_scale_in_flight_needs_more_evidence_than_one_from_the_start() -> None:
    """A decoder that counts half the edges is there from the start; in flight, few lines get lost."""
    name, blocks, std = "encoder_scale.travel", 100, 0.1
    sensitivities = np.zeros((blocks, 3, COLUMNS))
    sensitivities[:, 2, columns_of(name)] = blocks**-0.5 / std
    ratio = ratio_with_one_onset(-0.4 * sensitivities[:, :, columns_of(name)][:, :, 0], sensitivities)
    in_flight = candidate_of(ratio, name)
    from_start = next(entry for entry in ratio.ranking(from_start=True) if entry.change.id == name)
    # The likelihood alone has the size -0.4 and 8 nats.
    assert from_start.size == pytest.approx(-0.4, rel=0.05) and from_start.log_evidence > 5.0
    assert in_flight.size > -0.05 and in_flight.log_evidence < 1.0


def test_the_evidence_of_a_positive_change_is_an_integral_over_positive_sizes() -> None:
    rng = np.random.default_rng(2)
    innovations, sensitivities = rng.normal(size=(5, 3)), rng.normal(size=(5, 3, COLUMNS))
    name = "coulomb_friction.pitch"
    ratio = ratio_with_one_onset(innovations, sensitivities)
    response = sensitivities[:, :, columns_of(name)].ravel()
    prior_std = change_of(name).sizes[0]
    sizes = np.linspace(0, 8 * prior_std, 20_001)
    half_normal_prior = 2 * np.exp(-0.5 * (sizes / prior_std) ** 2) / prior_std / math.sqrt(2 * np.pi)
    likelihood_ratio = np.exp(
        sizes * (response @ innovations.ravel()) - 0.5 * sizes**2 * (response @ response)
    )
    expected_nats = math.log(float(np.trapezoid(half_normal_prior * likelihood_ratio, sizes)))
    assert candidate_of(ratio, name).log_evidence == pytest.approx(expected_nats, abs=1e-4)


def test_size_and_standard_error_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(3)
    name, true_size = "thrust_step.back", 0.2
    # So large that the prior hardly counts.
    sensitivities = 30.0 * rng.normal(size=(40, 3, COLUMNS))
    response = sensitivities[:, :, columns_of(name)][..., 0]
    innovations = true_size * response + rng.normal(size=(40, 3))
    most_likely = ratio_with_one_onset(innovations, sensitivities).ranking()[0]
    information = np.sum(response**2)
    assert most_likely.change.id == name
    assert most_likely.size == pytest.approx(np.sum(response * innovations) / information, rel=2e-3)
    assert most_likely.std == pytest.approx(information**-0.5, rel=2e-3)


def test_the_window_keeps_the_most_likely_onset_of_each_half_second() -> None:
    onset_block = 2 * RECENT + 5
    ratio = LikelihoodRatio(CHANGES, COUNT_rad)
    state_sensitivity = np.zeros((ORDER, COLUMNS, ONSETS))
    rng = np.random.default_rng(4)
    for block in range(1, 6 * RECENT):
        has_begun = np.where(ratio.ages(block) > 0, 1.0, 0.0)
        sensitivity = 5.0 * np.broadcast_to(has_begun, (3, COLUMNS, ONSETS))
        jump = 2.0 if block > onset_block else 0.0
        ratio.update(Innovation(rng.normal(size=3) + jump, sensitivity))
        ratio.begin_onset(block, state_sensitivity)
    assert abs(candidate_of(ratio, "thrust_step.front").onset_block - onset_block) <= 3


def test_the_window_is_longer_than_14_s() -> None:
    assert KEPT * RECENT * BLOCK_s > 14.0


@pytest.mark.medium
def test_a_threshold_from_few_excesses_gives_the_stated_rate() -> None:
    """The maxima are exponential above a level, so that the true rate of alarms at a threshold is known."""
    rng = np.random.default_rng(5)
    level_nats, scale_nats, segments_per_hour = 4.0, 1.5, 3600.0 / SEGMENT_s
    rates_per_hour = []
    for _ in range(150):
        # One maximum per segment. The first one is at 0 s, the others are after the beginning of a segment.
        history = [
            (SEGMENT_s * segment + (segment > 0), level_nats + scale_nats * rng.exponential())
            for segment in range(100)
        ]
        threshold_nats = fit_tail([history]).threshold_nats(1.0)
        rates_per_hour.append(segments_per_hour * math.exp(-(threshold_nats - level_nats) / scale_nats))
    # The bounds allow for two known errors: the level is estimated, and the scale has a lower bound.
    assert 0.75 < float(np.mean(rates_per_hour)) < 1.3


def test_no_threshold_is_below_the_level() -> None:
    tail = Tail(level_nats=5.0, per_hour=100.0, scale_nats=2.0, excesses=20)
    assert tail.threshold_nats(1e-6) == 5.0


def test_half_a_minute_supports_one_false_alarm_per_hour() -> None:
    """A user who asks for rarer false alarms gets the threshold of the supported rate."""
    tail = Tail(level_nats=5.0, per_hour=100.0, scale_nats=1.5, excesses=30, healthy_s=30.0)
    assert tail.supported_interval_h == pytest.approx(1.0)
    assert tail.threshold_nats(10.0) == tail.threshold_nats(1.0) > tail.threshold_nats(0.5)


def test_an_uncertain_tail_has_a_higher_threshold() -> None:
    """The rate of alarms is averaged over the possible tails, to which heavy tails contribute most. Many
    excesses leave a single tail.
    """
    few = Tail(level_nats=5.0, per_hour=100.0, scale_nats=1.5, excesses=5)
    many = Tail(level_nats=5.0, per_hour=100.0, scale_nats=1.5, excesses=100_000)
    assert many.threshold_nats(1.0) == pytest.approx(5.0 + 1.5 * math.log(100.0), rel=1e-2)
    assert few.threshold_nats(1.0) > many.threshold_nats(1.0) + 1.0


def test_two_large_excesses_give_a_bounded_threshold() -> None:
    """Without a prior of the shape, two outliers give thresholds of thousands of nats."""
    maxima_nats = [3.0 + 0.01 * (segment % 10) for segment in range(60)]
    maxima_nats[7], maxima_nats[31] = 20.0, 30.0
    history = [(SEGMENT_s * segment + 1.0, nats) for segment, nats in enumerate(maxima_nats)]
    assert fit_tail([history], 300.0).threshold_nats(10.0) < 100.0


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
