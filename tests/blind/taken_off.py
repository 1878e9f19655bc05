"""Cases of listed effects that are taken off the list, in weather, half of them beside a rotor lag."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from tests.blind.disturbances import DisturbanceModel, MEMORIES_s, STRENGTHS_Nm
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.disturbed_cases import LAG, PAPER, SIZES
from tests.blind.hidden import LISTED, MORE_LISTED, Maker
from tests.blind.measured_effects import MEASURED_EFFECTS
from tests.blind.tracking import CONTROLLERS

TAKEN_OFF: Final[Mapping[str, tuple[str, ...]]] = {
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
"""Effects, each with those of its family that go with it: another name for the same is no gap in a list."""
_LAG_s, _LARGER = 0.1, 1.6
"""Other sizes are larger by so much than in a draughty room, and the room is still: on the list these effects
take an error that can be seen beside the weather's."""
_MAKERS: Final[Mapping[str, Maker]] = {
    **{name: maker for name, (maker, _, _) in (LISTED | MORE_LISTED).items()},
    **{name: maker for name, (maker, _) in MEASURED_EFFECTS.items()},
}


def taken_off_cases() -> list[DisturbedCase]:
    """One of each effect."""
    cases = []
    for number, name in enumerate(TAKEN_OFF):
        beside = ((LAG, _LAG_s),) if number % 2 and name != LAG else ()
        effects = (*beside, (name, SIZES[name] * (1.0 if name == LAG else _LARGER)))
        cases.append(
            DisturbedCase(
                f"taken-off-{name}",
                effects,
                (),
                6000 + number,
                tuple(_MAKERS[one] for one, _ in effects),
                PAPER,
                100,
                False,
                CONTROLLERS[number % 3],
                DisturbanceModel(STRENGTHS_Nm[0], MEMORIES_s[number % 3]),
            )
        )
    return cases
