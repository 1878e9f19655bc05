"""Small effects, or none, in flights without disturbances, at several rates.

Without disturbances a flight shows effects far below an encoder count, and the numerical errors of the method
are as large. Seeds 7000 to 7029 are for development; 7100 to 7129 judge.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_benchmark.cases.disturbed import PAPER_RIG, RATES_Hz
from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.cases.shocks import UNDISTURBED
from heli_benchmark.effects.listed import LISTED
from heli_benchmark.simulation.tracking import CONTROLLERS

CALM_EFFECTS: Final = (
    (),
    (("supply_sag", 0.01),),
    (("supply_sag", 0.0025),),
    (("input_delay", 0.03), ("supply_sag", 0.008)),
)
"""Hidden effects with their sizes; a seed selects by its remainder. A sag is a share per volt of the
rotors' mean: twice the catalogue's share per volt of their sum."""


@dataclass(frozen=True)
class CalmCase(DisturbedCase):
    """Small effects in a rig of slightly different parameters."""


def calm_case(seed: int) -> CalmCase:
    """Draw the case of a `seed`."""
    rng = np.random.default_rng([seed, 12])
    effects = CALM_EFFECTS[seed % len(CALM_EFFECTS)]
    return CalmCase(
        name=f"calm-{'+'.join(f'{id_}-{size:g}' for id_, size in effects) or 'nothing'}-{seed}",
        effects=effects,
        unlisted=(),
        seed=seed,
        makers=tuple(LISTED[id_][0] for id_, _ in effects),
        rig_name=PAPER_RIG,
        rate_Hz=RATES_Hz[int(rng.integers(len(RATES_Hz)))],
        gentle=False,
        controller=CONTROLLERS[int(rng.integers(len(CONTROLLERS)))],
        disturbances=UNDISTURBED,
    )
