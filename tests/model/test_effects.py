"""Effects do what their one sentence says, and nothing at their neutral values."""

from __future__ import annotations

import itertools
from functools import cache
from statistics import NormalDist

import casadi as ca
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.fit.free_run import Functions, Inputs, InterpretedKernel, kernel
from heli_sim.errors import PlantError
from heli_sim.model import Effect, Model, MultibodyModel, PaperModel
from heli_sim.model.effects import EffectSpec, RotorLag, catalogue, parse_effects
from heli_sim.model.linear import derivatives, linearise, trim
from heli_sim.model.parts import AXES, rotor_climb_m_s
from heli_sim.plant import Plant, step_function
from heli_sim.rig import load_rig

from tests.plant.toys import WIDE, rates_function
from tests.running.long import parallel_map

MODELS = (MultibodyModel, PaperModel)
KINDS = catalogue()
PAIRS = [
    pytest.param(model, kind, id=f"{model.name}-{kind.id}")
    for model in MODELS
    for kind in KINDS.values()
    if kind.suits(model())
]
MULTIBODY = [pytest.param(kind, id=kind.id) for kind in KINDS.values() if kind.suits(MultibodyModel())]
COUNT_RAD = 2 * np.pi / 4096


def everything(model: type[Model]) -> tuple[EffectSpec, ...]:
    """All effects that a model may have together; an effect that contains others excludes them."""
    return tuple(kind for kind in KINDS.values() if kind.suits(model()) and not kind.contains)


def functions(model: Model) -> ca.Function:
    """(state, volts, parameters, time) -> rates and measured angles."""
    x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
    p = ca.SX.sym("p", len(model.parameters))
    return ca.Function("both", [x, u, p, t], [model.dynamics(x, u, p, t), model.measurement(x, u, p, t)])


def states(random: np.random.Generator) -> Floats:
    return np.concatenate((random.uniform(-0.4, 0.4, 3), random.uniform(-0.6, 0.6, 3)))


def flown(model: Model, seconds: float = 5.0) -> Floats:
    """Measured angles under the same voltages about hover, (n, 3)."""
    rig = load_rig("makki2024").replace(**WIDE)
    plant, ticks = Plant(model, rig), round(1000 * seconds)
    start = plant.rest_state()
    start[0], start[5] = -0.05, 0.3
    t = np.arange(ticks) * 1e-3
    hover_V = trim(MultibodyModel(), rig).volts_V[:, None]
    volts_V = hover_V + 0.3 * np.array([np.sin(5 * t + 0.5), np.sin(4 * t)]) + 0.05
    step = plant.function.mapaccum(ticks)
    _, measured = step(start, volts_V, np.zeros(3), plant.parameters)
    return np.asarray(measured).T


@cache
def flown_without() -> Floats:
    return flown(MultibodyModel())


@pytest.mark.parametrize(("model", "kind"), PAIRS)
def test_an_effect_does_nothing_at_its_neutral_values(model: type[Model], kind: EffectSpec) -> None:
    rig, random = load_rig("makki2024"), np.random.default_rng(1)
    plain, neutral = model(), model((kind.make(),))
    without, within = functions(plain), functions(neutral)
    for _ in range(5):
        x, volts_V, t = states(random), random.uniform(1.2, 3.0, 2), random.uniform(0.0, 60.0)
        effect_states = np.zeros(len(neutral.states) - 6)
        before = without(x, volts_V, plain.parameter_values(rig), t)
        after = within(np.append(x, effect_states), volts_V, neutral.parameter_values(rig), t)
        np.testing.assert_allclose(np.asarray(after[0])[:6], before[0], atol=1e-12)
        # An encoder without any play has no side on which its shaft lies: 1 microradian is the least.
        np.testing.assert_allclose(after[1], before[1], atol=5.1e-7 if "backlash" in kind.id else 1e-12)


@pytest.mark.medium
@pytest.mark.parametrize("kind", parallel_map(MULTIBODY, every=4))
def test_an_effect_of_typical_size_shows_in_five_seconds(kind: EffectSpec) -> None:
    effect = kind.make({**kind.typical, **{name: 1.0 for name in kind.neutral if name.endswith("at_s")}})
    differs_rad = np.abs(flown(MultibodyModel((effect,))) - flown_without()).max()
    assert differs_rad > COUNT_RAD


