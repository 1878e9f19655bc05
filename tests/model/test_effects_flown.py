"""An effect that the simulated board has flown is found in its log: some of `python -m tests.model.flown`."""

from __future__ import annotations

import pytest
from heli_sim.model.effects import catalogue

from tests.model.flown import find

pytestmark = pytest.mark.slow

SHARE = ("rotor_lag", "rotor_speed_lag", "thrust_step.front", "ground_effect", "backlash.pitch")


@pytest.mark.parametrize("id", [*SHARE, "coulomb_friction.elevation", "periodic_torque.travel"])
def test_a_flown_effect_is_found_within_three_standard_errors(id: str) -> None:
    found = find(catalogue()[id])
    assert max(abs(off) for off in found.off.values()) < 3.0
    assert found.normalised < 1.05
