"""The board's own law, the paper's PID cascade, written again as a law of one's own."""

from heli_host.declaration import PARAMS
from heli_lab.law import Command, control_law, motor_volts, saturated

DEG = 57.29577951308232
DT_s = 1e-3
p = {spec.name: spec.default for spec in PARAMS}


@control_law(
    rate_Hz=1000,
    states={"elevation_V": 0.0, "pitch_V": 0.0, "travel_rad": 0.0},
    parameters={"hover_V": p["hover_V"], "elevation_kp": p["elevation_kp"], "travel_kp": p["travel_kp"]},
)
def cascade(now, state, parameter):
    most_rad = p["pitch_setpoint_max_deg"] / DEG
    travel_rad = now.travel_setpoint_rad - now.travel_rad
    wanted_rad = (
        p["travel_acceleration_ff"] * now.travel_setpoint_rad_s2
        + parameter.travel_kp * travel_rad
        - p["travel_kd"] * (now.travel_rad_s - now.travel_setpoint_rad_s)
        + state.travel_rad
    )
    pitch_setpoint_rad = saturated(wanted_rad, -most_rad, most_rad)
    pitch_rad = pitch_setpoint_rad - now.pitch_rad
    differential_V = (
        p["pitch_hold_ff"] * DEG * pitch_setpoint_rad
        + p["pitch_kp"] * DEG * pitch_rad
        - p["pitch_kd"] * DEG * now.pitch_rad_s
        + state.pitch_V
    )
    elevation_rad = now.elevation_setpoint_rad - now.elevation_rad
    collective_V = (
        parameter.hover_V
        + p["hover_slope"] * DEG * now.elevation_setpoint_rad
        + p["elevation_acceleration_ff"] * DEG * now.elevation_setpoint_rad_s2
        + parameter.elevation_kp * DEG * elevation_rad
        - p["elevation_kd"] * DEG * (now.elevation_rad_s - now.elevation_setpoint_rad_s)
        + state.elevation_V
    )
    limit_V = p["differential_max_V"]

    def integral(value, rate, error_rad, most):
        return saturated(value + DT_s * rate * error_rad, -most, most)

    return Command(
        *motor_volts(collective_V, saturated(differential_V, -limit_V, limit_V), p["dead_zone_V"]),
        states={
            "elevation_V": integral(state.elevation_V, p["elevation_ki"] * DEG, elevation_rad, 3.0),
            "pitch_V": integral(state.pitch_V, p["pitch_ki"] * DEG, pitch_rad, 2.0),
            "travel_rad": integral(state.travel_rad, p["travel_ki"], travel_rad, 10.0 / DEG),
        },
        pitch_setpoint_rad=pitch_setpoint_rad,
    )


LAW = cascade
