"""Kicks are counted with their size, and gusts of constant strength contain none."""

from __future__ import annotations

import numpy as np
import pytest
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.residuals import kicks, with_impulse
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import FlightErrors, InnovationsModel
from heli_sim.model import MultibodyModel

from tests.estimation.made import RIG, flight_with_disturbances

pytestmark = [pytest.mark.diagnosis, pytest.mark.slow]

KICKS_Nms = {5.0: 30e-3, 11.0: -40e-3, 17.5: 25e-3, 24.0: -25e-3}


@pytest.fixture(scope="module")
def model() -> tuple[InnovationsModel, DisturbanceModel]:
    """A flight in gusts about all axes, with its estimate."""
    estimate = ModelComparison(MultibodyModel(), RIG, [flight_with_disturbances()], []).refit([]).estimate
    return estimate.filtered(), estimate.disturbances


def test_gusts_of_constant_strength_contain_no_kicks(
    model: tuple[InnovationsModel, DisturbanceModel],
) -> None:
    assert kicks(*model) == {}


def test_kicks_about_one_axis_are_counted_with_their_size(
    model: tuple[InnovationsModel, DisturbanceModel],
) -> None:
    filtered, disturbances = model
    (linearised,) = filtered.linearised_flights
    t_s = np.concatenate([linearised.nodes.t_s[blocks.rows] for blocks in linearised.blocks])
    error: FlightErrors = filtered.perturbed_residual()
    for at_s, size_Nms in KICKS_Nms.items():
        interval = int(np.argmin(np.abs(t_s - at_s)))
        # The torque of the model that is missing in the flight has the opposite sign of a kick.
        torque_Nm = -size_Nms / linearised.reference.step_s
        error = with_impulse(filtered, error, flight=0, interval=interval, axis=2, torque_Nm=torque_Nm)
    kicks_by_axis = kicks(filtered, disturbances, error)
    assert kicks_by_axis.keys() == {"travel"}
    assert kicks_by_axis["travel"].count == len(KICKS_Nms)
    assert kicks_by_axis["travel"].largest_Nms == pytest.approx(40e-3, rel=0.3)
