"""Generated C code simulates four windows together, one per lane of a vector register, as CasADi does one."""

from __future__ import annotations

import ctypes
from pathlib import Path

import casadi as ca
import heli_sim.compiled
import numpy as np
import pytest
from heli_lab.errors import IdentifyError
from heli_lab.fit import free_run
from heli_lab.fit.free_run import LOOP, c_function

pytestmark = pytest.mark.medium

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
    library = heli_sim.compiled.compile_source("lanes", source)
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
    monkeypatch.setattr(free_run, "_EXPRESSIONS", {})
    with pytest.raises(IdentifyError, match="operation"):
        c_function(function)
