"""The parts of a diagnosis, each against something that knows better."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_host.fly.plan import Plan
from heli_lab.diagnose.cause_parameters import reported_std
from heli_lab.diagnose.experiment_design import compose_experiment, segment_for
from heli_lab.diagnose.spline_term import KNOTS, bspline_basis, channel_quantity_pairs, knot_span
from heli_lab.identify import Fit
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


def stds_of(id_: str, **numbers: tuple[str, float, float]) -> dict[str, float]:
    """Standard errors as told, of numbers by name with unit, value and the fit's own standard error."""
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
