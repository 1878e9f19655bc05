"""Counts and edges say the same thing, whatever the motion."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_test_native import plant
from hypothesis import given
from hypothesis import strategies as st

PER_RAD = [4096 / (2 * math.pi)] * 3

angles = st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=3)
# At most 7 rad/s, the fastest that the board tolerates in pitch.
moves = st.lists(st.floats(-0.007, 0.007), min_size=3, max_size=3)
offsets = st.lists(st.floats(-1e5, 1e5), min_size=3, max_size=3)


@pytest.mark.medium
@given(start=angles, steps=st.lists(moves, min_size=1, max_size=20), offset=offsets)
def test_edges_add_up_to_the_counts(
    start: list[float], steps: list[list[float]], offset: list[float]
) -> None:
    at, counted = start, np.array(plant.encoder_counts(start, PER_RAD, offset))
    for step in steps:
        to = [angle + change for angle, change in zip(at, step, strict=True)]
        for _, axis, direction in plant.encoder_edges(at, to, PER_RAD, offset):
            counted[axis] += direction
        assert counted.tolist() == plant.encoder_counts(to, PER_RAD, offset)
        at = to


@pytest.mark.medium
@given(start=angles, step=moves, offset=offsets)
def test_edges_come_in_order_and_within_the_millisecond(
    start: list[float], step: list[float], offset: list[float]
) -> None:
    to = [angle + change for angle, change in zip(start, step, strict=True)]
    times = [time_us for time_us, _, _ in plant.encoder_edges(start, to, PER_RAD, offset)]
    assert times == sorted(times)
    assert all(0.0 <= time_us < 1000.0 for time_us in times)


def test_an_edge_comes_when_the_angle_crosses_the_line() -> None:
    half_count = 0.5 / PER_RAD[0]
    low, high = 0.5 * half_count, 4.5 * half_count
    up = plant.encoder_edges([low, 0, 0], [high, 0, 0], PER_RAD, [0] * 3)
    assert [(axis, direction) for _, axis, direction in up] == [(0, 1), (0, 1)]
    assert [time_us for time_us, _, _ in up] == pytest.approx([375.0, 875.0])
    down = plant.encoder_edges([high, 0, 0], [low, 0, 0], PER_RAD, [0] * 3)
    assert [(axis, direction) for _, axis, direction in down] == [(0, -1), (0, -1)]
    assert [time_us for time_us, _, _ in down] == pytest.approx([125.0, 625.0])


def test_a_revolution_is_4096_counts() -> None:
    zero = plant.encoder_counts([0.0] * 3, PER_RAD, [0.5] * 3)
    turned = plant.encoder_counts([2 * math.pi] * 3, PER_RAD, [0.5] * 3)
    assert [b - a for a, b in zip(zero, turned, strict=True)] == [4096] * 3


def test_a_count_is_the_whole_number_below() -> None:
    counts = plant.encoder_counts([-0.5 / PER_RAD[0], 0.5 / PER_RAD[0], 1.5 / PER_RAD[0]], PER_RAD, [0] * 3)
    assert counts == [-1, 0, 1]
