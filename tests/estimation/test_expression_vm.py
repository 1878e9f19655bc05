"""The expression VM, which evaluates CasADi functions along trajectories, agrees with CasADi itself."""

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from heli_sim.evaluate import _expression_vm
from heli_sim.evaluate.trajectories import EFFECT_SUBSTEPS, AlongTrajectory, EffectStates, Trajectory
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from hypothesis import given, seed, settings
from hypothesis import strategies as st

ROWS = 77
UNARY: dict[str, Callable[[ca.SX], ca.SX]] = {
    "neg": lambda x: -x,
    "exp": ca.exp,
    "log": lambda x: ca.log(ca.fabs(x) + 0.1),
    "sqrt": lambda x: ca.sqrt(ca.fabs(x)),
    "sq": lambda x: x**2,
    "power": lambda x: (ca.fabs(x) + 0.1) ** 1.7,
    "twice": lambda x: 2 * x,
    "sin": ca.sin,
    "cos": ca.cos,
    "tan": lambda x: ca.tan(0.3 * x),
    "asin": lambda x: ca.asin(ca.tanh(x)),
    "acos": lambda x: ca.acos(ca.tanh(x)),
    "atan": ca.atan,
    "not": lambda x: ca.logic_not(x > 0.2),
    "floor": ca.floor,
    "ceil": ca.ceil,
    "fabs": ca.fabs,
    "sign": ca.sign,
    "erf": ca.erf,
    "inverse": lambda x: 1 / (x + 3.1),
    "sinh": ca.sinh,
    "cosh": ca.cosh,
    "tanh": ca.tanh,
    "asinh": ca.asinh,
    "acosh": lambda x: ca.acosh(1.5 + ca.fabs(x)),
    "atanh": lambda x: ca.atanh(0.5 * ca.tanh(x)),
    "log1p": lambda x: ca.log1p(ca.fabs(x)),
    "expm1": ca.expm1,
}
BINARY: dict[str, Callable[[ca.SX, ca.SX], ca.SX]] = {
    "add": lambda x, y: x + y,
    "sub": lambda x, y: x - y,
    "mul": lambda x, y: x * y,
    "div": lambda x, y: x / (ca.fabs(y) + 0.5),
    "pow": lambda x, y: (ca.fabs(x) + 0.1) ** y,
    "less": lambda x, y: x < y,
    "at_most": lambda x, y: x <= y,
    "equal": lambda x, y: ca.eq(ca.floor(x), ca.floor(y)),
    "differs": lambda x, y: ca.ne(ca.floor(x), ca.floor(y)),
    "and": lambda x, y: ca.logic_and(x > 0, y > 0),
    "or": lambda x, y: ca.logic_or(x > 0, y > 0),
    "fmod": lambda x, y: ca.fmod(x, ca.fabs(y) + 0.5),
    "remainder": lambda x, y: ca.remainder(x, ca.fabs(y) + 0.5),
    "copysign": ca.copysign,
    "if_else": lambda x, y: ca.if_else(x > y, x, 2 * y),
    "fmin": ca.fmin,
    "fmax": ca.fmax,
    "atan2": ca.atan2,
    "hypot": ca.hypot,
}


def random_trajectory(states: int, parameters: int, seed_number: int = 1) -> Trajectory:
    """Make a trajectory of random states, inputs and parameters."""
    random = np.random.default_rng(seed_number)
    return Trajectory(
        np.sort(random.uniform(0.0, 5.0, ROWS)),
        random.normal(0.0, 1.0, (ROWS, states)),
        random.normal(0.0, 1.0, (ROWS, 2)),
        0.01,
        random.normal(0.0, 1.0, parameters),
    )


def by_casadi(function: ca.Function, along: Trajectory) -> list[np.ndarray]:
    """Evaluate a function along a trajectory by CasADi, one row after the other."""
    outputs = []
    for row in range(ROWS):
        values = function(along.state[row], along.inputs[row], along.t_s[row], along.parameters)
        values = values if isinstance(values, tuple | list) else [values]
        outputs.append([np.array(value) for value in values])
    return [np.array(value) for value in zip(*outputs, strict=True)]


def assert_same_as_casadi(function: ca.Function, along: Trajectory) -> None:
    """Assert that the VM and CasADi have the same outputs along a trajectory."""
    for actual, expected in zip(AlongTrajectory(function)(along), by_casadi(function, along), strict=True):
        assert actual.shape == expected.shape
        assert np.allclose(actual, expected, rtol=1e-12, atol=1e-300)


@pytest.mark.parametrize("name", [*UNARY, *BINARY])
def test_each_operation_on_rows_and_on_shared_values_is_that_of_casadi(name: str) -> None:
    x, u, t, p = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", 3)
    values = [x[0], p[0], t]
    if name in UNARY:
        results = [UNARY[name](value) for value in values]
    else:
        results = [BINARY[name](value, other) for value in values for other in (x[1], p[1])]
    assert_same_as_casadi(ca.Function("f", [x, u, t, p], [ca.vertcat(*results)]), random_trajectory(2, 3))


def test_tests_cover_every_operation_of_the_table() -> None:
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    expressions = [operation(x) for operation in UNARY.values()] + [
        operation(x, y) for operation in BINARY.values()
    ]
    function = ca.Function("f", [x, y], [ca.vertcat(*expressions)])
    codes = {function.instruction_id(k) for k in range(function.n_instructions())}
    missing = {name for name in _expression_vm.OPERATIONS if getattr(ca, f"OP_{name}") not in codes}
    # An expression contains no separate assignment.
    assert missing <= {"ASSIGN"}


