"""Feedback linearisation: the travel that tilted thrust gives is inverted, sine and all."""

from heli_lab.control.tune import linear_plant
from heli_lab.law import Command, atan2, control_law, cos, fmax, law_rig, motor_volts, saturated

plant = linear_plant(law_rig())
DT_s = 1e-3


@control_law(
    rate_Hz=1000,
    states={"elevation_V": 0.0},
    parameters={"w_elevation": 1.6, "w_pitch": 4.0, "w_travel": 0.7, "hover_V": plant.hover_V},
)
def feedback_linearisation(now, state, parameter):
    w = parameter.w_travel
    travel_rad_s2 = (
        now.travel_setpoint_rad_s2
        + 1.6 * w * (now.travel_setpoint_rad_s - now.travel_rad_s)
        + w * w * (now.travel_setpoint_rad - now.travel_rad)
    )
    # The acceleration of travel is the tangent of pitch times that of the lift that carries the arm.
    pitch_rad = saturated(atan2(travel_rad_s2, plant.travel_gain), -0.4, 0.4)
    w = parameter.w_pitch
    pitch_rad_s2 = w * w * (pitch_rad - now.pitch_rad) - 1.8 * w * now.pitch_rad_s
    hold = -plant.tilt_A[2, 0]
    differential_V = (pitch_rad_s2 + hold * now.pitch_rad) / plant.pitch_gain
    w = parameter.w_elevation
    error_rad = now.elevation_setpoint_rad - now.elevation_rad
    elevation_rad_s2 = (
        now.elevation_setpoint_rad_s2
        + 1.8 * w * (now.elevation_setpoint_rad_s - now.elevation_rad_s)
        + w * w * error_rad
    )
    hang = -plant.elevation_A[1, 0]
    lift_V = parameter.hover_V + (elevation_rad_s2 + hang * now.elevation_rad) / plant.elevation_gain
    # Tilted thrust carries less.
    collective_V = (lift_V + state.elevation_V) / fmax(cos(now.pitch_rad), 0.7)
    return Command(
        *motor_volts(collective_V, saturated(differential_V, -1.4, 1.4)),
        states={"elevation_V": saturated(state.elevation_V + DT_s * 15.0 * error_rad, -2.0, 2.0)},
        pitch_setpoint_rad=pitch_rad,
    )


LAW = feedback_linearisation
