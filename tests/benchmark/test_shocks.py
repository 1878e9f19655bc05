"""The shock cases of a seed: every size, both disturbances, every layout of the flights."""

from __future__ import annotations

import math

from heli_benchmark.cases.shocks import SHOCK_LAYOUTS, SLIP_EFFECT, SLIPS_m, shock_cases
from heli_benchmark.runs.shocks import is_named


def test_a_seed_gives_twelve_cases_whose_slip_comes_where_the_layout_says() -> None:
    cases = list(shock_cases(5000))
    assert len(cases) == len({case.name for case in cases}) == 2 * len(SLIPS_m) * len(SHOCK_LAYOUTS)
    assert cases == list(shock_cases(5000)) != list(shock_cases(5001))
    for case in cases:
        comes = [math.isfinite(moment_s) for moment_s in case.moments_s]
        assert comes == {"fit": [True, False], "both": [True, True], "second": [False, True]}[case.layout]
        assert case.moments_s[0] != case.moments_s[1]
    assert sum(any(case.disturbances.gusts_Nm) for case in cases) == 6


def test_a_slip_counts_as_named_if_it_is_the_only_cause_and_of_the_right_size() -> None:
    case = next(case for case in shock_cases(5000) if case.slip_m == 0.01)

    def result(*causes: tuple[str, float]) -> dict[str, object]:
        number = {f"{SLIP_EFFECT}_m": {"value": 0.0, "std": 1e-4, "unit": "m"}}
        return {
            "causes": [
                {
                    "effect": effect,
                    "parameters": {name: {**value, "value": size} for name, value in number.items()},
                }
                for effect, size in causes
            ]
        }

    assert is_named(case, result((SLIP_EFFECT, 0.0102)))
    assert not is_named(case, result((SLIP_EFFECT, 0.0104)))
    assert not is_named(case, result())
    assert not is_named(case, result((SLIP_EFFECT, 0.01), ("rotor_lag", 0.01)))
