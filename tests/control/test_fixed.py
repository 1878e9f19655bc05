"""The tick's fixed-point numbers: nearest result inside their range, the end of the range outside."""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np
import pytest
from heli_test_native import control
from hypothesis import given
from hypothesis import strategies as st

pytestmark = pytest.mark.medium

MIN, MAX = -(2**31), 2**31 - 1
QUANTITY_BITS, GAIN_BITS = 24, 20
bits = st.integers(MIN, MAX)


def saturated(value: int) -> int:
    return max(MIN, min(MAX, value))


@given(st.floats(width=32, allow_nan=False))
def test_a_float_becomes_the_nearest_quantity(value: float) -> None:
    if math.isinf(value):
        assert abs(control.quantity(value)) == MAX
        return
    exact = Fraction(value) * 2**QUANTITY_BITS
    quantity = control.quantity(value)
    assert abs(quantity - max(-MAX, min(MAX, exact))) <= Fraction(1, 2)


def test_a_float_of_any_exponent_becomes_the_nearest_quantity() -> None:
    for exponent in range(-149, 7):
        for value in (2.0**exponent, -1.5 * 2.0**exponent):
            exact = Fraction(float(np.float32(value))) * 2**QUANTITY_BITS
            assert abs(control.quantity(value) - exact) <= Fraction(1, 2), exponent


@given(bits, bits)
def test_sums_and_differences_saturate(a: int, b: int) -> None:
    assert control.quantity_sum(a, b) == saturated(a + b)
    assert control.quantity_difference(a, b) == saturated(a - b)


@given(bits, bits)
def test_products_are_rounded_and_saturate(gain: int, quantity: int) -> None:
    exact = math.floor(Fraction(gain * quantity, 2**GAIN_BITS) + Fraction(1, 2))
    assert control.quantity_product(gain, quantity) == saturated(exact)


@given(st.integers(0, 2**62 - 1))
def test_square_root_needs_no_division_and_is_right(value: int) -> None:
    exact = math.isqrt(value)
    assert abs(control.square_root(value) - exact) <= 1 + exact * 1e-8


@pytest.mark.parametrize("cutoff_Hz", [0.5, 4.0, 200.0])
def test_rate_filter_agrees_with_double_precision(cutoff_Hz: float) -> None:
    smoothing = 1.0 - math.exp(-2.0 * math.pi * cutoff_Hz * 0.001)
    t = np.arange(20_000) * 0.001
    counts = np.round(2000.0 * np.sin(0.7 * t) + 300.0 * np.sin(9.0 * t))
    angles_rad = counts * 2.0 * math.pi / 4096.0
    law = control.RateFilter()
    first = second = angles_rad[0]
    worst_rad_s = 0.0
    for angle_rad in angles_rad:
        first += smoothing * (angle_rad - first)
        step = smoothing * (first - second)
        second += step
        worst_rad_s = max(worst_rad_s, abs(law.update(float(angle_rad), smoothing) - step * 1000.0))
    # Half of the last bit of a step is 3e-5 rad/s; an encoder's count is 1.5 rad/s before the filter.
    assert worst_rad_s < 2e-4
