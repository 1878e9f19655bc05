"""A saved rig has no cause with which an axis is forecast worse, and states its forecast errors."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.watch import saved_rig as module
from heli_lab.watch.forecast import Forecasts, HORIZONS_s
from heli_lab.watch.saved_rig import SavedRig, saved_rig
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
    )


def saved(
    monkeypatch: pytest.MonkeyPatch, travel_deg: dict[frozenset[str], float], fitted_deg_s: float = 20.0
) -> SavedRig:
    """Save the rig of a diagnosis with lag and spring; travel has the given error for each set of causes."""

    class Forecaster:
        count_deg = np.full(3, COUNT_DEG)

        def __init__(self, *_: Any) -> None: ...

        def __call__(self, rig: Rig) -> list[Forecasts]:
            return [forecasts_with_errors(np.array([0.1, 0.5, travel_deg[frozenset(rig.effects)]]))]

    t_s = np.arange(0.0, 20.0, 0.01)
    travel_rad = np.deg2rad(fitted_deg_s) * t_s
    record = SimpleNamespace(
        step_s=0.01,
        segments=((0, len(t_s)),),
        angles_rad=np.column_stack((np.zeros_like(t_s), np.zeros_like(t_s), travel_rad)),
    )
    problem = SimpleNamespace(records=[record])

    def rig(_name: str, *, with_unconfirmed: bool = False, only: Sequence[str] | None = None) -> Rig:
        assert not with_unconfirmed
        return rig_with([LAG, SPRING] if only is None else only)

    result: Any = SimpleNamespace(
        confirmed_ids=[LAG, SPRING],
        rig=rig,
        assessment=SimpleNamespace(before=SimpleNamespace(fit=SimpleNamespace(problem=problem))),
    )
    monkeypatch.setattr(module, "_Forecaster", Forecaster)
    return saved_rig(result, "mine", [], lambda _: None, with_unconfirmed=False)  # type: ignore[arg-type, return-value]


BOTH, NONE = frozenset({LAG, SPRING}), frozenset[str]()


def test_causes_with_better_forecasts_are_all_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    result = saved(monkeypatch, {NONE: 1.0, BOTH: 1.09})
    assert set(result.rig.effects) == BOTH and not result.left_out


def test_the_cause_that_makes_an_axis_worse_is_left_out_with_the_reason(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    errors_deg = {NONE: 1.0, BOTH: 1.48, frozenset({LAG}): 0.8, frozenset({SPRING}): 1.6}
    result = saved(monkeypatch, errors_deg)
    assert set(result.rig.effects) == {LAG}
    (cause,) = result.left_out
    assert cause.effect == SPRING
    assert "the forecast error of travel at 1 s grows by 48 % (1 to 1.48 deg)" in cause.sentence
    assert "Fly one more flight like b.csv" in cause.sentence
    assert "  travel: 0.8 deg, at -20 to 20 deg/s" in result.lines


def test_causes_are_left_out_until_no_axis_is_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    errors_deg = {NONE: 1.0, BOTH: 1.48, frozenset({LAG}): 1.2, frozenset({SPRING}): 1.6}
    result = saved(monkeypatch, errors_deg, fitted_deg_s=5.0)
    assert not result.rig.effects
    assert [cause.effect for cause in result.left_out] == [SPRING, LAG]
    assert "fly a plan with 20 deg/s" in result.left_out[0].sentence


def test_growth_below_a_tenth_of_a_count_is_no_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    result = saved(monkeypatch, {NONE: 0.04, BOTH: 0.048})
    assert set(result.rig.effects) == BOTH


def test_the_rig_file_has_the_lines_as_comments(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    result = saved(monkeypatch, {NONE: 1.0, BOTH: 0.9})
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
