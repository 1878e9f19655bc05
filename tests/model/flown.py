"""Effects flown by the simulated board and found again: ``python -m tests.model.flown`` does them all.

The flight code flies a rig with one effect of typical size; the log is fitted by the same model, with every
number of the rig free and the effect started at half its size.
"""

import math
import sys
from dataclasses import dataclass

import numpy as np
from heli_host.data.flight import Flight
from heli_lab.fit.identification import check
from heli_lab.fit.problem import Problem
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import solve
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.effects import EffectSpec, catalogue
from heli_sim.rig import Prior, load_rig

from tests.identify.made import flown

FLIGHT_S = 30.0
BY_CHANCE = "random_torque"
"""An effect without a number that a free run could be fitted by."""
HIDDEN = "zero_offset.travel"
"""An effect that no flight shows alone."""


@dataclass(frozen=True)
class Found:
    """Result of a fit."""

    # `off`: For each number, how far the estimate is from the truth, in its standard errors.
    # `values`, `std`: Estimates.
    # `normalised`: What is left, in standard deviations of the encoders' quantisation.

    off: dict[str, float]
    values: dict[str, float]
    std: dict[str, float]
    normalised: float


def fly_and_identify(kind: EffectSpec, seed: int = 7) -> Found:
    """Fly an effect and identify it."""
    true = kind.make(kind.typical)
    rig = load_rig("makki2024")
    if true.pushes_below_dead_zone:
        # The voltage that the drivers lose is in no log; it is within the dead zone.
        rig = rig.replace(driver_dead_band=0.0)
    flight = flown(rig, seed, FLIGHT_S, MultibodyModel((true,)))
    record = prepare(flight, rig, "a")
    truth = as_logged(kind, flight)
    values = {name: 0.5 * value if name in kind.size else value for name, value in kind.typical.items()}
    problem = Problem(MultibodyModel((kind.make(values),)), rig, [record], priors=searched(kind))
    fit = solve(problem)
    off = {name: (fit.params[name] - truth[name]) / fit.std[name] for name in kind.priors}
    values = {name: fit.params[name] for name in kind.priors}
    return Found(off, values, {name: fit.std[name] for name in kind.priors}, check(fit).normalised)


def searched(kind: EffectSpec) -> dict[str, Prior]:
    """Priors of moment and frequency, as a search over them would give."""
    near = {kind.full("at_s"): 1.0, kind.full("Hz"): 0.01}
    return {name: Prior(kind.typical[name], near[name], 0.0) for name in near if name in kind.typical}


def as_logged(kind: EffectSpec, flight: Flight) -> dict[str, float]:
    """Truth by the log's time, which begins a little before the motors first turn."""
    truth = dict(kind.typical)
    rig = load_rig("makki2024")
    turn_V = rig["driver_dead_band"].value * rig["supply"].value  # the drivers swallow shorter pulses
    turned_s = float(flight.t_s[np.argmax((flight.voltages_V >= turn_V).any(axis=1))] - flight.t_s[0])
    if kind.full("at_s") in truth:
        truth[kind.full("at_s")] += turned_s
    if kind.full("Hz") in truth:
        angle = 2 * math.pi * truth[kind.full("Hz")] * turned_s
        size_Nm = truth[kind.full("sin_Nm")]
        truth[kind.full("sin_Nm")] = size_Nm * math.cos(angle)
        truth[kind.full("cos_Nm")] = -size_Nm * math.sin(angle)
    return truth


def main(ids: list[str]) -> None:
    """Print what is found of each effect."""
    for kind in catalogue().values():
        shown = not kind.baseline and not kind.id.startswith(BY_CHANCE) and kind.id != HIDDEN
        if kind.id in ids or (shown and not ids):
            estimate = fly_and_identify(kind)
            print(f"{kind.id}: residual {estimate.normalised:.3f}", end="")
            for name, off in estimate.off.items():
                print(
                    f"; {name} {estimate.values[name]:.5g} +- {estimate.std[name]:.2g} ({off:+.1f} std)",
                    end="",
                )
            print(flush=True)


COMMON = [
    *("rotor_lag", "rotor_speed_lag", "rotor_lag_with_delay", "input_delay"),
    *("thrust_quadratic", "thrust_asymmetry", "thrust_fade", "thrust_step.front", "thrust_step.back"),
    *("supply_sag", "supply_fade", "inflow_damping", "ground_effect", "rotor_reaction_torque"),
    *(f"coulomb_friction.{axis}" for axis in AXES),
    *(f"{axis}_drag_quadratic" for axis in AXES),
    *("cable_spring.elevation", "cable_spring.travel", "axis_tilt"),
    "counterweight_shift",
    *(
        f"{effect}.{axis}"
        for effect in ("backlash", "encoder_eccentricity", "zero_offset", "periodic_torque", "random_torque")
        for axis in AXES
    ),
]

MEASURED = ["edgewise_flow", "gyroscopic_torque", "flywheel"]
"""Effects that measured flights of real rigs showed beyond the common ones."""


if __name__ == "__main__":
    main(sys.argv[1:])
