"""A small MPC: elevation's collective over eight steps, by a fixed number of projected gradient steps."""

import control
import numpy as np
from heli_lab.control.tune import linear_plant
from heli_lab.law import Command, control_law, law_rig, motor_volts, saturated

plant = linear_plant(law_rig())
HORIZON, STEP_s, ITERATIONS = 8, 0.12, 8
A = plant.elevation_A[:2, :2]
B = np.array([[0.0], [plant.elevation_gain]])
model = control.ss(A, B, np.eye(2), 0).sample(STEP_s)
free = np.vstack([np.linalg.matrix_power(model.A, k + 1) for k in range(HORIZON)])
forced = np.zeros((2 * HORIZON, HORIZON))
for row in range(HORIZON):
    for column in range(row + 1):
        block = np.linalg.matrix_power(model.A, row - column) @ model.B
        forced[2 * row : 2 * row + 2, column] = block[:, 0]
Q = np.kron(np.eye(HORIZON), np.diag([60.0, 4.0]))
H = forced.T @ Q @ forced + 1.0 * np.eye(HORIZON)
G = forced.T @ Q @ free
RATE = 1.0 / np.linalg.eigvalsh(H).max()
LOW_V, HIGH_V = -1.2, 1.5
TILT = control.lqr(plant.tilt_A[:4, :4], plant.tilt_A[:4, 4:] * (-plant.tilt_B[4] / plant.tilt_A[4, 4]),
                   np.diag([4.0, 12.0, 0.4, 12.0]), [[4.0]])[0][0]  # fmt: skip
PLAN = [f"u{k}" for k in range(HORIZON)]


@control_law(rate_Hz=100, states=dict.fromkeys([*PLAN, "trim_V"], 0.0), parameters={"hover_V": plant.hover_V})
def mpc(now, state, parameter):
    error = [
        now.elevation_rad - now.elevation_setpoint_rad,
        now.elevation_rad_s - now.elevation_setpoint_rad_s,
    ]
    pull = [float(row[0]) * error[0] + float(row[1]) * error[1] for row in G]
    plan_V = [getattr(state, name) for name in PLAN]
    for _ in range(ITERATIONS):
        slope = [
            sum(float(h) * u for h, u in zip(row, plan_V, strict=True)) + g
            for row, g in zip(H, pull, strict=True)
        ]
        plan_V = [saturated(u - RATE * s, LOW_V, HIGH_V) for u, s in zip(plan_V, slope, strict=True)]
    tilt = [now.pitch_rad, now.travel_rad - now.travel_setpoint_rad, now.pitch_rad_s,
            now.travel_rad_s - now.travel_setpoint_rad_s]  # fmt: skip
    differential_V = saturated(-sum(float(k) * x for k, x in zip(TILT, tilt, strict=True)), -1.4, 1.4)
    trim_V = saturated(state.trim_V - 0.06 * error[0], -2.0, 2.0)
    return Command(
        *motor_volts(parameter.hover_V + state.trim_V + plan_V[0], differential_V),
        states={**dict(zip(PLAN, plan_V, strict=True)), "trim_V": trim_V},
        signals={"planned_V": plan_V[0]},
    )


LAW = mpc
