"""The parts of a forecast error add up, and what is unknown is stated only if a second flight confirms it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.report.diagnosis.text import error_share_rows, error_share_sentences
from heli_lab.watch import error_shares as module
from heli_lab.watch.error_shares import ErrorShares, error_shares, shares_json
from heli_lab.watch.forecast import Forecasts, HORIZONS_s
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig, load_rig

RIG = load_rig("makki2024")
SECONDS = 120.0
EVEN = (1.0, 1.0, 1.0)


def forecasts(label: str, rms_deg: Floats, expected_deg: Floats, factor_above_3_V: float = 1.0) -> Forecasts:
    """Return forecasts with normal errors of the given size, (3,), which are larger by a factor where the
    front voltage exceeds 3 V.
    """
    random = np.random.default_rng(len(label))
    start_s = np.arange(0.0, SECONDS, 0.2)
    k, path_s = len(start_s), np.linspace(0.0, 5.0, 51)
    front_V = random.uniform(1.0, 4.0, k)
    errors_rad = np.deg2rad(rms_deg) * random.normal(size=(k, 3))
    errors_rad *= np.where(front_V > 3.0, factor_above_3_V, 1.0)[:, None]
    return Forecasts(
        label,
        start_s,
        np.zeros((k, 3)),
        np.zeros((k, len(HORIZONS_s), 3)),
        path_s,
        np.repeat(errors_rad[:, None, :], len(path_s), axis=1),
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
        return [forecasts("judged.csv", rms_deg, expected_deg * even, on_judged)]

    dependence = SimpleNamespace(what="torque.travel on travel_rate near rest", matters=True)
    result: Any = SimpleNamespace(
        has_other_flight=True,
        rig=rig,
        curved=None,
        label="unexplained",
        verdict=SimpleNamespace(unlisted=()),
        assessment=SimpleNamespace(residual_analysis=SimpleNamespace(dependences=[dependence])),
    )
    fitted = [forecasts("fitted.csv", even, even, on_fitted)]
    monkeypatch.setattr(module, "forecast_flights", lambda *_: fitted)
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
