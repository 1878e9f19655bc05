"""The parts of a diagnosis, each against something that knows better."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.fly.plan import Plan
from heli_lab.diagnose.experiment_design import compose_experiment, segment_for
from heli_lab.diagnose.spline_term import KNOTS, bspline_basis, channel_quantity_pairs, knot_span
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.slow


def test_bspline_basis_has_a_sum_of_one_everywhere() -> None:
    values = np.linspace(-3.0, 5.0, 200)
    low, step = knot_span(values)
    assert bspline_basis(values, low, step).shape == (200, KNOTS)
    assert np.allclose(bspline_basis(values, low, step).sum(axis=1), 1.0)


def test_no_spline_of_a_measurement_on_thrust_is_tried() -> None:
    # The controller feeds the quantisation error back: such a term would be found in any flight.
    assert not [
        pair for pair in channel_quantity_pairs() if pair[0].startswith("measurement") and "thrust" in pair[1]
    ]


@pytest.mark.parametrize("parts", [(), ("motors",), ("fast",), ("travel", "time"), ("elevation",)])
def test_next_flight_is_a_plan_that_can_be_flown(parts: tuple[str, ...]) -> None:
    flight = compose_experiment("Why.", parts)
    plan = Plan.parse(flight.plan, "next flight")
    plan.check()
    assert plan.duration_s > 20.0


def test_every_effect_has_a_part_that_shows_it() -> None:
    assert {segment_for(kind) for kind in catalogue().values()} == {"motors", "travel", "elevation", "time"}
