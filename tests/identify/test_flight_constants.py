"""What one flight has of its own, and what is known of it beforehand."""

from __future__ import annotations

from dataclasses import replace

import pytest
from heli_lab.identify.free import FLIGHT_CONSTANTS, flight_constants
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig, load_rig


def stated(rig: Rig, **tolerances: float) -> Rig:
    """A rig with these tolerances."""
    numbers = dict(rig.numbers)
    for name, tolerance in tolerances.items():
        numbers[name] = replace(numbers[name], tolerance=tolerance)
    return replace(rig, numbers=numbers)


def test_rig_that_states_no_tolerance_still_has_cables_and_no_zero_to_find() -> None:
    rig = stated(load_rig("makki2024"), torque_pitch=0.0, offset_pitch=0.0)
    priors = flight_constants(MultibodyModel(), rig)
    assert set(priors) == set(FLIGHT_CONSTANTS) - {"offset_pitch"}
    assert priors["torque_pitch"].std == pytest.approx(0.01)


def test_fits_take_the_wider_of_rig_and_cables_and_other_flights_the_cables_about_what_was_found() -> None:
    rig = stated(load_rig("makki2024"), torque_pitch=0.3)
    assert flight_constants(MultibodyModel(), rig)["torque_pitch"].std == pytest.approx(0.15)
    other = flight_constants(MultibodyModel(), rig, {"torque_pitch": 0.05, "offset_elevation": 1.0})
    assert (other["torque_pitch"].mean, other["torque_pitch"].std) == pytest.approx((0.05, 0.01))
    assert other["offset_elevation"].mean == 1.0
    assert other["torque_travel"].mean == rig["torque_travel"].value
