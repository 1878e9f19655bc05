"""Forecasts from the present state, the parts of their errors, and the errors that a saved rig states."""

import json
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.fly.plan import Plan
from heli_host.ui.cli import run
from heli_lab.errors import TwinError
from heli_lab.report.diagnosis.text import error_share_rows, error_share_sentences
from heli_lab.watch import error_shares as shares_module
from heli_lab.watch import saved_rig as rig_module
from heli_lab.watch.calibration import DEFAULT_DISTURBANCES
from heli_lab.watch.error_shares import ErrorShares, error_shares, shares_json
from heli_lab.watch.forecast import Forecasts, HORIZONS_s, START_EVERY_s, forecasts_of, horizon_errors
from heli_lab.watch.learn import fly_simulated, with_process_noise
from heli_lab.watch.saved_rig import RigModel, SavedRig, compare_rigs, comparison_json, saved_json, saved_rig
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue, effect_numbers, parse_effects
from heli_sim.rig import Number, Rig, load_rig, write_rig

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
    write_rig(
        Rig(
            "lag",
            "makki2024 as identified from a.csv, short.csv",
            RIG.numbers,
            {"rotor_lag": lag},
            "multibody",
        ),
        rig,
    )
    results, figure = tmp_path / "forecast.json", tmp_path / "forecast.svg"
    arguments = ["predict", str(flight), "--rig", str(rig), "--json", str(results), "--figure", str(figure)]
    assert run(arguments) == 0
    printed = capsys.readouterr().out
    assert "lag.toml without its effects" in printed and "nothing changes" in printed
    assert "lag.toml was identified from short.csv: forecast another flight" in printed
    numbers = json.loads(results.read_text())
    assert [row["horizon_s"] for row in numbers["horizons"]] == list(HORIZONS_s)
    pitch = numbers["horizons"][1]["axis"]["pitch"]
    assert pitch["ratio"] == pytest.approx(pitch["model_deg"] / pitch["baseline_deg"])
    assert pitch["ratio"] < 1.0 < numbers["range_deg_s"]["pitch"][1]
    assert figure.read_text().lstrip().startswith("<?xml")


def test_times_in_the_wrong_order_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["predict", "a.csv", "--from", "5", "--to", "3"]) == 2
    assert "is not before --to 3" in capsys.readouterr().err


FORECASTS_S = 120.0
EVEN = (1.0, 1.0, 1.0)


def forecasts_with_normal_errors(
    label: str, rms_deg: Floats, expected_deg: Floats, factor_above_3_V: float = 1.0
) -> Forecasts:
    """Return forecasts with normal errors of the given size, (3,), which are larger by a factor where the
    front voltage exceeds 3 V.
    """
    random = np.random.default_rng(len(label))
    start_s = np.arange(0.0, FORECASTS_S, 0.2)
    k, path_s = len(start_s), np.linspace(0.0, 5.0, 51)
    front_V = random.uniform(1.0, 4.0, k)
    errors_rad = np.deg2rad(rms_deg) * random.normal(size=(k, 3))
    errors_rad *= np.where(front_V > 3.0, factor_above_3_V, 1.0)[:, None]
    return Forecasts(
        label,
        start_s,
        start_rad=np.zeros((k, 3)),
        measured_rad=np.zeros((k, len(HORIZONS_s), 3)),
        path_s=path_s,
        path_rad=np.repeat(errors_rad[:, None, :], len(path_s), axis=1),
        range_V=np.array([[1.0, 1.0], [4.0, 4.0]]),
        range_rad_s=np.array([[-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]]),
        start_V=np.column_stack((front_V, random.uniform(1.0, 4.0, k))),
        start_rad_s=random.normal(size=(k, 3)),
        expected_rad2=np.deg2rad(expected_deg) ** 2,
    )


