"""Rotors that lag by laws of their own, what feeds them, their momentum, and effects nested in others."""

from __future__ import annotations

import casadi as ca
import numpy as np
import numpy.typing as npt
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.fit.problem import Problem
from heli_sim.errors import PlantError
from heli_sim.model import Model, MultibodyModel
from heli_sim.model.effects import EffectSpec, catalogue, parse_effects
from heli_sim.plant import Plant
from heli_sim.rig import Rig, load_rig

from tests.plant.toys import WIDE

RIG = load_rig("makki2024").replace(**WIDE)
GAIN_N_per_V, DEAD_V = RIG["thrust_gain"].value, RIG["dead_zone"].value
KINDS = catalogue()
SUPERSETS = [pytest.param(kind, id=kind.id) for kind in KINDS.values() if kind.contains]
STATE = np.array([0.1, 0.2, 0.3, 0.2, -0.3, 0.4])
SPEED_V = np.array([1.4, 2.2])
HELD = (True, True, True)


def rates(
    model: Model, state: npt.ArrayLike, volts_V: npt.ArrayLike, time_s: float, rig: Rig = RIG
) -> Floats:
    x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
    p = ca.SX.sym("p", len(model.parameters))
    function = ca.Function("rates", [x, u, p, t], [model.dynamics(x, u, p, t)])
    given = np.asarray(state), np.asarray(volts_V), model.parameter_values(rig), time_s
    return np.asarray(function(*given)).ravel()


def accelerations(
    texts: list[str],
    effect_states: npt.ArrayLike,
    volts_V: npt.ArrayLike,
    time_s: float = 0.0,
    rig: Rig = RIG,
) -> Floats:
    """Accelerations of a model with effects whose states are `effect_states`, in rad/s2."""
    model = MultibodyModel(parse_effects(texts))
    return rates(model, np.append(STATE, effect_states), volts_V, time_s, rig)[3:6]


def under_N(thrust_N: Floats) -> Floats:
    """Accelerations of the bare model whose rotors push with `thrust_N`."""
    return accelerations([], [], DEAD_V + thrust_N / GAIN_N_per_V)


@pytest.mark.parametrize(
    ("form", "thrust_N"),
    [
        ("begins:0", GAIN_N_per_V * SPEED_V**2 / 4.0),
        ("begins:1", GAIN_N_per_V * (SPEED_V - DEAD_V) ** 2),
        ("begins:0,pivot_V:3", GAIN_N_per_V * SPEED_V**2 / 6.0),
    ],
)
def test_thrust_is_the_square_of_the_speed_reached_whatever_the_voltage(form: str, thrust_N: Floats) -> None:
    for volts_V in ([0.0, 0.0], [3.0, 1.0]):
        actual_rad_s2 = accelerations([f"rotor_speed_lag=s:0.1,{form}"], SPEED_V, volts_V)
        np.testing.assert_allclose(actual_rad_s2, under_N(thrust_N), rtol=1e-12)


def test_the_square_touches_the_expression_vm_at_its_pivot() -> None:
    def above_rad_s2(volts_V: float) -> float:
        both_V = np.full(2, volts_V)
        more = accelerations(["rotor_speed_lag"], both_V, both_V) - accelerations([], [], both_V)
        return float(more[0])

    assert above_rad_s2(2.0) == pytest.approx(0.0, abs=1e-12)
    near, far = above_rad_s2(2.1), above_rad_s2(2.2)
    assert near > 0.0 and far == pytest.approx(4.0 * near) and above_rad_s2(1.9) == pytest.approx(near)


def test_rotors_that_reverse_push_down_with_their_share_of_the_square() -> None:
    rig, speed_V = RIG.replace(reverse_thrust=0.5, dead_zone=0.0), np.array([-1.4, 2.2])
    actual_rad_s2 = accelerations(["rotor_speed_lag"], speed_V, [2.0, 2.0], rig=rig)
    straight_V = np.sign(speed_V) * speed_V**2 / 4.0
    np.testing.assert_allclose(actual_rad_s2, accelerations([], [], straight_V, rig=rig), rtol=1e-12)


@pytest.mark.medium
@pytest.mark.parametrize("T_s", [0.03, 0.12])
def test_the_speed_reaches_63_percent_of_a_step_after_its_time_constant(T_s: float) -> None:
    plant = Plant(
        MultibodyModel(parse_effects([f"rotor_speed_lag={T_s}", f"flywheel=Nms_per_V:0.01,s:{T_s}"])), RIG
    )
    state = plant.rest_state()
    for _ in range(round(1e3 * T_s)):
        state, _ = plant.step(state, (2.0, 3.0), HELD)
    assert state[6:9] == pytest.approx(np.array([2.0, 3.0, 5.0]) * (1 - np.exp(-1)), rel=1e-5)


