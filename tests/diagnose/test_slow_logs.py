"""A log that is slower than the control loop has samples of the voltages: the flights show when they act."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.explain.assessment import with_likelier_advance
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.screening import Screening
from heli_lab.fit.identification import identify
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.voltage_timing import (
    most_likely_advance,
    sampled_advance,
    slow_log_notes,
    with_acting_voltages,
)
from heli_lab.fit.windows import make_grid
from heli_lab.watch.disturbances import acting_flights
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.field.slow_logs import every
from tests.identify import made
from tests.identify.made import flown, thinned
from tests.running.kept import FLOWN, KEPT

THINNING = 10
RIG = load_rig("makki2024")


@cache
def at_loop_rate(*effects: str) -> Flight:
    """Return a flight with every row of the loop, 1 kHz."""
    rig = RIG.replace(thrust_gain=0.62, friction_travel=0.05)
    model = MultibodyModel(parse_effects(effects))
    return KEPT(
        f"slow logs {effects}",
        lambda: flown(rig, 21, 18.0, model),
        made_by=(Path(__file__), Path(made.__file__)),
        rooms=FLOWN,
    )


def compared(log: Flight) -> ModelComparison:
    return ModelComparison(MultibodyModel(), RIG, [prepare(log, RIG, "log")], [])


def record(advance_rows: float, gaps: tuple[int, ...] = ()) -> Record:
    """Return four rows in which one voltage rises, and the other is below the dead zone in the middle."""
    volts_V = np.array([[2.0, 2.0], [3.0, 0.0], [5.0, 0.0], [5.0, 2.0]])
    zeros = np.zeros((4, 3))
    return Record(
        "made", 0.01 * np.arange(4.0), zeros, volts_V, 0.01, np.ones(3), ((0, 4),), (), (), gaps, advance_rows
    )


def test_an_advance_mixes_each_voltage_with_the_next() -> None:
    (front, back) = make_grid(record(0.25), [(0, 4)], 1).inputs.mean_V.T
    np.testing.assert_allclose(front, [2.25, 3.5, 5.0, 5.0])
    np.testing.assert_allclose(back, [1.5, 0.0, 0.5, 2.0])
    assert np.array_equal(make_grid(record(0.0), [(0, 4)], 1).inputs.mean_V, record(0.0).voltages_V)


def test_no_voltage_comes_from_behind_a_gap() -> None:
    front, _ = make_grid(record(0.25, gaps=(1,)), [(0, 4)], 1).inputs.mean_V.T
    np.testing.assert_allclose(front, [2.25, 3.0, 5.0, 5.0])


def test_voltages_are_raised_to_the_dead_zone_before_they_are_mixed() -> None:
    grid = make_grid(record(0.5), [(0, 4)], 1, dead_zone_V=1.0)
    np.testing.assert_allclose(grid.inputs.mean_V[:, 1], [1.5, 1.0, 1.5, 2.0])
    (derivative,) = grid.inputs.voltage_derivatives
    np.testing.assert_allclose(derivative.of_mean[:, 1], [0.5, 1.0, 0.5, 0.0])


@pytest.mark.parametrize(("loop_Hz", "advance_rows"), [(50.0, 0.0), (100.0, 0.0), (200.0, 0.25), (1e3, 0.45)])
def test_a_known_rate_of_the_loop_gives_the_advance(loop_Hz: float, advance_rows: float) -> None:
    assert sampled_advance(record(0.0), loop_Hz) == pytest.approx(advance_rows)


def test_a_delay_is_no_advance() -> None:
    assert most_likely_advance(0.0, score=-100.0, information=50.0).nats == 0.0
    assert most_likely_advance(0.0, score=100.0, information=50.0).rows == 1.0
    assert most_likely_advance(0.0, 10.0, 25.0, (0.0, 0.45, 1.0)).rows == 0.45


def test_an_advance_smaller_than_that_of_any_slower_log_is_none() -> None:
    clear, unclear = 3000.0, 400.0  # 0.147 rows, known to 0.018 and to 0.05 rows: 32 and 4 nats
    assert most_likely_advance(0.0, 0.147 * clear, clear).nats == 0.0
    assert most_likely_advance(0.0, 0.24 * clear, clear).rows == pytest.approx(0.24)
    assert most_likely_advance(0.0, 0.16 * unclear, unclear).rows == pytest.approx(0.16)


def test_only_a_slow_log_has_a_note() -> None:
    assert slow_log_notes([record(0.0)]) == []
    (note,) = slow_log_notes([record(0.45), record(0.45)])
    assert note.startswith(
        "the log is slower than the control loop: the voltages between its rows are not known"
    )
    assert "effects faster than 20 ms cannot be seen" in note


@pytest.mark.diagnosis
@pytest.mark.parametrize(("log_of", "has_samples"), [(every, True), (thinned, False)])
def test_the_flight_shows_whether_its_voltages_are_samples(
    log_of: Callable[[Flight, int], Flight], has_samples: bool
) -> None:
    comparison = compared(log_of(at_loop_rate(), THINNING))
    screenings = [Screening(comparison.filtering_baseline.estimate)]
    with_advance = with_likelier_advance(comparison, screenings, loop_Hz=None)
    assert (with_advance is not None) is has_samples
    if with_advance is not None:
        assert with_advance.train[0].advance_rows == pytest.approx(0.45, abs=0.15)
        log_likelihood = with_advance.filtering_baseline.log_likelihood
        assert log_likelihood > comparison.filtering_baseline.log_likelihood + 10.0
    # A log at the rate of its loop has no voltages between its rows.
    assert with_likelier_advance(comparison, screenings, loop_Hz=1000.0 / THINNING) is None


@pytest.mark.diagnosis
def test_a_lag_of_the_rotors_is_no_advance() -> None:
    held = compared(thinned(at_loop_rate("rotor_lag=0.08"), THINNING))
    assert with_likelier_advance(held, [Screening(held.filtering_baseline.estimate)], loop_Hz=None) is None


@pytest.mark.diagnosis
def test_identify_corrects_for_a_known_rate_of_the_loop() -> None:
    log = every(at_loop_rate(), THINNING)
    free = ("thrust_gain", "friction_travel")
    held, sampled = (
        identify(MultibodyModel(), RIG, [log], free=free, loop_Hz=rate) for rate in (None, 1000.0)
    )
    assert sampled.training[0].rms_deg["pitch"] < 0.95 * held.training[0].rms_deg["pitch"]
    assert not held.slow_log_notes
    assert sampled.json()["flights"][0]["notes"][0] == sampled.slow_log_notes[0]


def test_a_record_keeps_its_logged_voltages() -> None:
    assert np.array_equal(replace(record(0.0), advance_rows=0.45).voltages_V, record(0.0).voltages_V)


@pytest.mark.diagnosis
def test_twin_and_predict_find_when_the_voltages_of_a_slow_log_act() -> None:
    """With the right rig, the advance is that of a sample, and the log's own rate has none."""
    rig = RIG.replace(thrust_gain=0.62, friction_travel=0.05)
    log = every(at_loop_rate(), THINNING)
    (acting,), (note,) = acting_flights(MultibodyModel(), rig, [log], ["log"], loop_Hz=None)
    assert note.startswith("the log is slower than the control loop")
    exact = with_acting_voltages(log, 0.45)
    logged_V, acting_V, exact_V = (
        np.diff(flight.front_V - log.front_V).std() for flight in (log, acting, exact)
    )
    assert logged_V == 0.0 and acting_V == pytest.approx(exact_V, rel=0.3)
    (held,), notes = acting_flights(MultibodyModel(), rig, [log], ["log"], 1000.0 / THINNING)
    assert notes == [] and np.array_equal(held.front_V, log.front_V)