@seed(20)
@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 1000), st.integers(0, 1000), st.integers(0, 1000)), max_size=60))
def test_random_programs(recipe: list[tuple[int, int, int]]) -> None:
    x, u, t, p = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", 3)
    values = [*ca.vertsplit(x), *ca.vertsplit(u), t, *ca.vertsplit(p), ca.SX(0.7)]
    calls = [*(lambda a, b, f=f: f(a) for f in UNARY.values()), *BINARY.values()]
    # Each step of the recipe applies an operation to two earlier values; numbers are taken modulo the choice.
    for operation, a, b in recipe:
        # tanh limits the values: infinities could not be compared.
        call = calls[operation % len(calls)]
        values.append(ca.tanh(call(values[a % len(values)], values[b % len(values)])))
    outputs = [ca.vertcat(*values[-6:]), ca.horzcat(*values[:4])]
    assert_same_as_casadi(ca.Function("f", [x, u, t, p], outputs), random_trajectory(2, 3, len(recipe)))


def test_repeated_subexpression_is_computed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    x, u, t, p = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", 3)
    sine_twice = [ca.sin(x[0] * p[0]) + 0.7, ca.sin(x[0] * p[0]) - 0.7]
    function = ca.Function("f", [x, u, t, p], [ca.vertcat(*sine_twice)])
    codes = [function.instruction_id(k) for k in range(function.n_instructions())]
    assert codes.count(ca.OP_SIN) == 2, "CasADi merges them itself: this test needs another expression"
    operations_of_programs: list[list[int]] = []
    program = _expression_vm.TableProgram

    def recorded(operations: list[int], *rest: Any) -> object:
        operations_of_programs.append(operations)
        return program(operations, *rest)

    monkeypatch.setattr(_expression_vm, "TableProgram", recorded)
    assert_same_as_casadi(function, random_trajectory(2, 3))
    assert operations_of_programs[0].count(_expression_vm.OPERATIONS.index("SIN")) == 1


def test_derivatives_of_a_model_are_those_of_casadi() -> None:
    model = MultibodyModel(parse_effects(["rotor_lag=0.08", "coulomb_friction.pitch=0.01"]))
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
    rates = model.dynamics(x, u, p, t)
    function = ca.Function("f", [x, u, t, p], [ca.densify(rates), ca.densify(ca.jacobian(rates, p))])
    along = random_trajectory(len(model.states), len(model.parameters))
    for actual, expected in zip(AlongTrajectory(function)(along), by_casadi(function, along), strict=True):
        scale = np.abs(expected).max()
        assert np.allclose(actual, expected, rtol=1e-9, atol=1e-12 * scale)


@pytest.mark.parametrize("returned_substep", [None, 1])
def test_effect_states_are_integrated_by_the_runge_kutta_rule(returned_substep: int | None) -> None:
    z, y, u = ca.SX.sym("z", 2), ca.SX.sym("y", 2), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", 3)
    rate = ca.vertcat((u[0] * y[1] - z[0]) / (0.1 + p[0] ** 2), ca.sin(t + z[0]) - p[1] * z[1] + y[0])
    reset = ca.vertcat(z[0], ca.fmin(ca.fmax(z[1], -0.02), 0.02 + 0.01 * ca.cos(t)))
    inputs = [z, t, y, u, p]
    rates, resets = ca.Function("f", inputs, [rate]), ca.Function("r", inputs, [reset])
    along = random_trajectory(2, 3)
    substeps = EFFECT_SUBSTEPS
    compared_substep = substeps - 1 if returned_substep is None else returned_substep  # the last by default
    options = [] if returned_substep is None else [returned_substep]
    integrated = EffectStates(rates, resets).integrate(along, *options)
    # The same by hand: the classical Runge-Kutta method with a reset after each substep of length h.
    h, state = along.step_s / substeps, np.zeros(2)
    for row in range(ROWS):
        rest = along.state[row], along.inputs[row], along.parameters
        for sub in range(substeps):
            now = along.t_s[row] + h * (sub - substeps / 2)
            k1 = np.array(rates(state, now, *rest)).ravel()
            k2 = np.array(rates(state + 0.5 * h * k1, now, *rest)).ravel()
            k3 = np.array(rates(state + 0.5 * h * k2, now, *rest)).ravel()
            k4 = np.array(rates(state + h * k3, now, *rest)).ravel()
            state = np.array(resets(state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), now + h, *rest)).ravel()
            if sub == compared_substep:
                assert np.allclose(integrated[row], state, rtol=1e-10, atol=1e-12)


def program_of(operation: str, operand: int, widths: list[int], output: int) -> _expression_vm.TableProgram:
    """Make a program of a single operation, whose result is value 0."""
    code = _expression_vm.OPERATIONS.index(operation)
    return _expression_vm.TableProgram([code], [operand], [0], [1.0], widths, [[output]])


def test_invalid_program_is_refused() -> None:
    with pytest.raises(ValueError, match="read before"):
        program_of("ADD", operand=0, widths=[1, 1], output=0)  # adds its own result
    with pytest.raises(ValueError, match="no such value"):
        program_of("CONST", operand=0, widths=[1, 1], output=3)  # has value 0 only
    program = program_of("INPUT", operand=0, widths=[2, 1], output=0)
    with pytest.raises(ValueError, match="another width"):
        program.evaluate([np.zeros((3, 1))], np.zeros(1))
