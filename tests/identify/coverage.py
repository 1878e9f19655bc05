"""How often the truth is within the standard errors: rigs drawn from their tolerances, flown, identified.

`make bench` does fifty; a test does a few. The parameters of a rig are drawn from the tolerances of its
file; the
flight code flies the built-in plan `identify` on it, and another flight that the fit does not see.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from heli_lab.identify.run import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.identify.made import encoder_zeros_deg, flown, flown_by_plan, perturbed

HELD_OUT_S = 40.0


@dataclass(frozen=True)
class Covered:
    """One rig, flown and identified.

    Parameters
    ----------
    seed : int
        Which rig.
    off : dict of float
        For each parameter, how far the estimate is from the truth, in its standard errors.
    train, held_out : float
        Normalised residual on the flight fitted, and on one that the fit did not see.
    """

    seed: int
    off: dict[str, float]
    train: float
    held_out: float


def cover(seed: int) -> Covered:
    """Draw a rig, fly it twice, identify it from the first flight."""
    rig = perturbed(seed)
    found = identify(
        MultibodyModel(),
        load_rig("makki2024"),
        [flown_by_plan(rig, seed)],
        validation=[flown(rig, 1000 + seed, HELD_OUT_S)],
    )
    truth = {name: rig[name].value for name in found.fit.values} | encoder_zeros_deg(rig, seed)
    off = {
        name: (value - truth[name]) / std
        for (name, value), std in zip(found.fit.values.items(), found.fit.std.values(), strict=True)
    }
    residual = found.json()["normalised_residual"]
    return Covered(seed, off, residual["train"], residual["validation"])


def share_within(flights: Iterable[Covered], bound: float = 2.0) -> float:
    """Share of all parameters whose truth lies within so many standard errors."""
    return float(np.mean([abs(off) < bound for flight in flights for off in flight.off.values()]))