@pytest.mark.parametrize(("model", "kind"), PAIRS)
def test_derivatives_to_an_effects_numbers_are_those_of_finite_differences(
    model: type[Model], kind: EffectSpec
) -> None:
    extended = model((kind.make(kind.typical),))
    names = extended.parameter_names
    random = np.random.default_rng(2)
    x = np.append(states(random), random.uniform(0.05, 0.1, len(extended.states) - 6))
    numbers, volts_V, t = extended.parameter_values(load_rig("makki2024")), np.array([1.9, 2.3]), 20.004
    both = functions(extended)
    symbols = [ca.SX.sym(f"s{i}", both.size1_in(i)) for i in range(4)]
    exact = ca.Function("exact", symbols, [ca.jacobian(ca.vertcat(*both(*symbols)), symbols[2])])
    jacobian = np.asarray(exact(x, volts_V, numbers, t))
    for name in kind.neutral:
        place, step = names.index(name), 1e-6
        sides = []
        for sign in (1, -1):
            moved = numbers.copy()
            moved[place] += sign * step
            sides.append(np.concatenate([np.asarray(r).ravel() for r in both(x, volts_V, moved, t)]))
        slope = (sides[0] - sides[1]) / (2 * step)
        np.testing.assert_allclose(jacobian[:, place], slope, rtol=1e-4, atol=1e-6)


@pytest.mark.medium
@pytest.mark.parametrize("model", MODELS)
def test_all_effects_fit_into_one_model_with_finite_derivatives(model: type[Model]) -> None:
    rig = load_rig("makki2024")
    full = model(tuple(kind.make() for kind in everything(model)))
    at = derivatives(full, rig, np.zeros(len(full.states)), [2.0, 2.1])
    for matrix in (at.rates, at.A, at.B, at.P, at.C, at.D):
        assert np.isfinite(matrix).all()
    step = step_function(full, delay_s=0.01)
    start = np.zeros(step.size1_in(0))
    limits = [rig[name].value for name in ("elevation_min", "elevation_max", "pitch_max", "travel_max")]
    after, _ = step(start, [2.0, 2.1], np.zeros(3), [*full.parameter_values(rig), *limits, 50.0])
    assert np.isfinite(np.asarray(after)).all()


@pytest.mark.slow
def test_both_kernels_run_all_effects_at_once_and_agree() -> None:
    """This includes effects that set their states again after each step."""
    rig, random = load_rig("makki2024"), np.random.default_rng(6)
    full = MultibodyModel(tuple(kind.make() for kind in everything(MultibodyModel)))
    free = tuple(name for effect in full.effects for name in effect.priors)
    steps, windows = 20, 2
    inputs = Inputs(
        np.full(windows, steps, np.int64),
        np.array([0.0, 20.0]),
        0.01,
        1.75 + 0.2 * random.standard_normal((windows * steps, 2)),
        np.zeros((windows * steps, 2)),
    )
    start = np.column_stack(
        (random.uniform(-0.3, 0.3, (windows, 6)), np.zeros((windows, len(full.states) - 6)))
    )
    numbers = full.parameter_values(rig)
    angles, jacobian = kernel(full, free).jacobian(inputs, start, numbers)
    other_angles, other_jacobian = InterpretedKernel(Functions(full, free)).jacobian(inputs, start, numbers)
    assert np.isfinite(jacobian).all()
    np.testing.assert_allclose(angles, other_angles, atol=1e-12)
    np.testing.assert_allclose(jacobian, other_jacobian, atol=1e-9)
    # The play of each encoder has a derivative although there is next to none of it.
    assert (np.abs(jacobian[..., len(full.states) + free.index("backlash_pitch_rad")]).max()) > 0.4


@pytest.mark.medium
def test_a_rig_with_play_and_gusts_still_has_a_hover() -> None:
    model = MultibodyModel(parse_effects(["backlash.pitch", "random_torque.travel", "rotor_lag"]))
    at = trim(model, load_rig("makki2024"))
    assert at.volts_V == pytest.approx(trim(MultibodyModel(), load_rig("makki2024")).volts_V)


