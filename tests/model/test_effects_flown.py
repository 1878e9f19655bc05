"""An effect that the simulated board has flown is found in its log: some of `python -m tests.model.flown`."""

from __future__ import annotations

import pytest
from heli_sim.model.effects import catalogue

from tests.model.flown import fly_and_identify
from tests.running.long import samples

pytestmark = pytest.mark.slow

# A state more, a moment to find, a jump; and then others of these kinds.
SHARE = (
    *("rotor_lag", "thrust_step.front", "backlash.pitch"),
    *("rotor_speed_lag", "ground_effect", "coulomb_friction.elevation", "periodic_torque.travel"),
)


@pytest.mark.parametrize("id", SHARE[: samples(len(SHARE), 3)])
def test_a_flown_effect_is_found_within_three_standard_errors(id: str) -> None:
    estimate = fly_and_identify(catalogue()[id])
    assert max(abs(off) for off in estimate.off.values()) < 3.0
    assert estimate.normalised < 1.05
