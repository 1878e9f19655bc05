"""Evidence is the logarithm of a ratio of Gaussian likelihoods; alarms come as often as stated."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_lab.twin.changes import all_changes
from heli_lab.twin.likelihood_ratio import KEPT, ONSETS, RECENT, Innovation, LikelihoodRatio
from heli_lab.twin.tail import SEGMENT_s, Tail, fit_tail

from tests.estimation.density import log_density

CHANGES = all_changes()

COUNT_rad = np.full(3, 2 * np.pi / 4096)
COLUMNS = sum(len(change.numbers) for change in CHANGES)


def column(name: str) -> int:
    before = 0
    for change in CHANGES:
        if change.id == name:
            return before
        before += len(change.numbers)
    raise KeyError(name)


def fed(values: np.ndarray, sensitivity: np.ndarray) -> LikelihoodRatio:
    """One onset before all innovations, (n, 3), with the same sensitivity, (n, 3, columns)."""
    ratio = LikelihoodRatio(CHANGES, COUNT_rad)
    ratio.begin_onset(0, np.zeros((4, COLUMNS, ONSETS)))
    for value, derivative in zip(values, sensitivity, strict=True):
        ratio.update(Innovation(value, np.repeat(derivative[:, :, None], ONSETS, axis=2)))
    return ratio


@pytest.mark.parametrize("name", ["thrust_step.front", "cable_spring.travel"])
def test_evidence_is_the_ratio_of_two_gaussian_densities(name: str) -> None:
    rng = np.random.default_rng(1)
    values, sensitivity = rng.normal(size=(6, 3)), rng.normal(size=(6, 3, COLUMNS))
    ratio = fed(values, sensitivity)
    (change,) = (listed for listed in CHANGES if listed.id == name)
    low = column(name)
    response = sensitivity[:, :, low : low + len(change.numbers)].reshape(18, -1)
    # Marginalised over the size: white noise plus what a size of the prior adds.
    covariance = np.eye(18) + response @ np.diag(np.square(change.sizes)) @ response.T
    whole, none = (log_density(values.ravel(), matrix) for matrix in (covariance, np.eye(18)))
    (candidate,) = (ranked for ranked in ratio.ranking() if ranked.change.id == name)
    assert candidate.log_evidence == pytest.approx(whole - none)


def test_a_change_that_cannot_be_negative_is_integrated_over_one_side() -> None:
    rng = np.random.default_rng(2)
    values, sensitivity = rng.normal(size=(5, 3)), rng.normal(size=(5, 3, COLUMNS))
    ratio = fed(values, sensitivity)
    (change,) = (listed for listed in CHANGES if listed.id == "coulomb_friction.pitch")
    response = sensitivity[:, :, column(change.id)].ravel()
    sizes = np.linspace(0, 8 * change.sizes[0], 20_001)
    density = 2 * np.exp(-0.5 * (sizes / change.sizes[0]) ** 2) / change.sizes[0] / math.sqrt(2 * np.pi)
    gain = np.exp(sizes * (response @ values.ravel()) - 0.5 * sizes**2 * (response @ response))
    expected = math.log(float(np.trapezoid(density * gain, sizes)))
    (candidate,) = (ranked for ranked in ratio.ranking() if ranked.change.id == change.id)
    assert candidate.log_evidence == pytest.approx(expected, abs=1e-4)


def test_the_size_and_its_error_are_those_of_least_squares() -> None:
    rng = np.random.default_rng(3)
    sensitivity = 30.0 * rng.normal(size=(40, 3, COLUMNS))
    low = column("thrust_step.back")
    values = 0.2 * sensitivity[:, :, low] + rng.normal(size=(40, 3))
    best = fed(values, sensitivity).ranking()[0]
    response = sensitivity[:, :, low].ravel()
    assert best.change.id == "thrust_step.back"
    assert best.size == pytest.approx(response @ values.ravel() / (response @ response), rel=2e-3)
    assert best.std == pytest.approx((response @ response) ** -0.5, rel=2e-3)


def test_the_window_keeps_the_most_likely_onset_of_each_half_second() -> None:
    ratio = LikelihoodRatio(CHANGES, COUNT_rad)
    moved = np.zeros((4, COLUMNS, ONSETS))
    rng = np.random.default_rng(4)
    for block in range(1, 6 * RECENT):
        ages = ratio.ages(block)
        seen = np.zeros((3, COLUMNS, ONSETS))
        seen[:] = np.where(ages > 0, 1.0, 0.0)
        jump = 2.0 if block > 2 * RECENT + 5 else 0.0
        ratio.update(Innovation(rng.normal(size=3) + jump, 5.0 * seen))
        ratio.begin_onset(block, moved)
    (candidate,) = (ranked for ranked in ratio.ranking() if ranked.change.id == "thrust_step.front")
    assert abs(candidate.onset_block - (2 * RECENT + 5)) <= 3
    assert KEPT * RECENT * 0.04 > 14


@pytest.mark.medium
def test_a_tail_gives_the_rate_that_is_asked_for_however_few_it_was_fitted_to() -> None:
    rng = np.random.default_rng(5)
    scale, per_hour = 1.5, 3600.0 / SEGMENT_s
    rates = []
    for _ in range(150):
        maxima = [(SEGMENT_s * i + (i > 0), 4.0 + scale * rng.exponential()) for i in range(100)]
        threshold = fit_tail([maxima]).threshold_nats(1.0)
        rates.append(per_hour * math.exp(-(threshold - 4.0) / scale))
    # Averaged over what the user may have learned; the level's own error and the scale's floor are left.
    assert 0.75 < float(np.mean(rates)) < 1.3


def test_no_alarm_is_called_for_before_the_level() -> None:
    assert Tail(5.0, 100.0, 2.0, 20).threshold_nats(1e-6) == 5.0


def test_the_supported_rate_is_one_per_hour_for_half_a_minute() -> None:
    """A rarer false alarm than the healthy flights support is not promised."""
    tail = Tail(5.0, 100.0, 1.5, 30, healthy_s=30.0)
    assert tail.supported_interval_h == pytest.approx(1.0)
    assert tail.threshold_nats(10.0) == tail.threshold_nats(1.0) > tail.threshold_nats(0.5)


def test_an_uncertain_tail_has_a_higher_threshold() -> None:
    """The mean chance over tails that differ is more than that of the mean tail; many excesses leave none."""
    few, many = Tail(5.0, 100.0, 1.5, 5), Tail(5.0, 100.0, 1.5, 100_000)
    assert many.threshold_nats(1.0) == pytest.approx(5.0 + 1.5 * math.log(100.0), rel=1e-2)
    assert few.threshold_nats(1.0) > many.threshold_nats(1.0) + 1.0


def test_two_large_excesses_give_no_boundless_threshold() -> None:
    """Two outliers among quiet segments once gave alarm levels of thousands of nats."""
    maxima = [3.0 + 0.01 * (i % 10) for i in range(60)]
    maxima[7], maxima[31] = 20.0, 30.0
    history = [(SEGMENT_s * i + 1.0, value) for i, value in enumerate(maxima)]
    assert fit_tail([history], 300.0).threshold_nats(10.0) < 100.0
