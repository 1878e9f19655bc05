"""A trim stays, Jacobians are those of finite differences, the linear model predicts the plant."""

from __future__ import annotations

import numpy as np
import pytest
from heli_sim.errors import PlantError
from heli_sim.model import Model, MultibodyModel, PaperModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.linear import derivatives, linearise, trim
from heli_sim.plant import Plant
from heli_sim.rig import load_rig

pytestmark = pytest.mark.slow

MODELS = [PaperModel(), MultibodyModel(), MultibodyModel((RotorLag(0.12),))]
WIDE = {"elevation_min": -89.0, "elevation_max": 89.0, "pitch_max": 179.0, "travel_max": 1e6}


@pytest.mark.parametrize("model", MODELS, ids=["paper", "multibody", "lag"])
@pytest.mark.parametrize("elevation_deg", [-15.0, 0.0, 15.0])
def test_a_trimmed_rig_stays_for_ten_seconds(model: Model, elevation_deg: float) -> None:
    rig = load_rig("makki2024").replace(**WIDE, M_f=0.36)
    at = trim(model, rig, np.radians(elevation_deg))
    plant = Plant(model, rig)
    ten_seconds = plant.function.fold(10_000)
    state, *_ = ten_seconds(at.state, at.volts_V, np.zeros(3), plant.parameters)
    np.testing.assert_allclose(np.ravel(state), at.state, atol=1e-6)


@pytest.mark.parametrize("model", MODELS, ids=["paper", "multibody", "lag"])
def test_jacobians_are_those_of_finite_differences(model: Model) -> None:
    rig = load_rig("makki2024")
    random = np.random.default_rng(5)
    state = random.uniform(-0.4, 0.4, len(model.states))
    volts_V = np.array([1.9, 2.3])
    exact, step = derivatives(model, rig, state, volts_V), 1e-6
    for column in range(len(state)):
        up, down = state.copy(), state.copy()
        up[column] += step
        down[column] -= step
        slope = derivatives(model, rig, up, volts_V).rates - derivatives(model, rig, down, volts_V).rates
        np.testing.assert_allclose(exact.A[:, column], slope / (2 * step), atol=1e-7)
    for column, name in enumerate(model.parameter_names):
        if name == "rotor_lag_s":
            continue
        number = rig[name].value
        up_rig, down_rig = (
            rig.replace(**{name: number + step}),
            rig.replace(**{name: max(number - step, 0.0)}),
        )
        slope = (
            derivatives(model, up_rig, state, volts_V).rates
            - derivatives(model, down_rig, state, volts_V).rates
        ) / (up_rig[name].value - down_rig[name].value)
        if number > 0.0:
            np.testing.assert_allclose(exact.P[:, column], slope, atol=1e-5)


def test_the_linear_model_predicts_small_motions_of_the_plant() -> None:
    # It reads pyplot and scipy.signal: a second for every worker, were it read with this file.
    import control

    model, rig = MultibodyModel((RotorLag(0.12),)), load_rig("makki2024").replace(**WIDE)
    at = trim(model, rig)
    linear = linearise(model, rig, at)
    times = np.arange(2001) * 1e-3
    pushed_V = np.column_stack((0.01 * np.sin(3 * times), 0.01 * np.sin(2 * times)))
    plant, state = Plant(model, rig), at.state
    seen = [state[:3]]
    for volts_V in pushed_V[:-1]:
        state, angles_rad = plant.step(state, at.volts_V + volts_V)
        seen.append(angles_rad)
    predicted = control.forced_response(linear, times, pushed_V.T).outputs
    moved = np.array(seen) - at.state[:3]
    assert np.abs(moved).max() > 2e-3
    np.testing.assert_allclose(moved, predicted.T, atol=0.01 * np.abs(moved).max())


def test_names_go_with_the_numbers() -> None:
    linear = linearise(MultibodyModel((RotorLag(0.1),)), load_rig("makki2024"))
    assert linear.input_labels == ["front_V", "back_V"]
    assert linear.output_labels == ["elevation_rad", "pitch_rad", "travel_rad"]
    assert linear.state_labels[:2] == ["elevation_rad", "pitch_rad"]
    assert linear.state_labels[6:] == ["rotor_lag_front_N", "rotor_lag_back_N"]


def test_travel_follows_pitch_and_hover_leans_against_a_heavier_front() -> None:
    level = derivatives(MultibodyModel(), load_rig("makki2024"), np.zeros(6), trim_volts())
    assert level.A[5, 1] == pytest.approx(0.5, abs=0.01)  # rad/s2 of travel for each rad of pitch
    heavier = trim(MultibodyModel(), load_rig("makki2024").replace(M_f=0.36))
    assert heavier.volts_V[0] > heavier.volts_V[1]


def trim_volts() -> np.ndarray:
    return trim(MultibodyModel(), load_rig("makki2024")).volts_V


def test_a_rig_that_cannot_hover_is_named() -> None:
    with pytest.raises(PlantError, match="makki2024' cannot hover at 0 degrees with model 'multibody'"):
        trim(MultibodyModel(), load_rig("makki2024").replace(M_w=1.8))
