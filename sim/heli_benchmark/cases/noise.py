"""Five kinds of noise, with nothing hidden or with one or two causes.

Seeds 8000 to 8099 are for development; 8100 to 8199 judge. Twenty consecutive seeds have each kind twice with
nothing hidden, once with one cause and once with two.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from typing_extensions import override

from heli_benchmark.cases.disturbed import LAG, MAKERS, PAPER_RIG, SIZES, RATES_Hz
from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.cases.shocks import UNDISTURBED
from heli_benchmark.effects.noise import NOISE
from heli_benchmark.engine.plant import HiddenEffect
from heli_benchmark.simulation.tracking import CONTROLLERS

NOISE_KINDS: Final = tuple(NOISE)
_ALONE: Final = (LAG, "thrust_asymmetry", "coulomb_friction.travel", "cable_spring.travel", "axis_tilt")
_WITH_LAG: Final = ("coulomb_friction.elevation", "thrust_asymmetry", "cable_spring.travel", "axis_tilt")
"""Causes that are plain under moderate disturbances."""


@dataclass(frozen=True)
class NoiseCase(DisturbedCase):
    """Causes, or none, under noise of one kind."""

    kind: str = ""  # Kind of noise, of `NOISE_KINDS`

    @override
    def hidden(self, flight: int = 0) -> list[HiddenEffect]:
        return [*super().hidden(flight), *NOISE[self.kind](np.random.default_rng([self.seed, 14, flight]))]


def noise_case(seed: int) -> NoiseCase:
    """Draw the case of a `seed`."""
    rng = np.random.default_rng([seed, 13])
    kind, causes = NOISE_KINDS[seed % len(NOISE_KINDS)], max(0, seed // len(NOISE_KINDS) % 4 - 1)
    names: tuple[str, ...] = ()
    if causes == 1:
        names = (str(rng.choice(_ALONE)),)
    elif causes:
        names = (LAG, str(rng.choice(_WITH_LAG)))
    return NoiseCase(
        name=f"noise-{kind}-{'+'.join(names) or 'nothing'}-{seed}",
        effects=tuple((name, SIZES[name] * float(rng.uniform(0.75, 1.3))) for name in names),
        unlisted=(),
        seed=seed,
        makers=tuple(MAKERS[name] for name in names),
        rig_name=PAPER_RIG,
        rate_Hz=RATES_Hz[int(rng.integers(len(RATES_Hz)))],
        gentle=False,
        controller=CONTROLLERS[int(rng.integers(len(CONTROLLERS)))],
        disturbances=UNDISTURBED,
        kind=kind,
    )
