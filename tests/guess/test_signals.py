"""Signals are low-passed as the literature's filter does it, the clock is found, and jumps end a part."""

import math
from dataclasses import replace

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.tables import Column, Table
from heli_lab.setup.guess.signals import (
    CUTOFF_Hz,
    SAMPLE_STEP_s,
    clock_of,
    filtered_signal,
    longest_run,
    unwrapped,
)

pytestmark = pytest.mark.medium


@pytest.mark.parametrize("rows", [16, 40, 6001])
def test_the_low_pass_is_the_butterworth_filter_of_scipy_both_ways(rows: int) -> None:
    from scipy.signal import butter, sosfiltfilt

    wandering = np.cumsum(np.random.default_rng(rows).normal(size=rows)) + 100.0
    sections = butter(4, CUTOFF_Hz, fs=1.0 / SAMPLE_STEP_s, output="sos")
    low = sosfiltfilt(sections, wandering)
    guess_result = filtered_signal(wandering)
    np.testing.assert_allclose(guess_result.value, low, atol=1e-10)
    acceleration = np.gradient(np.gradient(low, SAMPLE_STEP_s), SAMPLE_STEP_s)
    np.testing.assert_allclose(
        guess_result.acceleration, acceleration, atol=1e-8 * np.abs(acceleration).max()
    )


def test_a_wrapped_angle_is_unwrapped_and_a_motor_that_is_switched_on_is_not() -> None:
    angle_deg: Floats = np.linspace(-300.0, 500.0, 2000)
    wrapped = np.mod(angle_deg + 180.0, 360.0) - 180.0
    for unit in (1.0, 100.0, 1e3 * np.pi / 180.0):
        assert np.ptp(unwrapped(unit * wrapped)) == pytest.approx(800.0 * unit)
    # An encoder that turns by less than a count per row.
    counts = np.floor(np.arange(3000) / 40.0) % 64.0
    assert np.ptp(unwrapped(counts, (64.0,))) == 74.0
    # The command of a motor is steady at first, and noisy in flight.
    rising = 320.0 + 2.0 * np.arange(9.0)
    noise = np.clip(np.random.default_rng(1).normal(0.0, 30.0, 1500), -90.0, 90.0)
    percent: Floats = np.concatenate((np.zeros(200), rising, 200.0 + noise))
    assert unwrapped(percent) is percent


def table(name: str, step: float, unit: str = "") -> Table:
    rising = Column(np.array([7.0 + k * step for k in range(200)]), unit)
    return Table("a.csv", {"x": Column(np.sin(np.arange(200.0))), name: rising})


@pytest.mark.parametrize(
    ("name", "step", "unit", "expected_unit", "sure"),
    [
        ("t_s", 0.002, "", "s", True),
        ("Time [ms]", 2.0, "", "ms", True),
        ("t", 0.01, "", "s", True),
        ("time", 4.0, "", "ms", True),
        ("time", 4000.0, "", "us", True),
        ("time", 2e6, "", "ns", True),
        ("whatever", 0.005, "", "s", True),
        ("time", 1.0, "", "ms", False),
        ("index", 1.0, "", "", False),
        ("index", 0.005, "", "s", True),
        ("column 1", 1.0, "", "ms", False),
        ("t_s", 10000.0, "", "us", False),
        ("x2", 5.0, "ms", "ms", True),
        ("t", 1.0 / 864000.0, "", "day", True),
        ("t", 0.02 / 60.0, "", "min", False),
        ("t_s", 0.02 / 60.0, "", "s", True),
        ("t", 0.02, "", "s", True),
        ("Zeit [10ms]", 2.5, "", "ms", False),
    ],
)
def test_a_clock(name: str, step: float, unit: str, expected_unit: str, sure: bool) -> None:
    clock = clock_of(table(name, step, unit))
    assert (clock.column, clock.unit, clock.sure) == (name, expected_unit, sure)
    assert sure or clock.alternative


def test_a_unit_of_times_names_a_time_whose_word_is_not_known() -> None:
    for name in ("tijd [s]", "sec"):
        coarse = Table("a.csv", {name: Column(np.floor(np.arange(200.0) / 2.5) / 10.0)})
        clock = clock_of(coarse)
        assert (clock.column, clock.unit, clock.sure) == (name, "s", True)


