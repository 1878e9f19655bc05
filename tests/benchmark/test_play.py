"""The cases with play have each axis with each size, under disturbances of each strength."""

from __future__ import annotations

import numpy as np
from heli_benchmark.cases.play import PLAY_AXES, PLAYS_deg, play_case


def test_nine_consecutive_seeds_have_each_axis_with_each_size_once() -> None:
    for first in (9000, 9108):
        cases = [play_case(seed) for seed in range(first, first + 9)]
        causes = [case.effects[0] for case in cases]
        nearest_deg = [
            PLAYS_deg[int(np.argmin(np.abs(np.divide(PLAYS_deg, deg) - 1.0)))] for _, deg in causes
        ]
        expected = {(f"backlash.{axis}", size) for axis in PLAY_AXES for size in PLAYS_deg}
        assert set(zip((name for name, _ in causes), nearest_deg, strict=True)) == expected
        strengths = [case.disturbances.gusts_Nm for case in cases]
        assert sorted(strengths.count(strength) for strength in set(strengths)) == [3, 3, 3]


def test_a_case_is_drawn_from_its_seed_alone() -> None:
    assert play_case(9003) == play_case(9003)
    assert play_case(9003) != play_case(9012)
