"""The operations of a tape: exact where IEEE 754 is, near to the function where it says nothing."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from heli_host.declaration import OPERATIONS
from heli_test_native import law as native_law

Floats = npt.NDArray[np.float32]
CODE = {operation.name: operation.code for operation in OPERATIONS}
TINY = np.finfo(np.float32).tiny
SPECIAL = np.array(
    [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, TINY, -TINY, 3.4028235e38, 0.5, 1.5, 2.5, 8388608.0,
     16777216.0, 1.0000001, 0.99999994, 1e-45, 8191.999, 8192.0, 88.7, 89.0, -87.4],
    np.float32,
)  # fmt: skip


def operands(seed: int) -> Floats:
    """Special numbers against each other, any bits, and pairs of like size."""
    print(f"seed {seed}")
    chance = np.random.default_rng(seed)
    pairs = np.array(np.meshgrid(SPECIAL, SPECIAL)).reshape(2, -1).T
    bits = chance.integers(0, 1 << 32, (200_000, 2), np.uint64).astype(np.uint32).view(np.float32)
    near = (bits.view(np.uint32) & 0x803FFFFF | 0x3F000000 + (bits.view(np.uint32) & 0x01C00000)).view(
        np.float32
    )
    return np.ascontiguousarray(np.vstack([pairs, bits, near]).astype(np.float32))


def flushed(values: Floats) -> Floats:
    """Numbers below the normal ones as zeros of their sign."""
    return np.where(np.abs(values) < TINY, np.copysign(np.float32(0.0), values), values)


def same(results: Floats, wanted: Floats) -> npt.NDArray[np.bool_]:
    """Bit for bit, any "no number" like any other."""
    alike: npt.NDArray[np.bool_] = results.view(np.uint32) == wanted.view(np.uint32)
    return alike | (np.isnan(results) & np.isnan(wanted))


def computed(name: str, pairs: Floats) -> Floats:
    return native_law.operate(CODE[name], pairs)[:, 0]


@pytest.mark.parametrize("name", ["add", "subtract", "multiply", "divide", "square_root"])
def test_arithmetic_is_that_of_ieee_754_but_for_numbers_below_the_normal_ones(name: str) -> None:
    pairs = operands(1)
    a, b = flushed(pairs[:, 0]), flushed(pairs[:, 1])
    functions = {"add": np.add, "subtract": np.subtract, "multiply": np.multiply, "divide": np.divide}
    with np.errstate(all="ignore"):
        wanted = flushed(np.sqrt(a) if name == "square_root" else functions[name](a, b))
    # A product that is rounded up to the least normal number is that number in one way of counting.
    edge = np.abs(wanted) <= TINY
    results = computed(name, pairs)
    agree = same(results, wanted) | (edge & (np.abs(results) <= TINY))
    worst = np.flatnonzero(~agree)[:5]
    assert agree.all(), [(a[k], b[k], results[k], wanted[k]) for k in worst]


def test_comparison_and_selection_are_those_of_ieee_754_but_for_no_number() -> None:
    pairs = operands(2)
    a, b = flushed(pairs[:, 0]), flushed(pairs[:, 1])
    zero = np.float32(0.0)
    with np.errstate(all="ignore"):
        wanted = {
            "copy": a, "negate": -a, "absolute": np.abs(a), "less": a < b, "less_equal": a <= b,
            "equal": a == b, "not_equal": a != b, "both": (a != 0) & (b != 0),
            "either": (a != 0) | (b != 0), "negation": a == 0,
            "select": np.where(a != 0, b, zero), "floor": np.floor(a),
        }  # fmt: skip
    # Unlike IEEE 754, a condition of what is no number is no number either; what is not selected is nothing.
    no_number = np.isnan(a) | np.isnan(b)
    of_first = ("copy", "negate", "absolute", "negation", "select", "floor")
    for name, values in wanted.items():
        expected = np.where(np.isnan(a) if name in of_first else no_number, np.nan, values)
        assert same(computed(name, pairs), expected.astype(np.float32)).all(), name
    # Which of two zeros is the lesser, nothing says.
    for name, values in (("minimum", np.minimum(a, b)), ("maximum", np.maximum(a, b))):
        results = computed(name, pairs)
        assert (same(results, values) | (results == values)).all(), name


@pytest.mark.parametrize(
    ("name", "reference", "reach", "most_error"),
    [
        ("sine", np.sin, 20.0, 1.2e-7), ("cosine", np.cos, 20.0, 1.2e-7), ("sine", np.sin, 1e-3, 4e-9),
        ("hyperbolic_tangent", np.tanh, 12.0, 2.4e-7), ("exponential", np.exp, 0.7, 2.4e-7),
    ],
)  # fmt: skip
def test_functions_are_right_to_the_last_bit_or_two(
    name: str, reference: np.ufunc, reach: float, most_error: float
) -> None:
    values = np.linspace(-reach, reach, 400_001).astype(np.float32)
    pairs = np.ascontiguousarray(np.column_stack([values, values]))
    error = np.abs(computed(name, pairs) - reference(values.astype(float)))
    assert error.max() < most_error, values[error.argmax()]


def test_tangent_exponential_and_arctangent_are_right_relative_to_their_size() -> None:
    chance = np.random.default_rng(3)
    values = chance.uniform(-1.5, 1.5, (200_000, 2)).astype(np.float32)
    exact = values.astype(float)
    error = np.abs(computed("tangent", values) - np.tan(exact[:, 0]))
    assert (error * np.cos(exact[:, 0]) ** 2).max() < 3e-7
    assert (
        np.abs(computed("exponential", 50.0 * values) / np.exp(50.0 * values[:, 0].astype(float)) - 1).max()
        < 1e-5
    )
    angle = np.arctan2(exact[:, 0], exact[:, 1])
    assert np.abs(computed("arctangent", values) - angle).max() < 3e-7


def test_arctangent_knows_all_quadrants_and_zeros_and_infinities() -> None:
    numbers = [0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, 1e-30, np.nan]
    pairs = np.array([(y, x) for y in numbers for x in numbers], np.float32)
    wanted = np.arctan2(pairs[:, 0], pairs[:, 1])
    results = computed("arctangent", pairs)
    assert np.array_equal(np.isnan(results), np.isnan(wanted))
    assert np.nanmax(np.abs(results - wanted)) < 3e-7


def test_functions_beyond_their_reach_say_so() -> None:
    pairs = np.array([[8192.0, 0], [-9000.0, 0], [np.inf, 0], [np.nan, 0]], np.float32)
    for name in ("sine", "cosine", "tangent"):
        assert np.isnan(computed(name, pairs)).all(), name
    ends = np.array([[90.0, 0], [-110.0, 0], [np.inf, 0], [-np.inf, 0]], np.float32)
    assert computed("exponential", ends).tolist() == [np.inf, 0.0, np.inf, 0.0]
    assert computed("hyperbolic_tangent", ends).tolist() == [1.0, -1.0, 1.0, -1.0]