@pytest.mark.slow
def test_effects_may_be_given_in_any_order() -> None:
    ids = ("ground_effect", "inflow_damping", "rotor_lag", "thrust_quadratic", "supply_sag")
    rig, x = load_rig("makki2024"), np.array([0.1, 0.2, 0.3, 0.2, -0.3, 0.4, 0.5, 0.6])
    accelerations = []
    for order in itertools.permutations(ids):
        model = MultibodyModel(tuple(KINDS[id].make(KINDS[id].typical) for id in order))
        rates = rates_function(model)(x, [1.9, 2.3], model.parameter_values(rig))
        accelerations.append(np.asarray(rates)[3:6])
    np.testing.assert_array_equal(accelerations, np.broadcast_to(accelerations[0], (120, 3, 1)))


@pytest.mark.medium
def test_a_lag_follows_the_thrust_that_a_bent_curve_asks_for() -> None:
    rig = load_rig("makki2024")
    plant = Plant(MultibodyModel(parse_effects(["rotor_lag=0.02", "thrust_quadratic=0.5"])), rig)
    state = plant.rest_state()
    for _ in range(300):
        state, _ = plant.step(state, (3.0, 2.0), (True, True, True))
    k = rig["thrust_gain"].value
    assert state[6:8] == pytest.approx([k * 2 * 1.5, k * 1.0], rel=1e-4)


def power_W(model: Model, effect: Effect, x: Floats, volts_V: tuple[float, float]) -> float:
    """Power that the torque and the friction of an effect give to the axes."""
    symbols = ca.SX.sym("x", len(model.states))
    at = model.operands(symbols, ca.SX(list(volts_V)), ca.SX(model.parameter_values(load_rig("makki2024"))))
    friction = effect.friction_Nm(at, ca.SX.zeros(3), ca.SX.ones(3))
    torque = ca.Function("torque", [symbols], [effect.torque_Nm(at) + friction])
    return float(np.asarray(torque(x)).ravel() @ x[3:6])


@pytest.mark.medium
@pytest.mark.parametrize(
    "id", [f"coulomb_friction.{axis}" for axis in AXES] + [f"{axis}_drag_quadratic" for axis in AXES]
)
def test_friction_and_drag_only_take_energy(id: str) -> None:
    effect, random = KINDS[id].make(KINDS[id].typical), np.random.default_rng(3)
    model = MultibodyModel((effect,))
    powers = [power_W(model, effect, states(random), (2.0, 2.0)) for _ in range(50)]
    assert max(powers) <= 0.0
    assert min(powers) < -1e-4


def friction_of(axis: str, c_Nm: float, *, measured: bool = False) -> ca.Function:
    """Dry friction about an axis, N m, by the axis' rate and the other torque about it."""
    effect = KINDS[f"coulomb_friction.{axis}"].make({f"coulomb_friction_{axis}_Nm": c_Nm})
    model, inertia = MultibodyModel((effect,)), ca.SX([0.8, 0.05, 0.7])
    at = model.operands(
        ca.SX.sym("x", 6), ca.SX.zeros(2), ca.SX(model.parameter_values(load_rig("makki2024")))
    )
    rate, push_Nm = at.state[f"{axis}_rate_rad_s"], ca.SX.sym("push")
    acting = effect.with_measured_angles() if measured else effect
    friction_Nm = acting.friction_Nm(at, push_Nm / inertia, inertia)[AXES.index(axis)]
    return ca.Function("friction", [rate, push_Nm], [friction_Nm])


@pytest.mark.parametrize("axis", AXES)
def test_dry_friction_holds_what_pushes_less_and_slows_what_moves(axis: str) -> None:
    c_Nm = 0.01
    friction_Nm = friction_of(axis, c_Nm)

    def left_Nm(rate_rad_s: float, push_Nm: float) -> float:
        return push_Nm + float(friction_Nm(rate_rad_s, push_Nm))

    assert left_Nm(0.0, 0.9 * c_Nm) == pytest.approx(0.0, abs=1e-15)
    assert left_Nm(0.0, -3.0 * c_Nm) == pytest.approx(-2.0 * c_Nm)
    assert left_Nm(0.5, 0.0) == pytest.approx(-c_Nm)
    assert left_Nm(-0.5, 0.0) == pytest.approx(c_Nm)


