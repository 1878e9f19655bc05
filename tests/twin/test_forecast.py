"""Forecasts from the present state: errors of a right and of a wrong model, and nothing of the future."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.fly.plan import Plan
from heli_host.ui.cli import run
from heli_lab.errors import TwinError
from heli_lab.watch.calibration import DEFAULT_DISTURBANCES
from heli_lab.watch.forecast import Forecasts, HORIZONS_s, START_EVERY_s, forecasts_of, horizon_errors
from heli_lab.watch.learn import fly_simulated, with_process_noise
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue, effect_numbers, parse_effects
from heli_sim.rig import Rig, load_rig, write_rig

RIG = load_rig("makki2024")
LAG = MultibodyModel(parse_effects(["rotor_lag=0.1"]))
PLAN = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 12
settle_s = 1
[[segment]]
kind = "sine"
travel_amplitude_deg = 15
travel_period_s = 12
elevation_amplitude_deg = 4
elevation_period_s = 7
duration_s = 15
excite = { signal = "multisine", front_V = 0.3, back_V = 0.3, start_Hz = 0.1, stop_Hz = 3 }
"""


@cache
def lagging_flight() -> Flight:
    """Return a flight without disturbances of a rig whose rotors lag by 0.1 s."""
    return fly_simulated(LAG, RIG, Plan.parse(PLAN, "short.toml"), seed=11)


@cache
def forecasts(*, has_lag: bool) -> Forecasts:
    model = LAG if has_lag else MultibodyModel()
    return forecasts_of(model, RIG, DEFAULT_DISTURBANCES, lagging_flight(), "short")


@pytest.mark.slow
def test_the_right_model_forecasts_better_than_the_wrong_one_and_than_persistence() -> None:
    rows = horizon_errors(forecasts(has_lag=True), forecasts(has_lag=False))
    assert [row.horizon_s for row in rows] == list(HORIZONS_s)
    for row in rows:
        assert row.reduction is not None
        assert row.reduction["pitch"].interval95[1] < 1.0
        assert all(row.with_causes[axis] < row.persistence[axis] for axis in AXES)
    # Without disturbances, the right model has an error of a few counts of 0.09 degrees after 1 s.
    assert rows[2].with_causes["pitch"] < 0.3
    assert rows[2].forecasts > 20


@pytest.mark.slow
def test_the_error_of_a_right_model_in_gusts_is_the_expected_one() -> None:
    """The covariance of the filter, propagated over 1 s, has the size of the errors. That of a wrong model is
    too small for its errors.
    """
    in_gusts = with_process_noise(LAG, DEFAULT_DISTURBANCES)
    flight = fly_simulated(in_gusts, RIG, Plan.parse(PLAN, "short.toml"), seed=3)
    horizon = HORIZONS_s.index(1.0)

    def ratios(model: MultibodyModel) -> Floats:
        """Return the mean square error divided by the expected one, (3,)."""
        forecast = forecasts_of(model, RIG, DEFAULT_DISTURBANCES, flight, "short")
        return np.asarray(np.nanmean(forecast.squares_rad2(horizon), axis=0) / forecast.expected_rad2)

    right = ratios(LAG)
    assert np.all((right > 0.3) & (right < 2.0)), right
    assert ratios(MultibodyModel())[AXES.index("pitch")] > 3.0


@pytest.mark.slow
def test_nothing_of_the_future_enters_a_forecast() -> None:
    """Angles after the end of a forecast, and angles within it, change nothing of it."""
    whole, flight = forecasts(has_lag=True), lagging_flight()
    middle = len(whole.start_s) // 2
    is_later = flight.t_s > whole.start_s[middle] + 0.5 * START_EVERY_s
    altered = replace(flight, pitch_rad=flight.pitch_rad + np.where(is_later, 0.02, 0.0))
    other = forecasts_of(LAG, RIG, DEFAULT_DISTURBANCES, altered, "altered")
    assert np.array_equal(other.path_rad[: middle + 1], whole.path_rad[: middle + 1])
    assert not np.array_equal(other.path_rad[middle + 1], whole.path_rad[middle + 1])


@pytest.mark.slow
def test_a_forecast_begins_at_the_measured_angles_and_ends_with_the_flight() -> None:
    flight = forecasts(has_lag=True)
    assert np.abs(flight.path_rad[:, 0] - flight.start_rad).max() < np.deg2rad(0.2)
    reach_s = np.array(HORIZONS_s)[np.isfinite(flight.measured_rad[-1, :, 0])]
    assert not len(reach_s) or flight.start_s[-1] + reach_s[-1] <= lagging_flight().t_s[-1]
    assert np.allclose(np.diff(flight.start_s), START_EVERY_s)


@pytest.mark.slow
def test_a_part_that_is_too_short_is_refused() -> None:
    with pytest.raises(TwinError, match=r"less than 5\.2 s of uninterrupted free flight"):
        forecasts_of(
            LAG,
            RIG,
            DEFAULT_DISTURBANCES,
            lagging_flight(),
            "short",
            (float(lagging_flight().t_s[-1]) - 5.0, None),
        )


@pytest.mark.slow
def test_the_command_writes_table_json_and_figure(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight, rig = tmp_path / "short.csv", tmp_path / "lag.toml"
    write_csv(lagging_flight(), flight)
    lag = effect_numbers(catalogue()["rotor_lag"], {"rotor_lag_s": 0.1}, {"rotor_lag_s": 0.0}, "hidden")
    write_rig(Rig("lag", "lagging rotors", RIG.numbers, {"rotor_lag": lag}, "multibody"), rig)
    results, figure = tmp_path / "forecast.json", tmp_path / "forecast.svg"
    arguments = ["predict", str(flight), "--rig", str(rig), "--json", str(results), "--figure", str(figure)]
    assert run(arguments) == 0
    printed = capsys.readouterr().out
    assert "lag.toml without its effects" in printed and "nothing changes" in printed
    numbers = json.loads(results.read_text())
    assert [row["horizon_s"] for row in numbers["horizons"]] == list(HORIZONS_s)
    pitch = numbers["horizons"][1]["axis"]["pitch"]
    assert pitch["ratio"] == pytest.approx(pitch["model_deg"] / pitch["baseline_deg"])
    assert pitch["ratio"] < 1.0 < numbers["range_deg_s"]["pitch"][1]
    assert figure.read_text().lstrip().startswith("<?xml")


def test_times_in_the_wrong_order_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["predict", "a.csv", "--from", "5", "--to", "3"]) == 2
    assert "is not before --to 3" in capsys.readouterr().err