def test_a_clock_whose_rows_come_in_pairs_has_the_unit_of_their_mean_step() -> None:
    times = 8e6 + 2e4 * (np.arange(400) // 2) + 40.0 * (np.arange(400) % 2)
    assert clock_of(Table("a.csv", {"timestamp": Column(times)})).unit == "us"


@pytest.mark.parametrize("rows_per_tick", [3, 12.5, 33])
@pytest.mark.parametrize("direction", [1.0, -1.0])
def test_a_coarse_clock_without_a_name_is_proposed_and_doubted(
    rows_per_tick: float, direction: float
) -> None:
    rows: Floats = np.arange(600, dtype=np.float64)
    ticks: Floats = np.floor((rows + 5.0) / rows_per_tick)
    tick_s = 0.01 * rows_per_tick
    table = Table(
        "a.csv", {"x": Column(np.sin(rows)), "y": Column((direction * tick_s * ticks)[:: int(direction)])}
    )
    clock = clock_of(replace(table, columns={**table.columns, "k": Column(rows)}))
    assert (clock.column, clock.unit, clock.sure) == ("y", "s", False)
    assert "rises in equal steps" in clock.alternative


def test_a_clock_without_a_name_may_stand_still() -> None:
    times: Floats = 0.01 * np.arange(3000.0)
    times[900:1000] = times[900]
    assert clock_of(Table("a.csv", {"x": Column(np.sin(times)), "y": Column(times)})).column == "y"


def test_a_staircase_is_no_coarse_clock() -> None:
    random = np.random.default_rng(4)
    stairs = {
        "random lengths": np.cumsum(random.random(600) < 0.1) * 0.1,
        "a bend": np.floor(np.arange(600.0) ** 1.2 / 40.0),
        "turns round": np.floor(np.minimum(np.arange(600.0), 900.0 - np.arange(600.0)) / 12.0),
        "few steps": np.floor(np.arange(600.0) / 100.0),
    }
    for name, values in stairs.items():
        assert not clock_of(Table("a.csv", {"x": Column(values)})).column, name


def test_the_newest_row_may_be_the_first_and_some_times_damaged() -> None:
    times: Floats = 20.0 * np.arange(1700.0)[::-1]
    times[50::100] = 7.0
    assert clock_of(Table("a.csv", {"timestamp (ms)": Column(times)})).unit == "ms"


def test_the_newest_row_may_be_the_first_and_twice_in_the_file() -> None:
    falling: Floats = 30.0 - 0.05 * np.sort(np.concatenate((np.arange(200.0), np.arange(0.0, 200.0, 20.0))))
    clock = clock_of(Table("a.csv", {"timestamp": Column(falling, "s")}))
    assert (clock.column, clock.sure) == ("timestamp", True)


def test_no_clock() -> None:
    assert not clock_of(Table("a.csv", {"x": Column(np.sin(np.arange(200.0)))})).column
    assert not clock_of(table("t_s", 1e12)).unit


@pytest.mark.parametrize("jump", [0.0, math.radians(21.0)])
def test_a_jump_of_an_encoder_ends_the_part_that_is_guessed(jump: float) -> None:
    step = 2.0 * math.pi / 4096.0
    t_s: Floats = np.arange(1000, dtype=np.float64) * 0.01
    angle: Floats = np.round(0.4 * np.sin(t_s) / step) * step + np.where(t_s > 6.0, jump, 0.0)
    voltage: Floats = 3.0 + 0.3 * np.sin(7.0 * t_s) + np.where(t_s > 3.0, 4.0, 0.0)
    part, _ = longest_run(Table("x", {"p": Column(angle), "u": Column(voltage)}), t_s)
    assert len(part) == (601 if jump else 1000)


def test_an_angle_that_stands_still_before_its_jump_is_no_motion() -> None:
    step = 2.0 * math.pi / 4096.0
    t_s: Floats = np.arange(1000, dtype=np.float64) * 0.01
    angle: Floats = np.round(0.4 * np.sin(t_s) / step) * step
    angle[550:800] = angle[550]
    part, part_s = longest_run(Table("x", {"p": Column(angle)}), t_s)
    assert len(part) == 551 and part_s[0] == 0.0
