"""Cases of unlisted equations: each of `equations.py` in two sizes, disturbed, half with a rotor lag."""

from __future__ import annotations

import numpy as np

from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.effects.equations import EQUATIONS, MakeUnlisted
from heli_benchmark.effects.listed import LISTED, Maker
from heli_benchmark.simulation.tracking import CONTROLLERS

_SIZES = {"large": 1.6, "small": 1.0}
_LARGER = (0.7, 1.0, 1.6)
"""Factors of the sizes by strength of the disturbances, as in `disturbed.py`."""
_LAG_s = 0.1
_RATES_Hz = (100, 250)


def equation_cases() -> list[DisturbedCase]:
    """Return all cases, in an order in which the first are a fair sample of all."""
    cases = []
    for number, (size, equation) in enumerate((size, equation) for size in _SIZES for equation in EQUATIONS):
        rng = np.random.default_rng([5000 + number, 6])
        strength = int(rng.integers(3))
        disturbances = DisturbanceModel(STRENGTHS_Nm[strength], CORRELATION_TIMES_s[int(rng.integers(3))])
        has_lag = bool(number % 2)
        makers: tuple[Maker, ...] = (MakeUnlisted(equation),)
        cases.append(
            DisturbedCase(
                f"law-{equation}-{size}",
                (("rotor_lag", _LAG_s),) if has_lag else (),
                ((equation, EQUATIONS[equation].size * _SIZES[size] * _LARGER[strength]),),
                5000 + number,
                (LISTED["rotor_lag"][0], *makers) if has_lag else makers,
                "makki2024",
                int(rng.choice(_RATES_Hz)),
                False,
                CONTROLLERS[int(rng.integers(3))],
                disturbances,
            )
        )
    return [cases[i] for i in np.random.default_rng(4).permutation(len(cases))]
