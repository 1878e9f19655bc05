"""Cases of effects that are removed from the catalogue, with disturbances, half of them with a rotor lag."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from heli_benchmark.cases.disturbed import LAG, PAPER_RIG, SIZES
from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.effects.listed import LISTED, MORE_LISTED, Maker
from heli_benchmark.effects.measured import MEASURED_EFFECTS
from heli_benchmark.simulation.tracking import CONTROLLERS

REMOVED: Final[Mapping[str, tuple[str, ...]]] = {
    LAG: ("rotor_speed_lag", "rotor_lag_with_delay", "input_delay"),
    "travel_drag_quadratic": (),
    "pitch_drag_quadratic": (),
    "cable_spring.travel": (),
    "axis_tilt": (),
    "edgewise_flow": (),
    "gyroscopic_torque": ("flywheel",),
    "rotor_reaction_torque": (),
    "coulomb_friction.travel": (),
    "thrust_asymmetry": (),
    "inflow_damping": (),
    "encoder_eccentricity.travel": (),
}
"""Effects, each with those of its family: another name for the same effect would leave no gap."""
_LAG_s, _LARGER = 0.1, 1.6
"""Lag in s, and factor of the other sizes under weak disturbances: each effect must reduce an error that is
visible above the disturbances."""
_MAKERS: Final[Mapping[str, Maker]] = {
    **{name: maker for name, (maker, _, _) in (LISTED | MORE_LISTED).items()},
    **{name: maker for name, (maker, _) in MEASURED_EFFECTS.items()},
}


def removed_effect_cases() -> list[DisturbedCase]:
    """Return one case of each effect."""
    cases = []
    for number, name in enumerate(REMOVED):
        lag_effect = ((LAG, _LAG_s),) if number % 2 and name != LAG else ()
        effects = (*lag_effect, (name, SIZES[name] * (1.0 if name == LAG else _LARGER)))
        cases.append(
            DisturbedCase(
                f"taken-off-{name}",
                effects,
                (),
                6000 + number,
                tuple(_MAKERS[effect] for effect, _ in effects),
                PAPER_RIG,
                100,
                False,
                CONTROLLERS[number % 3],
                DisturbanceModel(STRENGTHS_Nm[0], CORRELATION_TIMES_s[number % 3]),
            )
        )
    return cases
