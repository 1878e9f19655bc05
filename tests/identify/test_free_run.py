"""Free runs: the compiled and the interpreted loop agree, and their derivatives are finite differences."""

from __future__ import annotations

import ctypes
from pathlib import Path

import casadi as ca
import heli_sim.evaluate.compiled
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.code_digest import package_digest
from heli_lab.fit.free_run import (
    LOOP,
    CompiledKernel,
    Functions,
    Inputs,
    InterpretedKernel,
    VoltageDerivative,
    kernel,
)
from heli_sim.errors import PlantError
from heli_sim.evaluate import lanes
from heli_sim.evaluate.lanes import c_function
from heli_sim.model import Model, MultibodyModel, PaperModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

pytestmark = pytest.mark.medium

RIG = load_rig("makki2024")
FREE = ("M_w", "L_phi", "thrust_gain", "dead_zone", "friction_pitch", "offset_pitch")
SIGMA_RAD = np.array([4e-4, 4e-4, 4e-4])


def model(name: str) -> tuple[Model, tuple[str, ...]]:
    """Return a model and its free parameters; the model "late" has a lag and a delay."""
    effects = catalogue()
    lag, delay = effects["rotor_lag"].make({"rotor_lag_s": 0.08}), effects["input_delay"].make()
    return {
        "multibody": (MultibodyModel(), FREE),
        "paper": (PaperModel(), FREE[2:]),
        "late": (MultibodyModel((lag, delay)), (*FREE, "rotor_lag_s", "input_delay_s")),
    }[name]


def inputs(substeps: int, shaped: tuple[str, ...]) -> Inputs:
    """Make three windows of unequal length with random voltages about hover."""
    # For each parameter in `shaped`, a random mean and change of it within the steps are added.
    random = np.random.default_rng(3)
    steps = np.array([40, 7, 23], np.int64)
    rows = int(steps.sum())
    pairs = [random.normal(0.0, 1.0, (2, rows, 2)) for _ in shaped]
    return Inputs(
        steps,
        np.array([0.0, 3.0, 5.0]),
        0.01,
        1.75 + 0.2 * random.standard_normal((rows, 2)),
        0.05 * random.standard_normal((rows, 2)),
        substeps,
        tuple(
            VoltageDerivative(name, mean, change) for name, (mean, change) in zip(shaped, pairs, strict=True)
        ),
    )