def shares(
    monkeypatch: pytest.MonkeyPatch,
    *,
    before_deg: float = 2.0,
    expected_deg: float = 1.0,
    on_fitted: float = 1.0,
    on_judged: float = 1.0,
) -> ErrorShares:
    """Divide an error that falls from `before_deg` to 1 deg on all axes with the causes."""
    even = np.array(EVEN)

    def rig(name: str, **_: Any) -> Rig:
        return RIG if name == "baseline" else Rig("extended", "", RIG.numbers, {}, "multibody")

    def forecast(of: Rig) -> list[Forecasts]:
        rms_deg = before_deg * even if of is RIG else even
        return [forecasts_with_normal_errors("judged.csv", rms_deg, expected_deg * even, on_judged)]

    dependence = SimpleNamespace(what="torque.travel on travel_rate near rest", matters=True)
    result: Any = SimpleNamespace(
        has_other_flight=True,
        rig=rig,
        curved=None,
        label="unexplained",
        verdict=SimpleNamespace(unlisted=()),
        assessment=SimpleNamespace(residual_analysis=SimpleNamespace(dependences=[dependence])),
    )
    fitted = [forecasts_with_normal_errors("fitted.csv", even, even, on_fitted)]
    monkeypatch.setattr(shares_module, "forecast_flights", lambda *_: fitted)
    forecaster: Any = forecast
    forecaster.model_of = lambda _: None
    return error_shares(result, forecaster, list)


def test_the_parts_add_up_to_the_error_without_the_causes(monkeypatch: pytest.MonkeyPatch) -> None:
    result = shares(monkeypatch)
    for of_axis in result.axes.values():
        assert sum(of_axis.parts_deg2.values()) == pytest.approx(of_axis.before_deg**2)
        assert of_axis.parts_deg2["causes"] == pytest.approx(0.75 * of_axis.before_deg**2)
        assert of_axis.parts_deg2["unknown"] == 0.0
    assert error_share_rows(result)[1][3].endswith("(75 %)")
    pitch = shares_json(result)["axis"]["pitch"]
    assert pitch["causes"]["share"] == pytest.approx(0.75)
    assert pitch["disturbances"]["share"] == pytest.approx(0.25)


def test_an_error_beyond_that_of_the_disturbances_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    pitch = shares(monkeypatch, expected_deg=0.5).axes["pitch"]
    assert pitch.parts_deg2["disturbances"] == pytest.approx(0.25)
    assert pitch.parts_deg2["unknown"] == pytest.approx(pitch.after_deg**2 - 0.25)


def test_causes_with_worse_forecasts_have_a_negative_part(monkeypatch: pytest.MonkeyPatch) -> None:
    assert shares(monkeypatch, before_deg=0.8).axes["travel"].parts_deg2["causes"] < 0.0


def test_a_range_with_larger_errors_on_both_flights_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    result = shares(monkeypatch, on_fitted=3.0, on_judged=3.0)
    for axis in AXES:
        where = result.axes[axis].larger_where
        assert where is not None and where.quantity == "the front voltage"
        assert where.low == pytest.approx(3.0, abs=0.3) and np.isinf(where.high)
    sentence, *_ = error_share_sentences(result, "unexplained")
    assert "times as large if a forecast begins with the front voltage above 2.83 V" in sentence


def test_a_range_that_the_second_flight_contradicts_is_not_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    result = shares(monkeypatch, on_fitted=3.0)
    assert all(of_axis.larger_where is None for of_axis in result.axes.values())
    unresolved, sentence = error_share_sentences(result, "unexplained")
    assert unresolved.endswith("is significant, but forecasts do not show how much of the disturbances it is")
    assert sentence == "No range of voltage, angle or rate has significantly larger errors in judged.csv"
    assert error_share_sentences(result, "cause_found") == []


SAVED_S, COUNT_DEG = 60.0, 0.09
LAG_EFFECT, SPRING = "rotor_lag", "cable_spring.travel"


def rig_with(effects: Sequence[str]) -> Rig:
    numbers = {effect: {"s": Number(0.1, "s", 0.0, "test")} for effect in effects}
    return Rig("mine", "test", RIG.numbers, numbers, "multibody")


