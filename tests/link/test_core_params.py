"""The parameter table on the board holds only what the declaration allows."""

from __future__ import annotations

import math
import struct

import pytest
from heli_host.declaration import PARAMS, ParamSpec, Result
from heli_test_native import link as core_link
from hypothesis import given
from hypothesis import strategies as st

INDEX = {spec.name: spec.index for spec in PARAMS}
SUBNORMAL = struct.unpack("<f", b"\x01\0\0\0")[0]
specs = st.sampled_from(PARAMS)


def next_single(value: float) -> float:
    """The next number that a 32-bit float can hold."""
    bits = struct.unpack("<i", struct.pack("<f", value))[0]
    if value == 0.0:
        return float(SUBNORMAL)
    return float(struct.unpack("<f", struct.pack("<i", bits + (1 if value > 0 else -1)))[0])


def allowed(spec: ParamSpec, value: float) -> bool:
    return (
        math.isfinite(value)
        and spec.min <= value <= spec.max
        and not (spec.nonzero and value == 0.0)
        and not (spec.integer and value != math.floor(value))
    )


@pytest.mark.medium
@given(specs, st.floats(width=32), st.booleans())
def test_exactly_the_declared_values_are_taken(spec: ParamSpec, value: float, idle: bool) -> None:
    params = core_link.Params()
    before = params.values()
    result = params.set(spec.index, value, idle)
    if not allowed(spec, value):
        assert result == Result.OUT_OF_RANGE
    elif spec.idle_only and not idle:
        assert result == Result.UNSAFE_NOW
    else:
        assert result == Result.OK
        before[spec.index] = value
    assert params.values() == before


@pytest.mark.parametrize("spec", PARAMS, ids=lambda spec: spec.name)
def test_both_ends_of_every_range_are_taken_and_what_lies_beyond_is_not(spec: ParamSpec) -> None:
    params = core_link.Params()
    for end in (spec.min, spec.max):
        expected = Result.OUT_OF_RANGE if spec.nonzero and end == 0.0 else Result.OK
        assert params.set(spec.index, end, True) == expected
    assert params.set(spec.index, next_single(spec.max), True) == Result.OUT_OF_RANGE
    assert params.set(spec.index, -next_single(-spec.min), True) == Result.OUT_OF_RANGE


@pytest.mark.parametrize("name", ["motor_front_sign", "motor_back_sign"])
def test_a_sign_is_either_minus_one_or_one_on_the_board(name: str) -> None:
    params = core_link.Params()
    for value in (0.5, -0.5, 0.0, next_single(-1.0), -next_single(1.0), SUBNORMAL):
        assert params.set(INDEX[name], value, True) == Result.OUT_OF_RANGE
    for value in (-1.0, 1.0):
        assert params.set(INDEX[name], value, True) == Result.OK


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_parameter_takes_what_is_no_number(value: float) -> None:
    params = core_link.Params()
    assert {params.set(spec.index, value, True) for spec in PARAMS} == {Result.OUT_OF_RANGE}


def test_there_is_no_parameter_beyond_the_table() -> None:
    params = core_link.Params()
    for index in (len(PARAMS), 255):
        assert params.set(index, 1.0, True) == Result.NO_SUCH_PARAMETER


def test_defaults_are_the_declared_ones_and_agree_with_each_other() -> None:
    params = core_link.Params()
    params.set(INDEX["hover_V"], 3.0, True)
    params.defaults()
    assert params.values() == pytest.approx([spec.default for spec in PARAMS], rel=1e-7)
    assert params.consistent()


def test_only_a_change_raises_the_revision() -> None:
    params = core_link.Params()
    before = params.revision
    params.set(INDEX["hover_V"], -1.0, True)
    params.set(INDEX["supply_V"], 12.0, False)
    assert params.revision == before
    params.set(INDEX["hover_V"], 1.0, False)
    assert params.revision != before


@pytest.mark.parametrize(
    "changes",
    [
        {"supply_V": 9.0},
        {"motor_max_V": 12.5},
        {"setpoint_hold_s": 2.0},
        {"setpoint_land_s": 0.4},
        {"travel_counts_per_rev": SUBNORMAL},
    ],
    ids=str,
)
def test_values_in_range_may_still_contradict_each_other(changes: dict[str, float]) -> None:
    params = core_link.Params()
    for name, value in changes.items():
        assert params.set(INDEX[name], value, True) == Result.OK
    assert not params.consistent()


@pytest.mark.parametrize(
    "changes",
    [
        {"motor_max_V": 12.0},
        {"motor_front_sign": -1.0, "motor_back_sign": -1.0},
        {"elevation_counts_per_rev": -65536.0},
        {"motor_min_V": -10.0},
        {"elevation_rest_deg": 0.0},
    ],
    ids=str,
)
def test_values_at_the_edge_of_contradiction_agree(changes: dict[str, float]) -> None:
    params = core_link.Params()
    for name, value in changes.items():
        assert params.set(INDEX[name], value, True) == Result.OK
    assert params.consistent()
