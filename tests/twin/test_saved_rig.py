"""A saved rig has no cause with which an axis is forecast worse, and states its forecast errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.watch import saved_rig as module
from heli_lab.watch.forecast import Forecasts, HORIZONS_s
from heli_lab.watch.saved_rig import SavedRig, compare_rigs, comparison_json, saved_json, saved_rig
from heli_sim.rig import Number, Rig, load_rig, write_rig

RIG = load_rig("makki2024")
SECONDS, COUNT_DEG = 60.0, 0.09
LAG, SPRING = "rotor_lag", "cable_spring.travel"


def rig_with(effects: Sequence[str]) -> Rig:
    numbers = {effect: {"s": Number(0.1, "s", 0.0, "test")} for effect in effects}
    return Rig("mine", "test", RIG.numbers, numbers, "multibody")


def forecasts_with_errors(errors_deg: Floats, label: str = "b.csv") -> Forecasts:
    """Return forecasts with the same error of each axis, (3,), at all horizons and starts."""
    start_s = np.arange(0.0, SECONDS, 0.2)
    path_s = np.linspace(0.0, 5.0, 51)
    path_rad = np.broadcast_to(np.deg2rad(errors_deg), (len(start_s), len(path_s), 3))
    return Forecasts(
        label,
        start_s,
        np.zeros((len(start_s), 3)),
        np.zeros((len(start_s), len(HORIZONS_s), 3)),
        path_s,
        path_rad,
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
        return rig_with([LAG, SPRING] if only is None else only)

    result: Any = SimpleNamespace(
        confirmed_ids=[LAG, SPRING],
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
BOTH, NONE = frozenset({LAG, SPRING}), frozenset[str]()


def test_causes_with_better_forecasts_are_all_saved() -> None:
    result = saved({NONE: 1.0, BOTH: 1.09})
    assert set(result.rig.effects) == BOTH and not result.left_out


def test_the_cause_that_makes_an_axis_worse_is_left_out_with_the_reason() -> None:
    errors_deg = {NONE: 1.0, BOTH: 1.48, frozenset({LAG}): 0.8, frozenset({SPRING}): 1.6}
    result = saved(errors_deg)
    assert set(result.rig.effects) == {LAG}
    (cause,) = result.left_out
    assert cause.effect == SPRING
    assert "the forecast error of travel at 1 s grows by 48 % (1 to 1.48 deg)" in cause.sentence
    assert "Fly one more flight like b.csv" in cause.sentence
    assert "  travel: 0.8 deg, at -20 to 20 deg/s" in result.lines


def test_causes_are_left_out_until_no_axis_is_worse() -> None:
    errors_deg = {NONE: 1.0, BOTH: 1.48, frozenset({LAG}): 1.2, frozenset({SPRING}): 1.6}
    result = saved(errors_deg, fitted_deg_s=5.0)
    assert not result.rig.effects
    assert [cause.effect for cause in result.left_out] == [SPRING, LAG]
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
        patch.setattr(module, "model_and_rig", lambda _: (None, None))
        with_term = [forecasts_with_errors(np.array([0.1, 0.5, ratio]))]
        patch.setattr(module, "forecast_flights", lambda *_: with_term)
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
        patch.setattr(module, "forecast_flights", lambda model, *_: before if model == "before" else after)
        patch.setattr(module, "_count_deg", lambda *_: np.full(3, COUNT_DEG))
        model_before, model_after = cast(Any, "before"), cast(Any, "after")
        comparison = compare_rigs((model_before, RIG), (model_after, RIG), [], FITTED.records)
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