@pytest.mark.parametrize("axis", AXES)
def test_along_a_measured_flight_dry_friction_is_its_mean_over_the_rates_left_open(axis: str) -> None:
    c_Nm = 0.01
    plain, mean = friction_of(axis, c_Nm), friction_of(axis, c_Nm, measured=True)
    # An axis at rest is held, as in the room.
    assert [float(mean(0.0, push)) for push in (0.004, -0.03)] == [
        float(plain(0.0, push)) for push in (0.004, -0.03)
    ]
    # One that moves: over four hundred equally likely rates of those that three counts a second leave open.
    points = NormalDist(0.0, 3.0 * 2.0 * np.pi / 4096.0).quantiles(401)
    for rate_rad_s in (-0.05, -0.006, -0.002, 0.002, 0.004, 0.009, 0.3):
        expected = np.mean([float(plain(rate_rad_s + off, 0.005)) for off in points])
        assert float(mean(rate_rad_s, 0.005)) == pytest.approx(expected, abs=0.03 * c_Nm)


@pytest.mark.parametrize("text", ["cable_spring.elevation=0.3", "cable_spring.travel=0.3", "axis_tilt=0.1"])
def test_springs_and_tilt_conserve_energy(text: str) -> None:
    loss = {f"friction_{axis}": 0.0 for axis in AXES}
    rig = load_rig("makki2024").replace(**loss)
    model = MultibodyModel(parse_effects([text]))
    x, u, p = ca.SX.sym("x", 6), ca.SX.zeros(2), ca.SX(model.parameter_values(rig))
    at = model.operands(x, u, p)
    # The rate of the energy along the motion is exactly nothing.
    change = ca.jtimes(model.energy_J(at), x, model.dynamics(x, u, p))
    effect_energy_J = model.energy_J(at) - MultibodyModel().energy_J(at)
    both = ca.Function("both", [x], [change, ca.norm_2(ca.gradient(effect_energy_J, x))])
    random, steepest = np.random.default_rng(4), 0.0
    for _ in range(20):
        change_W, slope = (float(value) for value in both(states(random)))
        assert abs(change_W) < 1e-12
        steepest = max(steepest, slope)
    assert steepest > 0.01


def test_thrust_times_climb_is_the_power_that_the_thrust_gives() -> None:
    model, random = MultibodyModel(), np.random.default_rng(5)
    x, thrust = ca.SX.sym("x", 6), ca.SX.sym("F", 2)
    p = ca.SX(model.parameter_values(load_rig("makki2024")))
    at = model.operands(x, ca.SX.zeros(2), p)
    pushed = model.acceleration(at, thrust, ca.SX.zeros(3)) - model.acceleration(
        at, ca.SX.zeros(2), ca.SX.zeros(3)
    )
    power = x[3:6].T @ model.inertia_kg_m2(at) @ pushed
    both = ca.Function("both", [x, thrust], [power, ca.dot(thrust, rotor_climb_m_s(at.state, at.parameter))])
    for _ in range(20):
        given, climbed = both(states(random), random.uniform(0, 3, 2))
        assert float(given) == pytest.approx(float(climbed), abs=1e-12)


@pytest.mark.medium
def test_rotor_lag_reaches_63_percent_of_a_step_after_its_time_constant() -> None:
    rig = load_rig("makki2024")
    plant = Plant(MultibodyModel((RotorLag(0.12),)), rig)
    state = plant.rest_state()
    for _ in range(120):
        state, _ = plant.step(state, (2.0, 3.0), (True, True, True))
    full_N = rig["thrust_gain"].value * np.array([1.0, 2.0])
    assert state[6:] == pytest.approx(full_N * (1 - np.exp(-1)), rel=1e-6)


@pytest.mark.medium
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