def test_a_lag_too_short_to_be_integrated_is_so_much_of_the_shortest_that_is() -> None:
    volts_V = np.array([1.9, 2.1])
    half_N = 0.5 * GAIN_N_per_V * (volts_V - DEAD_V + SPEED_V**2 / 4.0)
    actual_rad_s2 = accelerations(["rotor_speed_lag=0.002"], SPEED_V, volts_V)
    np.testing.assert_allclose(actual_rad_s2, under_N(half_N), rtol=1e-12)


@pytest.mark.parametrize(
    ("effect", "factor"),
    [
        ("thrust_asymmetry=0.1", np.array([1.1, 0.9])),
        ("thrust_step.front=0.2@5", np.array([0.8, 1.0])),
        ("thrust_fade=0.01", np.array([0.9, 0.9])),
        ("thrust_quadratic=0.5", 0.5 + 0.5 * SPEED_V**2 / 4.0),
    ],
)
@pytest.mark.parametrize("swapped", [False, True])
def test_other_thrust_effects_act_on_what_the_speed_gives(effect: str, factor: Floats, swapped: bool) -> None:
    texts = [effect, "rotor_speed_lag"][:: -1 if swapped else 1]
    actual_rad_s2 = accelerations(texts, SPEED_V, [1.0, 1.0], time_s=10.0)
    np.testing.assert_allclose(actual_rad_s2, under_N(factor * GAIN_N_per_V * SPEED_V**2 / 4.0), rtol=1e-12)


@pytest.mark.medium
def test_a_fit_keeps_voltages_in_the_dead_zone_where_the_rotors_push_there() -> None:
    t_s = np.linspace(0.0, 5.999, 6000, dtype=np.float64)
    volts_V = np.column_stack((0.5 + 1.5 * (t_s % 0.2 < 0.1), 2.0 + 0.1 * np.sin(t_s)))
    wavy = 0.1 * np.column_stack((np.sin(t_s), np.cos(t_s), np.sin(2 * t_s)))
    flight = Flight(t_s, *volts_V.T, *wavy.T)
    lifted, kept = (
        Problem(MultibodyModel(parse_effects(texts)), load_rig("makki2024"), [flight])
        for texts in (["rotor_lag"], ["rotor_speed_lag"])
    )
    first = slice(0, 100)
    low_V = [
        problem.grid(0, False, problem.parameter_vector.start).inputs.mean_V[first, 0].min()
        for problem in (lifted, kept)
    ]
    assert low_V == pytest.approx([1.0, 0.5])


def test_a_supply_that_fades_takes_voltage_and_leaves_the_dead_zone() -> None:
    volts_V, t_s = np.array([1.9, 2.3]), 30.0
    remaining_share = 1 - 0.002 * (1 - np.exp(-0.05 * t_s)) / 0.05
    actual_rad_s2 = accelerations(["supply_fade=per_s:0.002,bend_per_s:0.05"], [], volts_V, t_s)
    np.testing.assert_allclose(actual_rad_s2, accelerations([], [], remaining_share * volts_V), rtol=1e-12)
    straight = accelerations(["supply_fade=0.002"], [], volts_V, t_s)
    np.testing.assert_allclose(straight, under_N(GAIN_N_per_V * (0.94 * volts_V - DEAD_V)), rtol=1e-12)


@pytest.mark.parametrize(
    "texts", [["supply_fade=0.01", "supply_sag=0.05"], ["supply_sag=0.05", "supply_fade=0.01"]]
)
def test_a_supply_sags_under_the_load_that_its_faded_voltage_makes(texts: list[str]) -> None:
    faded_V = 0.9 * np.array([1.9, 2.3])
    actual_rad_s2 = accelerations(texts, [], [1.9, 2.3], time_s=10.0)
    sagged_V = faded_V * (1 - 0.05 * faded_V.sum())
    np.testing.assert_allclose(actual_rad_s2, accelerations([], [], sagged_V), rtol=1e-12)


@pytest.mark.parametrize(("axis", "row"), [("elevation", 0), ("pitch", 1), ("travel", 2)])
def test_drag_is_friction_that_grows_with_the_rate(axis: str, row: int) -> None:
    rate = abs(STATE[3 + row])
    stiffer = RIG.replace(**{f"friction_{axis}": RIG[f"friction_{axis}"].value + 0.3 * rate})
    actual_rad_s2 = accelerations([f"{axis}_drag_quadratic=0.3"], [], [1.9, 2.3])
    np.testing.assert_allclose(actual_rad_s2, accelerations([], [], [1.9, 2.3], rig=stiffer), rtol=1e-12)


