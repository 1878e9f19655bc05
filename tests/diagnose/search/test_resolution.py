"""Resolution: standard errors that the flights support, and sizes that differ from zero by them."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_lab.explain import thresholds
from heli_lab.explain.candidates import typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit
from heli_lab.explain.forward import Acceptance, is_resolved, limited_std, time_std_s
from heli_lab.fit.records import Record
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.medium

KINDS = catalogue()
STEP_s = 0.004
COUNT_rad = {"elevation": 0.002, "pitch": 0.002, "travel": 0.001}
RECORD = cast(Record, SimpleNamespace(step_s=STEP_s, count_rad=np.array([*COUNT_rad.values()])))


def stds_of(id_: str, **numbers: tuple[float, float]) -> dict[str, float]:
    """Return limited standard errors by name; `numbers` has estimate and standard error of the fit."""
    values = {name: value for name, (value, _) in numbers.items()}
    std = {name: std for name, (_, std) in numbers.items()}
    return limited_std(KINDS[id_], values, {**std, "thrust_gain": 0.1}, RECORD)


def test_no_standard_error_is_finer_than_steps_samples_and_counts_resolve() -> None:
    lag = stds_of("rotor_lag", rotor_lag_s=(0.1, 1e-6))
    # Half a sample, and 0.7 % of a size.
    assert lag == {"rotor_lag_s": pytest.approx(np.hypot(0.002, 0.0007), rel=1e-3)}
    step = stds_of(
        "thrust_step.front", thrust_step_front_share=(-0.2, 1e-6), thrust_step_front_at_s=(20.0, 0.03)
    )
    assert step["thrust_step_front_share"] == pytest.approx(0.0014, rel=1e-3)
    # A moment is no size.
    assert step["thrust_step_front_at_s"] == pytest.approx(np.hypot(1.4 * 0.03, 0.002))
    for axis, count_rad in COUNT_rad.items():
        (std,) = stds_of(f"backlash.{axis}", **{f"backlash_{axis}_rad": (0.0, 1e-6)}).values()
        assert std == pytest.approx(0.5 * count_rad, rel=1e-3)
    spring = stds_of("cable_spring.travel", cable_spring_travel_rest_rad=(0.3, 1e-6))
    assert spring["cable_spring_travel_rest_rad"] == 1e-6


def test_a_time_is_no_more_certain_than_half_a_step() -> None:
    assert time_std_s(0.0, STEP_s) == pytest.approx(0.5 * STEP_s)
    assert time_std_s(0.01, STEP_s) == pytest.approx(np.hypot(0.014, 0.5 * STEP_s))


@pytest.mark.parametrize(
    ("id_", "size", "too_small", "large_enough"),
    [
        # Two standard errors: a step of the voltages, or a count of the encoder.
        ("input_delay", "input_delay_s", 0.9 * STEP_s, 1.1 * STEP_s),
        ("backlash.travel", "backlash_travel_rad", 0.9 * COUNT_rad["travel"], 1.1 * COUNT_rad["travel"]),
        ("backlash.pitch", "backlash_pitch_rad", 0.9 * COUNT_rad["pitch"], 1.1 * COUNT_rad["pitch"]),
    ],
)
def test_delays_below_a_step_and_plays_below_a_count_are_not_significant(
    id_: str, size: str, too_small: float, large_enough: float
) -> None:
    comparison = cast(ModelComparison, SimpleNamespace(train=(RECORD,)))
    acceptance = Acceptance(comparison, KINDS)
    candidate = typical_candidate(KINDS[id_])
    for value, is_visible in ((too_small, False), (large_enough, True)):
        hypothesis = cast(Hypothesis, SimpleNamespace(values={size: value}, std={size: 1e-6}))
        assert is_resolved(hypothesis, KINDS[id_], RECORD) is is_visible
        assert acceptance.is_significant(Refit(hypothesis, 30.0, 8.0, 0.0), candidate) is is_visible
        # Evidence that is large for any size overrides the resolution: flights without disturbances.
        large = Refit(hypothesis, thresholds.WALD_OVERRIDE_NATS + 9.0, 8.0, 0.0)
        assert acceptance.is_significant(large, candidate)


@pytest.mark.parametrize(
    "id_",
    [
        *("elevation_drag_quadratic", "pitch_drag_quadratic", "travel_drag_quadratic"),
        *("inflow_damping", "supply_sag", "ground_effect", "edgewise_flow"),
    ],
)
def test_effects_that_physics_allows_in_one_direction_have_no_negative_size(id_: str) -> None:
    (size,) = KINDS[id_].size
    assert KINDS[id_].priors[size].low == 0.0
