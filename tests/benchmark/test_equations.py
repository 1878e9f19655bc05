"""Unlisted equations: many kinds, and MuJoCo flies the same definition that a reference fit uses."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from heli_benchmark.cases.clean import clean_cases
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.cases.removed_effects import REMOVED, removed_effect_cases
from heli_benchmark.cases.unlisted_equations import equation_cases
from heli_benchmark.effects.equations import EQUATIONS, MakeUnlisted
from heli_benchmark.engine.plant import Moment
from heli_benchmark.runs.equation_reference import true_equation_effect
from heli_benchmark.runs.equations import equation_summary
from heli_benchmark.runs.removed_effects import removed_effect_summary
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

CASES = equation_cases()


def test_25_equations_and_more_come_in_two_sizes_with_unique_seeds() -> None:
    assert len(EQUATIONS) >= 25
    assert len(CASES) == 2 * len(EQUATIONS)
    others = [*clean_cases(), *disturbed_cases()]
    assert len({case.seed for case in (*CASES, *others)}) == len(CASES) + len(others)
    assert all(max(case.disturbances.gusts_Nm) > 0.0 for case in CASES)
    assert 0.4 < np.mean([bool(case.effects) for case in CASES]) < 0.6
    names = {case.name for case in CASES}
    assert names == {f"law-{law}-{size}" for law in EQUATIONS for size in ("small", "large")}


@pytest.mark.medium
@pytest.mark.parametrize("name", EQUATIONS)
def test_mujoco_flies_the_equation_that_the_reference_fit_uses(name: str) -> None:
    hidden = MakeUnlisted(name)(0.1, np.random.default_rng(1))
    effect = true_equation_effect(hidden)
    model, plain = MultibodyModel((effect,)), MultibodyModel()
    rig = load_rig("makki2024")
    rng = np.random.default_rng(2)
    x, late = rng.uniform(-0.8, 0.8, 6), 0.3 if effect.states else 0.0
    volts = np.array([2.2, 2.6])
    thrust_N = rig["thrust_gain"].value * (volts - rig["dead_zone"].value)
    hidden._late = late
    at = Moment(0.0, 0.0, volts, thrust_N.copy(), x[:3], x[3:])
    hidden.thrust(at)
    hidden.torque(at)
    more = [late] if effect.states else []
    u, t = ca.SX(volts), ca.SX(0.0)
    fitted = ca.evalf(model.dynamics(ca.SX([*x, *more]), u, ca.SX(model.parameter_values(rig)), t))[3:6]
    # The same forces, handed to the plain model as such.
    operands = plain.driven(ca.SX(x), u, ca.SX(plain.parameter_values(rig)), t)
    friction = [-rig[f"friction_{axis}"].value * w for axis, w in zip(_AXES, x[3:], strict=True)]
    steady = [rig[f"torque_{axis}"].value for axis in _AXES]
    torque = ca.SX(at.torque_Nm + np.array(friction) + np.array(steady))
    flown = ca.evalf(plain.acceleration(operands, ca.SX(at.thrust_N), torque))
    # What is remembered moves on by half a millisecond.
    np.testing.assert_allclose(np.asarray(fitted), np.asarray(flown), rtol=5e-3 if late else 1e-9, atol=1e-9)


_AXES = ("elevation", "pitch", "travel")


def test_twelve_listed_effects_are_taken_off_the_list_one_by_one() -> None:
    cases = removed_effect_cases()
    assert len(cases) >= 12
    assert len({case.seed for case in (*cases, *CASES, *clean_cases(), *disturbed_cases())}) == len(
        cases
    ) + len((*CASES, *clean_cases(), *disturbed_cases()))
    kinds = catalogue()
    for case in cases:
        name = case.effects[-1][0]
        assert {name, *REMOVED[name]} <= kinds.keys()
        assert not {name, *REMOVED[name]} & {listed for listed, _ in case.effects[:-1]}


def test_a_law_in_an_effects_place_counts_if_it_flies_and_takes_most_of_the_error() -> None:
    row: dict[str, Any] = {"expression": "x", "flies": "completed", "share": 0.85}
    rows: dict[str, dict[str, Any]] = {
        "good": row,
        "poor": row | {"share": 0.7},
        "falls": row | {"flies": "limit"},
        "none": {"expression": None, "share": 1.0},
        "died": {"failure": "died"},
    }
    summary = removed_effect_summary(rows)
    assert summary.startswith("effects removed: 4, equations proposed 3, flown 2")
    assert summary.endswith("of the effect 1")


def test_only_visible_equations_count_and_a_proposal_without_one_is_counted() -> None:
    rows: dict[str, dict[str, Any]] = {
        "law-a": {"visibility": {"off-a": 20.0}, "expression": "x", "correlation": 0.95, "error_ratio": 1.1},
        "law-b": {"visibility": {"off-b": 20.0}, "expression": None},
        "law-c": {"visibility": {"off-c": 9.0}, "expression": None},
        "w-nothing-1": {"visibility": {}, "expression": "y"},
        "w-nothing-2": {"failure": "died"},
    }
    summary = equation_summary(rows)
    assert "visible equations: 2, proposed 1" in summary
    assert "where none is hidden: 1 of 1" in summary
