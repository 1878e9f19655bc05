"""Constants of a single flight, and their priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heli_lab.fit.identification import Identification
from heli_lab.fit.problem import FLIGHT_CONSTANTS, Fit, Problem, flight_constants
from heli_lab.fit.records import Record
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig, load_rig


def with_tolerances(rig: Rig, **tolerances: float) -> Rig:
    """Return a rig with other tolerances, by parameter name."""
    numbers = dict(rig.numbers)
    for name, tolerance in tolerances.items():
        numbers[name] = replace(numbers[name], tolerance=tolerance)
    return replace(rig, numbers=numbers)


def test_without_tolerances_only_cable_torques_are_flight_constants() -> None:
    rig = with_tolerances(load_rig("makki2024"), torque_pitch=0.0, offset_pitch=0.0)
    priors = flight_constants(MultibodyModel(), rig)
    assert set(priors) == set(FLIGHT_CONSTANTS) - {"offset_pitch"}
    assert priors["torque_pitch"].std == pytest.approx(0.01)


def test_prior_of_a_constant_is_wide_in_fits_and_narrow_for_other_flights() -> None:
    rig = with_tolerances(load_rig("makki2024"), torque_pitch=0.3)
    assert flight_constants(MultibodyModel(), rig)["torque_pitch"].std == pytest.approx(0.15)
    other = flight_constants(MultibodyModel(), rig, {"torque_pitch": 0.05, "offset_elevation": 1.0})
    assert (other["torque_pitch"].mean, other["torque_pitch"].std) == pytest.approx((0.05, 0.01))
    assert other["offset_elevation"].mean == 1.0
    assert other["torque_travel"].mean == rig["torque_travel"].value


def flown(label: str) -> Record:
    """Make a record of two seconds; these tests do not use its values."""
    rows = 200
    still = np.zeros((rows, 3))
    return Record(
        label, np.arange(rows) / 100.0, still, still[:, :2], 0.01, np.full(3, 1e-3), ((0, rows),), ()
    )


@pytest.mark.medium
def test_rig_of_several_flights_has_their_mean_torque_and_no_zero() -> None:
    model, rig = MultibodyModel(), load_rig("makki2024")
    free = ("friction_pitch", "torque_pitch", "offset_pitch")
    problem = Problem(model, rig, [flown("a"), flown("b")], free=free, per_flight=FLIGHT_CONSTANTS)
    estimates = {
        "friction_pitch": 0.02,
        "torque_pitch[a]": 0.01,
        "torque_pitch[b]": 0.03,
        "offset_pitch[a]": 0.5,
        "offset_pitch[b]": 0.7,
    }
    theta = np.array([estimates[name] for name in problem.names])
    covariance = np.diag(np.full(len(theta), 0.001**2))
    fit = Fit(problem, theta, covariance, covariance, (), (), (), 0.0, (), 1, 0.0, True)
    numbers = Identification(fit, (), (), (), ()).rig("found").numbers
    assert (numbers["friction_pitch"].value, numbers["friction_pitch"].tolerance) == (
        pytest.approx((0.02, 0.002))
    )
    assert numbers["torque_pitch"].value == pytest.approx(0.02)
    # A tolerance is two standard deviations: that of the estimates, and that of cables from day to day.
    assert numbers["torque_pitch"].tolerance == pytest.approx(2.0 * np.hypot(0.001, np.sqrt(2.0) * 0.01))
    assert numbers["offset_pitch"] == rig["offset_pitch"]
