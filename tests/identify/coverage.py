"""Coverage: how often true parameters are within the standard errors of an identification.

The parameters of a simulated rig are drawn from the tolerances of its file. The flight code flies the
built-in plan `identify` on this rig, and a second flight that no fit uses. `make bench` repeats this for
fifty rigs, a test for a few.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from heli_lab.fit.identification import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.identify.made import encoder_zeros_deg, flown, flown_by_plan, perturbed

HELD_OUT_S = 40.0


@dataclass(frozen=True)
class Covered:
    """Errors of the identification of one simulated rig."""

    # `seed`: Seed from which the rig was drawn.
    # `errors_in_std`: For each parameter, estimate less true value, in standard errors.
    # `train`, `held_out`: Normalised residual on the fitted flight, and on the flight that no fit used.

    seed: int
    errors_in_std: dict[str, float]
    train: float
    held_out: float


def cover(seed: int) -> Covered:
    """Draw a rig by a `seed`, fly it twice, and identify it from the first flight."""
    rig = perturbed(seed)
    identified = identify(
        MultibodyModel(),
        load_rig("makki2024"),
        [flown_by_plan(rig, seed)],
        validation=[flown(rig, 1000 + seed, HELD_OUT_S)],
    )
    truth = {name: rig[name].value for name in identified.fit.params} | encoder_zeros_deg(rig, seed)
    errors_in_std = {
        name: (value - truth[name]) / std
        for (name, value), std in zip(identified.fit.params.items(), identified.fit.std.values(), strict=True)
    }
    residual = identified.json()["normalised_residual"]
    return Covered(seed, errors_in_std, residual["train"], residual["validation"])


def share_within(flights: Iterable[Covered], bound: float = 2.0) -> float:
    """Return the share of all parameters whose error is less than `bound` standard errors."""
    errors = [error for flight in flights for error in flight.errors_in_std.values()]
    return float(np.mean(np.abs(errors) < bound))
