"""The extended rig: reported standard errors, and the means of parameters that differ between flights."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_lab.diagnose.evaluate import reported_std
from heli_lab.diagnose.extended_rig import extended_rig
from heli_lab.identify import Fit, Problem
from heli_lab.identify.flight_model import RigParameters
from heli_lab.identify.record import Record
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

pytestmark = pytest.mark.medium


def stds_of(id_: str, **numbers: tuple[str, float, float]) -> dict[str, float]:
    """Return reported standard errors by name; `numbers` has unit, estimate and standard error of the fit."""
    fit = SimpleNamespace(
        problem=SimpleNamespace(
            records=[SimpleNamespace(step_s=0.004, count_rad=np.array([0.002, 0.002, 0.001]))],
            free=[SimpleNamespace(name=name, unit=unit) for name, (unit, _, _) in numbers.items()],
        ),
        std={name: std for name, (_, _, std) in numbers.items()},
        values={name: value for name, (_, value, _) in numbers.items()},
    )
    return reported_std(cast(Fit, fit), catalogue()[id_])


def test_no_standard_error_is_finer_than_steps_samples_and_counts_resolve() -> None:
    lag = stds_of("rotor_lag", rotor_lag_s=("s", 0.1, 1e-6))
    # Half a sample, and 0.7 % of a size.
    assert lag["rotor_lag_s"] == pytest.approx(np.hypot(0.002, 0.0007), rel=1e-3)
    step = stds_of(
        "thrust_step.front",
        thrust_step_front_share=("1", -0.2, 1e-6),
        thrust_step_front_at_s=("s", 20.0, 0.03),
    )
    assert step["thrust_step_front_share"] == pytest.approx(0.0014, rel=1e-3)
    # A moment is no size.
    assert step["thrust_step_front_at_s"] == pytest.approx(np.hypot(1.4 * 0.03, 0.002))
    for axis, count_rad in (("pitch", 0.002), ("travel", 0.001)):
        (std,) = stds_of(f"backlash.{axis}", **{f"backlash_{axis}_rad": ("rad", 0.0, 1e-6)}).values()
        assert std == pytest.approx(0.5 * count_rad, rel=1e-3)
    spring = stds_of("cable_spring.travel", cable_spring_travel_rest_rad=("rad", 0.3, 1e-6))
    assert spring["cable_spring_travel_rest_rad"] == 1e-6


def test_extended_rig_of_several_flights_has_the_means_of_their_zeros_and_torques() -> None:
    rig, model = load_rig("makki2024"), MultibodyModel()
    records = [cast(Record, SimpleNamespace(label=label)) for label in "ab"]
    vector = RigParameters(model, rig, records)
    per_flight = {
        "offset_pitch[a]": 0.5,
        "offset_pitch[b]": 0.3,
        "torque_pitch[a]": 0.01,
        "torque_pitch[b]": 0.03,
    }
    problem = SimpleNamespace(
        rig=rig, model=model, records=records, free=vector.free, names=vector.names, parameter_vector=vector
    )
    fit = Fit(
        problem=cast(Problem, problem),
        theta=vector.started_from(per_flight),
        covariance=1e-8 * np.eye(len(vector.free)),
        information=1e8 * np.eye(len(vector.free)),
        states=(),
        variance=(),
        weights=(),
        cost=0.0,
        at_bound=(),
        evaluations=0,
        elapsed_s=0.0,
        converged=True,
    )
    numbers = extended_rig("extended", fit, {}, {}, None).numbers
    assert numbers["offset_pitch"].value == pytest.approx(0.4)
    assert numbers["torque_pitch"].value == pytest.approx(0.02)
    # The next flight has other zeros: the scatter of two, and never less than the rig file states.
    assert numbers["offset_pitch"].tolerance == pytest.approx(2.0 * np.std([0.5, 0.3], ddof=1))
    assert numbers["offset_elevation"].tolerance == rig["offset_elevation"].tolerance