def test_a_flywheel_is_a_gyroscopic_torque_whose_momentum_goes_with_the_speed() -> None:
    volts_V, both_V = np.array([1.9, 2.3]), 3.1
    thrust_N = GAIN_N_per_V * (volts_V - DEAD_V).sum()
    actual_rad_s2 = accelerations(["flywheel=0.02"], [both_V], volts_V)
    same = accelerations([f"gyroscopic_torque={0.02 * both_V / thrust_N}"], [], volts_V)
    np.testing.assert_allclose(actual_rad_s2, same, rtol=1e-12)
    assert np.abs(actual_rad_s2 - accelerations([], [], volts_V)).max() > 0.1


def test_a_flywheel_that_speeds_up_turns_the_rig_the_other_way() -> None:
    volts_V, both_V, T_s = np.array([1.9, 2.3]), 3.1, 0.1
    reaction_Nm = -0.02 * (volts_V.sum() - both_V) / T_s
    arm_m = reaction_Nm / (GAIN_N_per_V * (volts_V - DEAD_V).sum())
    with_reaction, without_reaction = (
        accelerations([f"flywheel=Nms_per_V:0.02,spin_up:{spin_up}"], [both_V], volts_V) for spin_up in (1, 0)
    )
    reaction = accelerations([f"rotor_reaction_torque=front_m:{arm_m},back_m:{arm_m}"], [], volts_V)
    np.testing.assert_allclose(
        with_reaction - without_reaction, reaction - accelerations([], [], volts_V), rtol=1e-9
    )


@pytest.mark.parametrize("kind", SUPERSETS)
def test_an_effect_is_what_it_contains_where_its_other_numbers_are_neutral(kind: EffectSpec) -> None:
    for name in kind.contains:
        contained = KINDS[name]
        large = MultibodyModel((kind.make(kind.from_contained(contained.typical)),))
        small = MultibodyModel((contained.make(contained.typical),))
        effect_states = 0.3 * np.ones(len(kind.states))
        x = np.append(STATE, effect_states), np.append(STATE, effect_states[: len(contained.states)])
        actual_rad_s2, expected = (
            rates(m, s, [1.9, 2.3], 7.0)[:6] for m, s in zip((large, small), x, strict=True)
        )
        np.testing.assert_allclose(actual_rad_s2, expected, rtol=1e-12)
        assert late_s(large) == late_s(small)


def late_s(model: Model) -> float:
    """By how much a model's voltages act late."""
    values = {name: value for effect in model.effects for name, value in effect.values.items()}
    return values.get(model.delay, 0.0)


def test_what_two_nested_effects_have_in_common_starts_one_from_the_other() -> None:
    kind = KINDS["rotor_lag_with_delay"]
    both = kind.from_contained({"rotor_lag_s": 0.07, "input_delay_s": 0.03, "thrust_gain": 0.6})
    assert both == {"rotor_lag_with_delay_lag_s": 0.07, "rotor_lag_with_delay_delay_s": 0.03}
    assert kind.from_contained({"rotor_lag_s": 0.07})["rotor_lag_with_delay_delay_s"] == 0.0


def test_nested_effects_and_two_delays_are_not_for_one_model() -> None:
    both, lag, delay = (KINDS[name] for name in ("rotor_lag_with_delay", "rotor_lag", "input_delay"))
    assert lag.compatible_with(delay) and delay.compatible_with(lag)
    for small in (lag, delay):
        assert not both.compatible_with(small) and not small.compatible_with(both)
    assert delay.compatible_with(KINDS["rotor_speed_lag"]) and not both.compatible_with(both)
    with pytest.raises(PlantError, match="both delay the voltages"):
        MultibodyModel((both.make(), delay.make()))


@pytest.mark.medium
def test_a_lag_with_dead_time_answers_a_step_when_that_is_over() -> None:
    plant = Plant(MultibodyModel(parse_effects(["rotor_lag_with_delay=lag_s:0.1,delay_s:0.02"])), RIG)
    state = plant.rest_state()
    for ticks, share in ((20, 0.0), (100, 1 - np.exp(-1)), (100, 1 - np.exp(-2))):
        for _ in range(ticks):
            state, _ = plant.step(state, (2.0, 3.0), HELD)
        full_N = GAIN_N_per_V * (np.array([2.0, 3.0]) - DEAD_V)
        assert state[6:8] == pytest.approx(share * full_N, rel=1e-6, abs=1e-12)