def forecasts_with_errors(errors_deg: Floats, label: str = "b.csv") -> Forecasts:
    """Return forecasts with the same error of each axis, (3,), at all horizons and starts."""
    start_s = np.arange(0.0, SAVED_S, 0.2)
    path_s = np.linspace(0.0, 5.0, 51)
    path_rad = np.broadcast_to(np.deg2rad(errors_deg), (len(start_s), len(path_s), 3))
    return Forecasts(
        label,
        start_s,
        start_rad=np.zeros((len(start_s), 3)),
        measured_rad=np.zeros((len(start_s), len(HORIZONS_s), 3)),
        path_s=path_s,
        path_rad=path_rad,
        range_V=np.array([[1.0, 1.1], [2.0, 2.1]]),
        range_rad_s=np.deg2rad([[-5.0, -40.0, -20.0], [5.0, 40.0, 20.0]]),
        start_V=np.zeros((len(start_s), 2)),
        start_rad_s=np.zeros((len(start_s), 3)),
        expected_rad2=np.zeros(3),
    )


def saved(travel_deg: dict[frozenset[str], float], fitted_deg_s: float = 20.0) -> SavedRig:
    """Save the rig of a diagnosis with lag and spring; travel has the given error for each set of causes."""

    class Forecaster:
        count_deg = np.full(3, COUNT_DEG)

        def __call__(self, rig: Rig) -> list[Forecasts]:
            return [forecasts_with_errors(np.array([0.1, 0.5, travel_deg[frozenset(rig.effects)]]))]

    problem = fitted_flight(fitted_deg_s)

    def rig(_name: str, *, with_unconfirmed: bool = False, only: Sequence[str] | None = None) -> Rig:
        assert not with_unconfirmed
        return rig_with([LAG_EFFECT, SPRING] if only is None else only)

    result: Any = SimpleNamespace(
        confirmed_ids=[LAG_EFFECT, SPRING],
        rig=rig,
        assessment=SimpleNamespace(before=SimpleNamespace(fit=SimpleNamespace(problem=problem))),
    )
    forecast: Any = Forecaster()
    return saved_rig(result, "mine", forecast, with_unconfirmed=False)


def fitted_flight(rate_deg_s: float) -> Any:
    """Return the problem of a fit to a flight in which travel turns with a rate."""
    t_s = np.arange(0.0, 20.0, 0.01)
    travel_rad = np.deg2rad(rate_deg_s) * t_s
    record = SimpleNamespace(
        step_s=0.01,
        segments=((0, len(t_s)),),
        angles_rad=np.column_stack((np.zeros_like(t_s), np.zeros_like(t_s), travel_rad)),
    )
    return SimpleNamespace(records=[record])


FITTED = fitted_flight(20.0)
BOTH, NONE = frozenset({LAG_EFFECT, SPRING}), frozenset[str]()


def test_causes_with_better_forecasts_are_all_saved() -> None:
    result = saved({NONE: 1.0, BOTH: 1.09})
    assert set(result.rig.effects) == BOTH and not result.left_out


def test_the_cause_that_makes_an_axis_worse_is_left_out_with_the_reason() -> None:
    errors_deg = {NONE: 1.0, BOTH: 1.48, frozenset({LAG_EFFECT}): 0.8, frozenset({SPRING}): 1.6}
    result = saved(errors_deg)
    assert set(result.rig.effects) == {LAG_EFFECT}
    (cause,) = result.left_out
    assert cause.effect == SPRING
    assert "the forecast error of travel at 1 s grows by 48 % (1 to 1.48 deg)" in cause.sentence
    assert "Fly one more flight like b.csv" in cause.sentence
    assert "  travel: 0.8 deg, at -20 to 20 deg/s" in result.lines


def test_causes_are_left_out_until_no_axis_is_worse() -> None:
    errors_deg = {NONE: 1.0, BOTH: 1.48, frozenset({LAG_EFFECT}): 1.2, frozenset({SPRING}): 1.6}
    result = saved(errors_deg, fitted_deg_s=5.0)
    assert not result.rig.effects
    assert [cause.effect for cause in result.left_out] == [SPRING, LAG_EFFECT]
    assert "fly a plan with 20 deg/s" in result.left_out[0].sentence


