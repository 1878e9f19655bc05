"""Play between an axis and its encoder: three axes, three sizes, three strengths of disturbances.

Seeds 9000 to 9099 are for development; 9100 to 9199 judge. Nine consecutive seeds, the first a multiple of
nine, have each axis with each size once, and each strength three times.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_benchmark.cases.disturbed import MAKERS, PAPER_RIG, RATES_Hz
from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.cases.shocks import UNDISTURBED
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.simulation.tracking import CONTROLLERS

PLAY_AXES: Final = ("elevation", "pitch", "travel")
PLAYS_deg: Final = (0.5, 1.5, 3.0)
_GUSTS_Nm: Final = (UNDISTURBED.gusts_Nm, STRENGTHS_Nm[1], STRENGTHS_Nm[2])
"""No, moderate and strong disturbances."""


@dataclass(frozen=True)
class PlayCase(DisturbedCase):
    """A play of one encoder."""


def play_case(seed: int) -> PlayCase:
    """Draw the case of a `seed`."""
    rng = np.random.default_rng([seed, 15])
    axis, size = seed % 3, seed // 3 % 3
    strength = (axis + size + seed // 9) % 3
    name = f"backlash.{PLAY_AXES[axis]}"
    return PlayCase(
        name=f"play-{PLAY_AXES[axis]}-{PLAYS_deg[size]:g}-{('no', 'moderate', 'strong')[strength]}-{seed}",
        effects=((name, PLAYS_deg[size] * float(rng.uniform(0.85, 1.15))),),
        unlisted=(),
        seed=seed,
        makers=(MAKERS[name],),
        rig_name=PAPER_RIG,
        rate_Hz=RATES_Hz[int(rng.integers(len(RATES_Hz)))],
        gentle=False,
        controller=CONTROLLERS[int(rng.integers(len(CONTROLLERS)))],
        disturbances=DisturbanceModel(_GUSTS_Nm[strength], CORRELATION_TIMES_s[int(rng.integers(3))]),
    )