def random_initial_states(equations: Model) -> Floats:
    """Return random initial states of the three windows, shape (3, states)."""
    random = np.random.default_rng(4)
    states: Floats = 0.1 * random.standard_normal((3, len(equations.states)))
    return states


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide the C compiler, and all functions that were compiled earlier."""
    monkeypatch.setattr(heli_sim.evaluate.compiled, "compiler", lambda: None)
    monkeypatch.setattr(heli_sim.evaluate.compiled, "cache_folder", lambda: tmp_path)


@pytest.mark.parametrize("substeps", [1, 2])
@pytest.mark.parametrize("name", ["multibody", "paper", "late"])
def test_compiled_and_interpreted_loops_agree(name: str, substeps: int) -> None:
    equations, free = model(name)
    compiled, interpreted = kernel(equations, free), InterpretedKernel(Functions(equations, free))
    assert isinstance(compiled, CompiledKernel)
    drive = inputs(substeps, ("input_delay_s", "dead_zone") if name == "late" else ())
    arguments = drive, random_initial_states(equations), equations.parameter_values(RIG)
    measured = np.random.default_rng(5).normal(0.0, 0.1, (drive.rows, 3))
    for of_compiled, of_interpreted in zip(
        (*compiled.jacobian(*arguments), *compiled.predict(*arguments)),
        (*interpreted.jacobian(*arguments), *interpreted.predict(*arguments)),
        strict=True,
    ):
        np.testing.assert_allclose(of_compiled, of_interpreted, rtol=1e-9, atol=1e-11)
    for of_compiled, of_interpreted in zip(
        compiled.products(*arguments, measured, SIGMA_RAD),
        interpreted.products(*arguments, measured, SIGMA_RAD),
        strict=True,
    ):
        np.testing.assert_allclose(of_compiled, of_interpreted, rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("name", ["multibody", "late"])
def test_window_has_the_same_bits_alone_and_together_with_others(name: str) -> None:
    equations, free = model(name)
    runner = kernel(equations, free)
    random = np.random.default_rng(6)
    steps = np.array([9, 5, 12, 1, 7, 30], np.int64)
    rows = int(steps.sum())
    volts_V = 1.75 + 0.2 * random.standard_normal((rows, 2))
    slope_V = 0.05 * random.standard_normal((rows, 2))
    start_s, values = np.arange(6.0), equations.parameter_values(RIG)
    states = 0.1 * random.standard_normal((6, len(equations.states)))
    measured_rad = random.normal(0.0, 0.1, (rows, 3))

    def results(windows: slice, window_rows: slice) -> list[Floats]:
        """Return all results of the kernel for some windows, which have these rows."""
        drive = Inputs(steps[windows], start_s[windows], 0.01, volts_V[window_rows], slope_V[window_rows])
        arguments = drive, states[windows], values
        products = runner.products(*arguments, measured_rad[window_rows], SIGMA_RAD)
        return [*runner.predict(*arguments), *runner.jacobian(*arguments), *products]

    # Which results have one entry per row; the others have one per window.
    has_rows = (True, False, True, True, True, False)
    together = results(slice(6), slice(rows))
    for number, first in enumerate(np.cumsum(steps) - steps):
        window, window_rows = slice(number, number + 1), slice(int(first), int(first + steps[number]))
        one_window = results(window, window_rows)
        for result_alone, result_together, is_by_row in zip(one_window, together, has_rows, strict=True):
            entries = window_rows if is_by_row else window
            np.testing.assert_array_equal(result_alone, result_together[entries])


@pytest.mark.parametrize("name", ["multibody", "late"])
def test_jacobian_is_the_finite_difference_of_the_free_run(name: str) -> None:
    equations, free = model(name)
    runner, drive = kernel(equations, free), inputs(2, ())
    states, values = random_initial_states(equations), equations.parameter_values(RIG)
    _, jacobian = runner.jacobian(drive, states, values)
    state_count = states.shape[1]
    # The columns of the Jacobian are the initial states, then the free parameters.
    for column in range(state_count + len(free)):
        step = 1e-5
        if column >= state_count:
            parameter = equations.parameter_names.index(free[column - state_count])
            step *= max(abs(values[parameter]), 1.0)
        predictions = []
        for sign in (-1.0, 1.0):
            changed_states, changed_values = states.copy(), values.copy()
            if column < state_count:
                changed_states[:, column] += sign * step
            else:
                changed_values[parameter] += sign * step
            predictions.append(runner.predict(drive, changed_states, changed_values)[0])
        slope = (predictions[1] - predictions[0]) / (2.0 * step)
        np.testing.assert_allclose(jacobian[:, :, column], slope, rtol=1e-4, atol=1e-5)


def test_code_digest_changes_with_the_loop_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    read = Path.read_bytes
    before = package_digest.__wrapped__("heli_lab")
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b" " * (path.name == "windows.c"))
    assert package_digest.__wrapped__("heli_lab") != before


def test_without_a_compiler_the_interpreted_loop_is_taken(no_compiler: None) -> None:
    assert isinstance(kernel(*model("multibody")), InterpretedKernel)


_CALL = """
void run(const double* x, const double* u, const double* t, const double* p, double* result) {
  Lanes vx[2], vu[2], vt[1], value[SIZE];
  for (int z = 0; z < LANES; ++z) {
    for (int i = 0; i < 2; ++i) vx[i][z] = x[2 * z + i], vu[i][z] = u[2 * z + i];
    vt[0][z] = t[z];
  }
  operations(vx, vu, vt, p, value);
  for (int z = 0; z < LANES; ++z) for (int i = 0; i < SIZE; ++i) result[SIZE * z + i] = value[i][z];
}
"""


def unary(a: ca.SX) -> list[ca.SX]:
    """Return every operation on one value, with arguments in its domain."""
    half = 0.5 + 0.4 * ca.sin(a)
    return [
        *(
            -a,
            a * a,
            2.0 * a,
            1.0 / a,
            ca.exp(a),
            ca.log(half),
            ca.sqrt(half),
            ca.sin(a),
            ca.cos(a),
            ca.tan(a),
        ),
        *(ca.asin(half), ca.acos(half), ca.atan(a), ca.floor(a), ca.ceil(a), ca.fabs(a), ca.erf(a)),
        *(ca.sinh(a), ca.cosh(a), ca.tanh(a), ca.asinh(a), ca.acosh(1.0 + half), ca.atanh(half), ca.sign(a)),
        *(ca.log1p(half), ca.expm1(a), ca.logic_not(a), half**2.5),
    ]


def binary(a: ca.SX, b: ca.SX) -> list[ca.SX]:
    """Return every operation on two values."""
    return [
        *(a + b, a - b, a * b, a / b, ca.fabs(a) ** b, a < b, a <= b, a == b, a != b, ca.fmin(a, b)),
        *(ca.logic_and(a, b), ca.logic_or(a, b), ca.if_else(a < b, a, b), ca.fmax(a, b), ca.fmod(a, b)),
        *(ca.copysign(a, b), ca.atan2(a, b), ca.hypot(a, b), ca.remainder(a, b)),
    ]


def test_each_operation_in_each_lane_is_that_of_casadi(tmp_path: Path) -> None:
    x, u, t, p = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", 2)
    values = [
        *unary(x[0]),
        *unary(p[0]),
        *binary(x[0], u[1]),
        *binary(x[1], p[1]),
        *binary(p[0], t),
        *binary(p[0], p[1]),
        *(ca.SX(0.5), ca.SX(np.inf)),
    ]
    function = ca.Function("operations", [x, u, t, p], [ca.vertcat(*values)])
    head = LOOP.read_text(encoding="utf-8").partition("/* The functions")[0]
    size = len(values)
    source = f"#define SIZE {size}\n{head}{c_function(function)}{_CALL}"
    library = heli_sim.evaluate.compiled.compile_source("lanes", source)
    if library is None:
        pytest.skip("no C compiler")
    random = np.random.default_rng(1)
    state, inputs, times = (random.normal(0.0, 1.5, shape) for shape in ((4, 2), (4, 2), 4))
    inputs[1, 1] = state[1, 0]  # equal operands, for comparisons
    parameters = np.array([0.7, -1.3])
    result = np.empty((4, size))
    ctypes.CDLL(str(library)).run(
        *(ctypes.c_void_p(a.ctypes.data) for a in (state, inputs, times, parameters, result))
    )
    for lane in range(4):
        expected = np.array(function(state[lane], inputs[lane], times[lane], parameters))[:, 0]
        np.testing.assert_allclose(result[lane], expected, rtol=4e-16, atol=0.0)


def test_an_unknown_operation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    x = ca.SX.sym("x", 1)
    function = ca.Function("f", [x], [ca.sin(x)])
    monkeypatch.setattr(lanes, "_EXPRESSIONS", {})
    with pytest.raises(PlantError, match="operation"):
        c_function(function)
