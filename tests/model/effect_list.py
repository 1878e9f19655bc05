"""Effects that the project promises; the catalogue may have more."""

from __future__ import annotations

from heli_sim.model.parts import AXES

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