def test_growth_below_a_tenth_of_a_count_is_no_reason() -> None:
    result = saved({NONE: 0.04, BOTH: 0.048})
    assert set(result.rig.effects) == BOTH


def term_result(ratio: float) -> tuple[SavedRig, Rig]:
    """Save a rig with a proposed equation, with which the error of travel changes by a ratio."""
    term_rig = rig_with(["proposed_term"])

    class Forecaster:
        count_deg = np.full(3, COUNT_DEG)
        judged: Sequence[Any] = ()

        def __call__(self, rig: Rig) -> list[Forecasts]:
            return [forecasts_with_errors(np.array([0.1, 0.5, 1.0]))]

    def rig(_name: str, **choice: Any) -> Rig:
        return term_rig if choice.get("with_term") else rig_with([])

    result: Any = SimpleNamespace(
        confirmed_ids=[],
        rig=rig,
        proposal=SimpleNamespace(term=SimpleNamespace(discovery=SimpleNamespace(hypothesis=None))),
        assessment=SimpleNamespace(before=SimpleNamespace(fit=SimpleNamespace(problem=FITTED))),
    )
    forecast: Any = Forecaster()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rig_module, "model_and_rig", lambda _: (None, None))
        with_term = [forecasts_with_errors(np.array([0.1, 0.5, ratio]))]
        patch.setattr(rig_module, "forecast_flights", lambda *_: with_term)
        saved = saved_rig(result, "mine", forecast, with_unconfirmed=False, with_term=True)
    return saved, term_rig


def test_a_proposed_equation_is_saved_only_if_no_axis_is_forecast_worse() -> None:
    better, term_rig = term_result(0.8)
    assert better.has_term and better.rig is term_rig and not better.left_out
    worse, _ = term_result(1.3)
    assert not worse.has_term and not worse.rig.effects
    (cause,) = worse.left_out
    assert cause.sentence.startswith("the proposed equation is left out of the rig: with it, the forecast")
    assert saved_json(worse)["left_out"][0]["ratio"] == pytest.approx(1.3)


def test_an_identified_rig_states_each_axis_that_it_forecasts_worse() -> None:
    after, before = ([forecasts_with_errors(np.array([0.1, 0.5, travel_deg]))] for travel_deg in (1.4, 1.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            rig_module, "forecast_flights", lambda model, *_: before if model == "before" else after
        )
        patch.setattr(rig_module, "_count_deg", lambda *_: np.full(3, COUNT_DEG))
        model_before, model_after = cast(Any, "before"), cast(Any, "after")
        comparison = compare_rigs(
            RigModel(model_before, RIG), RigModel(model_after, RIG), judged=[], fitted=FITTED.records
        )
    assert comparison.worse == ("travel",)
    assert comparison_json(comparison)["axis"]["travel"]["ratio"] == pytest.approx(1.4)
    assert "the forecast error of travel at 1 s is 1.40 times that of the rig before" in comparison.lines[0]
    assert "Fly one more flight like b.csv" in comparison.lines[0]


def test_the_rig_file_has_the_lines_as_comments(tmp_path: Path) -> None:
    result = saved({NONE: 1.0, BOTH: 0.9})
    path = tmp_path / "mine.toml"
    write_rig(rig_with([]), path, "\n".join(["Found by a test.", *result.lines]))
    lines = path.read_text().splitlines()
    assert lines[:2] == [
        "# Found by a test.",
        "# Forecast error at 1 s, rms on b.csv, at front 1.0 to 2.0 V, back 1.1 to 2.1 V:",
    ]
    assert lines[2:5] == [
        "#   elevation: 0.1 deg, at -5 to 5 deg/s",
        "#   pitch: 0.5 deg, at -40 to 40 deg/s",
        "#   travel: 0.9 deg, at -20 to 20 deg/s",
    ]
    assert load_rig(path).name == "mine"
