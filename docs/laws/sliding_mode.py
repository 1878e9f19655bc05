"""Sliding mode: each error is driven onto a line and kept there; tanh for the sign, against chattering."""

from heli_lab.control.tune import linear_plant
from heli_lab.law import Command, control_law, law_rig, motor_volts, saturated, tanh

plant = linear_plant(law_rig())


@control_law(rate_Hz=1000, parameters={"reach_V": 1.0, "layer_rad_s": 0.15, "hover_V": plant.hover_V})
def sliding_mode(now, state, parameter):
    slide_rad_s = (now.elevation_rad_s - now.elevation_setpoint_rad_s) + 1.5 * (
        now.elevation_rad - now.elevation_setpoint_rad
    )
    hang = -plant.elevation_A[1, 0] / plant.elevation_gain
    collective_V = (
        parameter.hover_V
        + hang * now.elevation_rad
        + now.elevation_setpoint_rad_s2 / plant.elevation_gain
        - parameter.reach_V * tanh(slide_rad_s / parameter.layer_rad_s)
    )
    travel_rad_s = (now.travel_rad_s - now.travel_setpoint_rad_s) + 0.5 * (
        now.travel_rad - now.travel_setpoint_rad
    )
    ahead_rad = now.travel_setpoint_rad_s2 / plant.travel_gain
    pitch_rad = saturated(ahead_rad - 0.4 * tanh(travel_rad_s / 0.2), -0.5, 0.5)
    tilt_rad_s = now.pitch_rad_s + 4.0 * (now.pitch_rad - pitch_rad)
    hold_V = -plant.tilt_A[2, 0] / plant.pitch_gain * now.pitch_rad
    differential_V = saturated(hold_V - 0.7 * tanh(tilt_rad_s / 0.8), -1.4, 1.4)
    return Command(
        *motor_volts(collective_V, differential_V),
        pitch_setpoint_rad=pitch_rad,
        signals={"slide_elevation": slide_rad_s, "slide_travel": travel_rad_s},
    )


LAW = sliding_mode
