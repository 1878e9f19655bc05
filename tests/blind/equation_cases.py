"""Cases of unlisted equations: each of `equations.py` in two sizes, disturbed, half with a rotor lag."""

from __future__ import annotations

import numpy as np

from tests.blind.disturbances import DisturbanceModel, MEMORIES_s, STRENGTHS_Nm
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.equations import LAWS, Makes
from tests.blind.hidden import LISTED, Maker
from tests.blind.tracking import CONTROLLERS

_SIZES = {"large": 1.6, "small": 1.0}
_LARGER = (0.7, 1.0, 1.6)
"""Sizes go with the strength of the weather, as in `disturbed_cases.py`."""
_LAG_s = 0.1
_RATES_Hz = (100, 250)


def equation_cases() -> list[DisturbedCase]:
    """All of them, in an order in which the first are a fair sample of all."""
    cases = []
    for number, (size, law) in enumerate((size, law) for size in _SIZES for law in LAWS):
        rng = np.random.default_rng([5000 + number, 6])
        strength = int(rng.integers(3))
        disturbances = DisturbanceModel(STRENGTHS_Nm[strength], MEMORIES_s[int(rng.integers(3))])
        lag = bool(number % 2)
        makers: tuple[Maker, ...] = (Makes(law),)
        cases.append(
            DisturbedCase(
                f"law-{law}-{size}",
                (("rotor_lag", _LAG_s),) if lag else (),
                ((law, LAWS[law].size * _SIZES[size] * _LARGER[strength]),),
                5000 + number,
                (LISTED["rotor_lag"][0], *makers) if lag else makers,
                "makki2024",
                int(rng.choice(_RATES_Hz)),
                False,
                CONTROLLERS[int(rng.integers(3))],
                disturbances,
            )
        )
    return [cases[i] for i in np.random.default_rng(4).permutation(len(cases))]
