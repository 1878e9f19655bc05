"""Gain-scheduled LQR: gains for a low, a level and a high arm, interpolated by its elevation."""

import control
import numpy as np
from heli_lab.law import Command, control_law, law_rig, motor_volts, saturated
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import derivatives, trim

rig = law_rig()
model = MultibodyModel()
MIX = np.array([[0.5, 0.5], [0.5, -0.5]])
HEIGHTS_rad = np.radians([-10.0, 0.0, 10.0])
level = trim(model, rig)


def at(elevation_rad):
    """Lift that holds the arm there, and gains of collective and differential."""
    state = np.array(level.state, float)
    state[0] = elevation_rad
    first = derivatives(model, rig, state, level.volts_V)
    A, B = first.A[:6, :6], first.B[:6] @ MIX
    return control.lqr(A, B, np.diag([80.0, 4.0, 12.0, 8.0, 0.4, 12.0]), np.diag([1.0, 4.0]))[0]


K = [at(height_rad) for height_rad in HEIGHTS_rad]
HOVER_V = float(np.sum(level.volts_V)) - 2.0 * rig["dead_zone"].value
STEP_rad = HEIGHTS_rad[1] - HEIGHTS_rad[0]


@control_law(rate_Hz=1000, states={"elevation_V": 0.0}, parameters={"hover_V": HOVER_V})
def gain_scheduled(now, state, parameter):
    place = saturated(now.elevation_rad / STEP_rad, -1.0, 1.0)
    down, up = saturated(-place, 0.0, 1.0), saturated(place, 0.0, 1.0)
    elevation_rad = now.elevation_rad - now.elevation_setpoint_rad
    errors = [
        elevation_rad,
        now.pitch_rad,
        now.travel_rad - now.travel_setpoint_rad,
        now.elevation_rad_s - now.elevation_setpoint_rad_s,
        now.pitch_rad_s,
        now.travel_rad_s - now.travel_setpoint_rad_s,
    ]

    def gain(row, column):
        low, middle, high = (float(at_height[row, column]) for at_height in K)
        return middle + down * (low - middle) + up * (high - middle)

    def wanted(row, columns):
        return -sum(gain(row, column) * errors[column] for column in columns)

    collective_V = parameter.hover_V + wanted(0, (0, 3)) + state.elevation_V
    differential_V = saturated(wanted(1, (1, 2, 4, 5)), -1.4, 1.4)
    integral_V = saturated(state.elevation_V - 6e-3 * elevation_rad, -2.0, 2.0)
    return Command(*motor_volts(collective_V, differential_V), states={"elevation_V": integral_V})


LAW = gain_scheduled
