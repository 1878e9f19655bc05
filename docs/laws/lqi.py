"""LQI: LQR with integrators of elevation and travel, and feed-forward of the setpoint's acceleration."""

import control
import numpy as np
from heli_lab.control.tune import linear_plant
from heli_lab.law import Command, control_law, law_rig, motor_volts, saturated

plant = linear_plant(law_rig())
DT_s = 1e-3


def gains(A, B, output, Q, R):
    """Gains on the states, without the rotors' lag, and on the integral of one of them."""
    A, B = A[:-1, :-1], A[:-1, -1:] * (-B[-1] / A[-1, -1])
    size = len(A)
    wide = np.zeros((size + 1, size + 1))
    wide[:size, :size], wide[size, output] = A, 1.0
    return control.lqr(wide, np.vstack([B, [[0.0]]]), np.diag(Q), [[R]])[0][0]


# What hangs below the axes pulls back to level. On pitch that is taken out first, so that pitch comes to rest
# where travel asks for it.
HANG, HOLD = -plant.elevation_A[1, 0], -plant.tilt_A[2, 0]
tilt_A = plant.tilt_A.copy()
tilt_A[2, 0] = 0.0

# Elevation, its rate, its integral; pitch, travel, their rates, travel's integral.
E = gains(plant.elevation_A, plant.elevation_B, 0, [150.0, 8.0, 200.0], 1.0)
T = gains(tilt_A, plant.tilt_B, 1, [30.0, 60.0, 0.4, 10.0, 100.0], 2.0)


@control_law(
    rate_Hz=1000, states={"elevation_rad_s": 0.0, "travel_rad_s": 0.0}, parameters={"hover_V": plant.hover_V}
)
def lqi(now, state, parameter):
    elevation_rad = now.elevation_rad - now.elevation_setpoint_rad
    travel_rad = now.travel_rad - now.travel_setpoint_rad
    collective_V = (
        parameter.hover_V
        + (now.elevation_setpoint_rad_s2 + HANG * now.elevation_setpoint_rad) / plant.elevation_gain
        - E[0] * elevation_rad
        - E[1] * (now.elevation_rad_s - now.elevation_setpoint_rad_s)
        - E[2] * state.elevation_rad_s
    )
    # What tilts the thrust as the setpoint of travel asks, and what the errors of travel ask besides.
    pitch_rad = saturated(
        now.travel_setpoint_rad_s2 / plant.travel_gain
        - T[1] / T[0] * travel_rad
        - T[3] / T[0] * (now.travel_rad_s - now.travel_setpoint_rad_s)
        - T[4] / T[0] * state.travel_rad_s,
        -0.4,
        0.4,
    )
    differential_V = (
        HOLD / plant.pitch_gain * now.pitch_rad + T[0] * (pitch_rad - now.pitch_rad) - T[2] * now.pitch_rad_s
    )
    return Command(
        *motor_volts(collective_V, saturated(differential_V, -1.4, 1.4)),
        states={
            "elevation_rad_s": saturated(state.elevation_rad_s + DT_s * elevation_rad, -0.3, 0.3),
            "travel_rad_s": saturated(state.travel_rad_s + DT_s * travel_rad, -0.3, 0.3),
        },
        pitch_setpoint_rad=pitch_rad,
    )


LAW = lqi
