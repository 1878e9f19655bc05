"""Effects do what their one sentence says."""

from __future__ import annotations

import numpy as np
import pytest
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.linear import derivatives, linearise, trim
from heli_sim.plant import Plant
from heli_sim.rig import load_rig


def test_rotor_lag_reaches_63_percent_of_a_step_after_its_time_constant() -> None:
    rig = load_rig("makki2024")
    plant = Plant(MultibodyModel((RotorLag(0.12),)), rig)
    state = plant.rest_state()
    for _ in range(120):
        state, _ = plant.step(state, (2.0, 3.0), (True, True, True))
    full_N = rig["thrust_gain"].value * np.array([1.0, 2.0])
    assert state[6:] == pytest.approx(full_N * (1 - np.exp(-1)), rel=1e-6)


def test_rotor_lag_changes_no_hover_and_adds_a_pole_for_each_rotor() -> None:
    rig, lagging = load_rig("makki2024"), MultibodyModel((RotorLag(0.12),))
    at = trim(lagging, rig)
    assert at.volts_V == pytest.approx(trim(MultibodyModel(), rig).volts_V)
    assert derivatives(lagging, rig, at.state, at.volts_V).rates == pytest.approx(np.zeros(8), abs=1e-9)
    poles = linearise(lagging, rig).poles()
    assert np.sum(np.isclose(poles, -1 / 0.12)) == 2


@pytest.mark.parametrize("lag_s", [-0.1, float("nan")])
def test_a_lag_that_cannot_be_is_refused(lag_s: float) -> None:
    with pytest.raises(PlantError, match="leave the effect out"):
        RotorLag(lag_s)
