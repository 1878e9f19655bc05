"""Effects that flights hardly distinguish have one comparable number, whatever their equation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.explain.verdict import CauseParameter, FamilyNumber, family_number
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

KINDS = catalogue()
LAG, DELAY = "rotor_lag_with_delay_lag_s", "rotor_lag_with_delay_delay_s"


def test_lag_and_dead_time_add_up_with_their_covariance() -> None:
    covariance = np.array([[4e-6, 0.0, -3.5e-6], [0.0, 1.0, 0.0], [-3.5e-6, 0.0, 4e-6]])
    problem = SimpleNamespace(names=(LAG, "thrust_gain", DELAY))
    std = dict(zip(problem.names, np.sqrt(np.diag(covariance)), strict=True))
    fit = cast(Any, SimpleNamespace(problem=problem, covariance=covariance, std=std))
    parameters = {LAG: CauseParameter(0.11, 2e-3, "s"), DELAY: CauseParameter(0.02, 2e-3, "s")}
    lag = family_number(fit, KINDS["rotor_lag_with_delay"], KINDS, parameters)
    assert lag is not None
    assert (lag.value, lag.unit) == (pytest.approx(0.13), "s")
    # The variances add up to 8e-6 s^2, less twice the covariance of 3.5e-6 s^2.
    assert lag.std == pytest.approx(1e-3)
    assert "0.1300 ± 0.0010 s" in lag.sentence
    assert lag.members == ("rotor_lag", "rotor_speed_lag", "rotor_lag_with_delay")
    assert family_number(fit, KINDS["axis_tilt"], KINDS, {}) is None


TILT_rad = 0.1


def number(id_: str, arm_m: float, *ambiguous_with: str, **sizes: float) -> FamilyNumber | None:
    """Return the family's number of an effect with these sizes; the standard error of each is 1 % of the
    arm.
    """
    kind = KINDS[id_]
    values = {kind.full(name): value for name, value in sizes.items()}
    std = dict.fromkeys(values, 0.01 * arm_m)
    fit = SimpleNamespace(
        problem=SimpleNamespace(names=(*values, "L_a"), rig=load_rig("makki2024")),
        covariance=np.diag([error**2 for error in (*std.values(), 0.0)]),
        values={**values, "L_a": arm_m},
        std=std,
    )
    parameters = {name: CauseParameter(value, std[name], "") for name, value in values.items()}
    return family_number(cast(Any, fit), kind, KINDS, parameters, ambiguous_with)


def test_zero_error_of_pitch_and_reaction_torque_have_the_same_tilt() -> None:
    arm_m = 0.7
    zero, torque = KINDS["zero_offset.pitch"], KINDS["rotor_reaction_torque"]
    of_zero = number(zero.id, 1.0, torque.id, rad=TILT_rad)
    torque_per_thrust_m = -TILT_rad * arm_m
    of_torque = number(torque.id, arm_m, zero.id, front_m=torque_per_thrust_m, back_m=torque_per_thrust_m)
    assert of_zero is not None
    assert of_torque is not None
    assert of_zero.value == pytest.approx(TILT_rad)
    assert of_torque.value == pytest.approx(TILT_rad)
    assert of_torque.std == pytest.approx(0.01 / np.sqrt(2.0))
    assert of_zero.unit == of_torque.unit == "rad"
    assert "5.7 \u00b1 0.6 deg" in of_zero.sentence
    assert of_zero.members == of_torque.members == (torque.id, zero.id)


def test_a_tilt_has_no_number_where_flights_distinguish_its_causes() -> None:
    id_ = "rotor_reaction_torque"
    assert number(id_, 0.7, front_m=0.05, back_m=-0.05) is None
    assert number(id_, 0.7, "encoder_eccentricity.pitch", front_m=0.05, back_m=-0.05) is None


def test_a_zero_error_of_elevation_has_no_family() -> None:
    assert KINDS["zero_offset.elevation"].family is None
    assert KINDS["zero_offset.pitch"].family == KINDS["rotor_reaction_torque"].family is not None
