"""Plans of proposed experiments."""

from __future__ import annotations

import pytest
from heli_host.fly.plan import Plan
from heli_lab.explain.experiment_design import compose_experiment, segment_for
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.medium


@pytest.mark.parametrize("parts", [(), ("motors",), ("fast",), ("travel", "time"), ("elevation",)])
def test_next_flight_is_a_plan_that_can_be_flown(parts: tuple[str, ...]) -> None:
    flight = compose_experiment("Why.", parts)
    plan = Plan.parse(flight.plan, "next flight")
    plan.check()
    assert plan.duration_s > 20.0


def test_every_effect_has_a_part_that_shows_it() -> None:
    assert {segment_for(kind) for kind in catalogue().values()} == {"motors", "travel", "elevation", "time"}
