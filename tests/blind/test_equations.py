"""Laws on no list: many, of many kinds, each flown by MuJoCo as a fit is told it."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.blind.cases import every_case
from tests.blind.disturbed_cases import disturbed_cases
from tests.blind.equation_cases import equation_cases
from tests.blind.equation_oracle import told_effect
from tests.blind.equation_run import summary
from tests.blind.equations import LAWS, Makes
from tests.blind.mujoco_rig import Moment
from tests.blind.taken_off import TAKEN_OFF, taken_off_cases
from tests.blind.taken_off_run import summary as summary_in_place

CASES = equation_cases()


def test_twenty_five_laws_and_more_come_in_two_sizes_with_seeds_of_their_own_in_weather() -> None:
    assert len(LAWS) >= 25
    assert len(CASES) == 2 * len(LAWS)
    others = [*every_case(), *disturbed_cases()]
    assert len({one.seed for one in (*CASES, *others)}) == len(CASES) + len(others)
    assert all(max(one.disturbances.gusts_Nm) > 0.0 for one in CASES)
    assert 0.4 < np.mean([bool(one.effects) for one in CASES]) < 0.6
    names = {one.name for one in CASES}
    assert names == {f"law-{law}-{size}" for law in LAWS for size in ("small", "large")}


@pytest.mark.medium
@pytest.mark.parametrize("name", LAWS)
def test_what_mujoco_flies_is_what_a_fit_is_told(name: str) -> None:
    hidden = Makes(name)(0.1, np.random.default_rng(1))
    effect = told_effect(hidden)
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
    told = ca.evalf(model.dynamics(ca.SX([*x, *more]), u, ca.SX(model.parameter_values(rig)), t))[3:6]
    # The same forces, handed to the plain model as such.
    operands = plain.driven(ca.SX(x), u, ca.SX(plain.parameter_values(rig)), t)
    friction = [-rig[f"friction_{axis}"].value * w for axis, w in zip(_AXES, x[3:], strict=True)]
    steady = [rig[f"torque_{axis}"].value for axis in _AXES]
    torque = ca.SX(at.torque_Nm + np.array(friction) + np.array(steady))
    flown = ca.evalf(plain.acceleration(operands, ca.SX(at.thrust_N), torque))
    # What is remembered moves on by half a millisecond.
    np.testing.assert_allclose(np.asarray(told), np.asarray(flown), rtol=5e-3 if late else 1e-9, atol=1e-9)


_AXES = ("elevation", "pitch", "travel")


def test_twelve_listed_effects_are_taken_off_the_list_one_by_one() -> None:
    cases = taken_off_cases()
    assert len(cases) >= 12
    assert len({one.seed for one in (*cases, *CASES, *every_case(), *disturbed_cases())}) == len(cases) + len(
        (*CASES, *every_case(), *disturbed_cases())
    )
    kinds = catalogue()
    for case in cases:
        name = case.effects[-1][0]
        assert {name, *TAKEN_OFF[name]} <= kinds.keys()
        assert not {name, *TAKEN_OFF[name]} & {one for one, _ in case.effects[:-1]}


def test_a_law_in_an_effects_place_counts_if_it_flies_and_takes_most_of_the_error() -> None:
    row: dict[str, Any] = {"expression": "x", "flies": "completed", "share": 0.85}
    rows: dict[str, dict[str, Any]] = {
        "good": row,
        "poor": row | {"share": 0.7},
        "falls": row | {"flies": "limit"},
        "none": {"expression": None, "share": 1.0},
        "died": {"failure": "died"},
    }
    said = summary_in_place(rows)
    assert said.startswith("effects off the list: 4, laws proposed 3, that fly 2")
    assert said.endswith("would 1")


def test_only_visible_laws_count_and_each_law_on_nothing_is_told() -> None:
    rows: dict[str, dict[str, Any]] = {
        "law-a": {"told": {"off-a": 20.0}, "expression": "x", "correlation": 0.95, "error_ratio": 1.1},
        "law-b": {"told": {"off-b": 20.0}, "expression": None},
        "law-c": {"told": {"off-c": 9.0}, "expression": None},
        "w-nothing-1": {"told": {}, "expression": "y"},
        "w-nothing-2": {"failure": "died"},
    }
    said = summary(rows)
    assert "visible laws: 2, proposed 1" in said
    assert "none is: 1 of 1" not in said
    assert "where there is none: 1 of 1" in said
