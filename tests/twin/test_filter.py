"""The twin's filter, and the evidence that it gives: logarithms of ratios of Gaussian likelihoods."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.declaration import Channel, State
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.watch import twin as twin_module
from heli_lab.watch.calibration import Calibration, SEGMENT_s, Tail, fit_tail
from heli_lab.watch.disturbances import DETECTABLE_WITHIN_s, at_least_rounding
from heli_lab.watch.kalman_filter import KalmanFilter
from heli_lab.watch.learn import NO_ALARM, Draws, evidence, fly_simulated, random_plan, with_process_noise
from heli_lab.watch.likelihood_ratio import (
    CUT_OFF_STD,
    KEPT,
    ONSETS,
    RECENT,
    ChangeCandidate,
    Innovation,
    LikelihoodRatio,
)
from heli_lab.watch.steps import Samples, Step, Stepper, count_rad_of, samples_of, samples_of_ticks
from heli_lab.watch.twin import Twin
from heli_lab.watch.twin_model import EXACT, SUPPLY_STD, ZEROS, Change, TwinModel, all_changes
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig, load_rig
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from tests.estimation.pendulum import log_density

DISTURBANCES = DisturbanceModel(
    fast_std=np.array([0.01, 0.003, 0.006]),
    correlation_time_s=np.full(3, 0.5),
    slow_std=np.array([1e-3, 5e-4, 5e-4]),
    quantisation=np.array([1.6, 1.4, 1.1]),
)
RIG = load_rig("makki2024")
SAMPLE_s, STEP_s, STEPS_PER_BLOCK = 1e-3, 0.01, 4
SENSITIVITY_TICKS = 22_000
"""Length of the flight along which sensitivities are compared: take-off, and some ten seconds of it."""


@cache
def disturbed_flight() -> Flight:
    return fly_simulated(
        with_process_noise(MultibodyModel(), DISTURBANCES), RIG, random_plan(4, 46.0), seed=4
    )


def recorded_innovations(
    monkeypatch: pytest.MonkeyPatch, rig: Rig, count: int | None = None
) -> list[Innovation]:
    """Follow the flight, or its first `count` ticks, with a twin of `rig`; return the innovation of each
    measurement.
    """
    flight = disturbed_flight()
    twin = Twin(
        TwinModel(MultibodyModel(), rig),
        Calibration(DISTURBANCES, NO_ALARM),
        count_rad_of(flight, RIG),
        SAMPLE_s,
    )
    recorded = []
    update = KalmanFilter.update

    def recording_update(self: KalmanFilter, *arguments: Any, **named_arguments: Any) -> Innovation:
        innovation = update(self, *arguments, **named_arguments)
        # The filter changes the arrays of sensitivities in place.
        recorded.append(Innovation(innovation.value.copy(), innovation.sensitivity.copy()))
        return innovation

    with monkeypatch.context() as patch:
        patch.setattr(KalmanFilter, "update", recording_update)
        twin.update(samples_of(flight)[0].select(slice(count)))
    return recorded


@pytest.mark.slow
def test_innovations_are_white_and_of_unit_variance(monkeypatch: pytest.MonkeyPatch) -> None:
    innovations = np.array([innovation.value for innovation in recorded_innovations(monkeypatch, RIG)])
    assert len(innovations) > 900
    # The filter assumes too large rounding errors for angles at rest, so the variance may be below one. A
    # variance above one would raise false alarms.
    std = innovations.std(axis=0)
    assert np.all((std > 0.6) & (std < 1.15))
    autocorrelation = (innovations[1:] * innovations[:-1]).mean(axis=0) / (innovations**2).mean(axis=0)
    assert np.all(np.abs(autocorrelation) < 0.15)


@pytest.mark.slow
def test_sensitivities_equal_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """A counterweight that is shifted from the start on changes the innovations by its sensitivity. Twins of
    two slightly different rigs give the same derivative by finite differences.
    """
    shift_m = 1e-3
    innovations = {}
    for sign in (-1.0, 1.0):
        shifted_rig = RIG.replace(L_b=RIG["L_b"].value + sign * shift_m)
        recorded = recorded_innovations(monkeypatch, shifted_rig, SENSITIVITY_TICKS)
        innovations[sign] = np.array([innovation.value for innovation in recorded])
    # A change of the flown rig has the opposite effect of a change of the model.
    finite_difference = -(innovations[1.0] - innovations[-1.0]) / (2 * shift_m)

    changes = TwinModel(MultibodyModel(), RIG).changes
    parameters = [parameter for change in changes for parameter in change.parameters]
    # Every change begins before the first measurement, and no other onset is added.
    monkeypatch.setattr(twin_module, "FILTER_SETTLING_s", np.inf)
    monkeypatch.setattr(LikelihoodRatio, "ages", lambda self, block: np.ones((len(parameters), ONSETS)))
    column = parameters.index("counterweight_shift_m")
    recorded = recorded_innovations(monkeypatch, RIG, SENSITIVITY_TICKS)
    sensitivity = np.array([innovation.sensitivity[:, column, 0] for innovation in recorded])

    largest = np.abs(finite_difference).max()
    assert largest > 10.0
    assert np.sqrt(((sensitivity - finite_difference) ** 2).mean()) < 0.05 * largest


@pytest.mark.medium
def test_variances_stay_positive_under_huge_disturbances() -> None:
    """A filter that subtracts from the covariance itself gets negative variances from rounding errors."""
    model = TwinModel(MultibodyModel(), RIG)
    hover = trim(MultibodyModel(), RIG)
    huge = DisturbanceModel(np.full(3, 1e7), np.full(3, 5.0), np.full(3, 1e-3), np.full(3, 0.02))
    count_rad = np.full(3, 1e-9)
    kalman = KalmanFilter(model, huge, count_rad, STEP_s, STEPS_PER_BLOCK, hover.state.copy())
    columns = model.weights.shape[1]
    amount, onset_rad = np.ones((columns, ONSETS)), np.zeros((len(model.scales), ONSETS))
    for _ in range(20):
        for _ in range(STEPS_PER_BLOCK):
            kalman.predict(0.0, hover.volts_V)
        kalman.update(0.0, hover.state[:3], 1, hover.volts_V, amount, onset_rad)
        assert np.all(np.diagonal(kalman.covariance) > 0.0)


@pytest.mark.slow
def test_an_untypical_supply_is_estimated_and_no_change() -> None:
    """With an uncertain supply, the filter estimates it from the first seconds of a flight."""
    flight = disturbed_flight()
    weak_supply = replace(flight, front_V=flight.front_V / 0.96, back_V=flight.back_V / 0.96).between(
        0.0, 30.0
    )
    max_evidence_nats = {}
    for uncertainty in (EXACT, replace(EXACT, supply_std=SUPPLY_STD)):
        twin = TwinModel(MultibodyModel(), RIG, uncertainty)
        history = evidence(twin, DISTURBANCES, weak_supply).history
        max_evidence_nats[uncertainty.supply_std] = max(nats for _, nats in history if np.isfinite(nats))
    assert max_evidence_nats[SUPPLY_STD] < 10.0 < max_evidence_nats[0.0]


@pytest.mark.medium
def test_the_first_measurement_leaves_the_zeros_of_the_encoders_unknown() -> None:
    """An encoder shows the sum of an angle and the error of its zero. A filter that starts with known angles
    takes an error of a zero for a torque.
    """
    tolerance_deg = 3.0
    rig = replace(
        RIG, numbers={**RIG.numbers, **{name: replace(RIG[name], tolerance=tolerance_deg) for name in ZEROS}}
    )
    model = TwinModel(MultibodyModel(), rig)
    hover = trim(MultibodyModel(), rig)
    count_rad = np.full(3, 2 * np.pi / 4096)
    kalman = KalmanFilter(model, DISTURBANCES, count_rad, STEP_s, STEPS_PER_BLOCK, hover.state.copy())
    amount, onset_rad = np.ones((model.weights.shape[1], ONSETS)), np.zeros((len(model.scales), ONSETS))
    for _ in range(STEPS_PER_BLOCK):
        kalman.predict(0.0, hover.volts_V)
    kalman.update(0.0, hover.state[:3], 1, hover.volts_V, amount, onset_rad)
    first_zero = model.states + 9  # after the model's state, gusts, drift and constant torques
    zero_std_rad = np.sqrt(np.diagonal(kalman.covariance)[first_zero : first_zero + len(ZEROS)])
    assert np.all(zero_std_rad > 0.9 * np.deg2rad(0.5 * tolerance_deg))


TICK_s = 1e-3


def smooth_samples(first: int, count: int) -> Samples:
    """Return samples with smooth angles and voltages that are numbered from `first` on."""
    number = np.arange(first, first + count)
    angles_rad = np.sin(number[:, None] * 0.01 + np.arange(3))
    volts_V = np.cos(number[:, None] * 0.02 + np.arange(2))
    return Samples(number, angles_rad, volts_V, flying=number % 97 > 3, landing=number % 89 > 70)


def comparable(steps: list[Step]) -> list[object]:
    """Return the steps with lists instead of arrays, so that ``==`` can compare them."""
    return [
        (
            step.index,
            step.after_gap,
            step.flying,
            step.landing,
            step.samples,
            step.volts_V.tolist(),
            None if step.measured_rad is None else step.measured_rad.tolist(),
        )
        for step in steps
    ]


@given(
    first=st.integers(0, 50),
    batch_sizes=st.lists(st.integers(1, 60), min_size=1, max_size=12),
    sample_ms=st.sampled_from([1, 4, 10]),
)
def test_steps_do_not_depend_on_the_batches(first: int, batch_sizes: list[int], sample_ms: int) -> None:
    samples = smooth_samples(first, sum(batch_sizes))
    steps_of_one_batch = list(Stepper(1e-3 * sample_ms).update(samples))
    stepper = Stepper(1e-3 * sample_ms)
    steps: list[Step] = []
    start = 0
    for size in batch_sizes:
        steps += stepper.update(samples.select(slice(start, start + size)))
        start += size
    assert comparable(steps) == comparable(steps_of_one_batch)


def test_a_step_contains_the_samples_of_its_ten_milliseconds() -> None:
    samples = smooth_samples(13, 100)
    first, second, *_ = Stepper(TICK_s).update(samples)
    # Steps begin at multiples of 10 ms: the first one at tick 20, the second one at tick 30.
    assert (first.index, first.after_gap, second.after_gap) == (2, True, False)
    assert np.array_equal(first.volts_V, samples.volts_V[7:17])
    # The angles at the beginning of a step are the mean of the samples within half a step.
    is_near_tick_30 = (samples.number >= 25) & (samples.number <= 35)
    assert second.measured_rad is not None
    assert np.allclose(second.measured_rad, samples.angles_rad[is_near_tick_30].mean(axis=0))


def test_a_short_gap_is_bridged() -> None:
    samples = smooth_samples(0, 300)
    with_gap_of_28_ms = samples.select(np.r_[0:103, 131:300])
    steps = list(Stepper(TICK_s).update(with_gap_of_28_ms))
    assert [step.index for step in steps] == list(range(30))
    assert [step.after_gap for step in steps] == [True] + 29 * [False]
    assert steps[12].measured_rad is None
    # The last voltage before the gap holds over the gap.
    assert np.allclose(steps[11].volts_V, samples.volts_V[102])


def test_the_steps_restart_after_a_long_gap() -> None:
    with_gap_of_80_ms = smooth_samples(0, 300).select(np.r_[0:103, 183:300])
    steps = list(Stepper(TICK_s).update(with_gap_of_80_ms))
    assert [step.index for step in steps if step.after_gap] == [0, 19]


def test_a_clock_that_restarts_restarts_the_steps() -> None:
    stepper = Stepper(TICK_s)
    list(stepper.update(smooth_samples(500, 100)))
    first_step = next(iter(stepper.update(smooth_samples(0, 50))))
    assert first_step.after_gap


def test_states_of_the_board_become_flying_and_landing() -> None:
    states = [State.IDLE, State.CLOSED_LOOP, State.LANDING, State.EMERGENCY_LANDING, State.FAULT]
    raw = np.zeros((len(states), len(Channel)), np.int32)
    raw[:, Channel.STATE] = [int(state) for state in states]
    samples = samples_of_ticks(np.arange(len(states)), raw, np.ones(3))
    assert samples.flying.tolist() == [False, True, True, True, False]
    assert samples.landing.tolist() == [False, False, True, True, False]


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
