"""The twin's filter: white innovations without a change, and correct sensitivities to changes."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.declaration import Channel, State
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch import twin as twin_module
from heli_lab.watch.calibration import Calibration
from heli_lab.watch.kalman_filter import KalmanFilter
from heli_lab.watch.learn import NO_ALARM, evidence, fly_simulated, random_plan, with_process_noise
from heli_lab.watch.likelihood_ratio import ONSETS, Innovation, LikelihoodRatio
from heli_lab.watch.steps import Samples, Step, Stepper, count_rad_of, samples_of, samples_of_ticks
from heli_lab.watch.twin import Twin
from heli_lab.watch.twin_model import EXACT, SUPPLY_STD, ZEROS, TwinModel
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import trim
from heli_sim.rig import Rig, load_rig
from hypothesis import given
from hypothesis import strategies as st

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
