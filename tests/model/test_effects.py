"""Effects do what their sentence says, and nothing at their neutral values, alone and together."""

import itertools
from functools import cache
from statistics import NormalDist

import casadi as ca
import numpy as np
import numpy.typing as npt
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.fit.free_run import Functions, Inputs, InterpretedKernel, kernel
from heli_lab.fit.problem import Problem
from heli_sim.errors import PlantError
from heli_sim.model import Effect, Model, MultibodyModel, PaperModel
from heli_sim.model.effect import AXES, rotor_climb_m_s
from heli_sim.model.effects import EffectSpec, RotorLag, catalogue, parse_effects
from heli_sim.model.linear import derivatives, linearise, trim
from heli_sim.model.plant import Plant, step_function
from heli_sim.rig import Rig, load_rig

from tests.model.flown import fly_and_identify
from tests.model.toys import WIDE, rates
from tests.running.long import samples, select_cases

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
@pytest.mark.parametrize("kind", select_cases(MULTIBODY, every=4))
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
        accelerations.append(rates(model, rig, x, [1.9, 2.3])[3:6])
    np.testing.assert_array_equal(accelerations, np.broadcast_to(accelerations[0], (120, 3)))


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


RIG = load_rig("makki2024").replace(**WIDE)
GAIN_N_per_V, DEAD_V = RIG["thrust_gain"].value, RIG["dead_zone"].value
SUPERSETS = [pytest.param(kind, id=kind.id) for kind in KINDS.values() if kind.contains]
STATE = np.array([0.1, 0.2, 0.3, 0.2, -0.3, 0.4])
SPEED_V = np.array([1.4, 2.2])
HELD = (True, True, True)


def accelerations(
    texts: list[str],
    effect_states: npt.ArrayLike,
    volts_V: npt.ArrayLike,
    time_s: float = 0.0,
    rig: Rig = RIG,
) -> Floats:
    """Accelerations of a model with effects whose states are `effect_states`, in rad/s2."""
    model = MultibodyModel(parse_effects(texts))
    return rates(model, rig, np.append(STATE, effect_states), volts_V, time_s)[3:6]


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
            rates(m, RIG, s, [1.9, 2.3], 7.0)[:6] for m, s in zip((large, small), x, strict=True)
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


def test_an_effect_twice_and_two_delays_are_not_for_one_model() -> None:
    both, delay = KINDS["rotor_lag_with_delay"], KINDS["input_delay"]
    assert not any(kind.compatible_with(kind) for kind in KINDS.values())
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


EFFECTS = {id_: kind.make(kind.typical) for id_, kind in KINDS.items()}
FORBIDDEN = {
    frozenset(("input_delay", "rotor_lag_with_delay")),
    frozenset(("rotor_lag", "rotor_lag_with_delay")),
    frozenset(("rotor_lag", "rotor_speed_lag")),
    frozenset(("rotor_lag_with_delay", "rotor_speed_lag")),
}


def test_forbidden_pairs_of_effects_are_those_of_lags_and_delays() -> None:
    forbidden = set()
    for first, second in itertools.combinations(KINDS.values(), 2):
        assert first.compatible_with(second) == second.compatible_with(first)
        if not first.compatible_with(second):
            forbidden.add(frozenset((first.id, second.id)))
    assert forbidden == FORBIDDEN


@pytest.mark.medium
def test_every_allowed_pair_and_triple_of_effects_makes_a_model() -> None:
    made = 0
    for size in (2, 3):
        for ids in itertools.combinations(KINDS, size):
            pairs = itertools.combinations(ids, 2)
            if all(KINDS[first].compatible_with(KINDS[second]) for first, second in pairs):
                model = MultibodyModel(tuple(EFFECTS[id_] for id_ in ids))
                assert len(model.effects) == size
                made += 1
    assert made > 9000


# A state more, a moment to find, a jump; and then others of these kinds.
SHARE = (
    *("rotor_lag", "thrust_step.front", "backlash.pitch"),
    *("rotor_speed_lag", "ground_effect", "coulomb_friction.elevation", "periodic_torque.travel"),
)


@pytest.mark.slow
@pytest.mark.parametrize("id", SHARE[: samples(len(SHARE), 3)])
def test_a_flown_effect_is_found_within_three_standard_errors(id: str) -> None:
    estimate = fly_and_identify(catalogue()[id])
    assert max(abs(off) for off in estimate.off.values()) < 3.0
    assert estimate.normalised < 1.05
