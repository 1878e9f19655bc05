"""LQG: LQR on the state of an observer that sees angles only, and no rate filter of the board."""

import control
import numpy as np
from heli_lab.control.tune import linear_plant
from heli_lab.law import Command, control_law, law_rig, motor_volts, saturated
from heli_sim.rig.rig import count_rad

DT_s = 2e-3
rig = law_rig()
plant = linear_plant(rig, lag_s=0.05)


def observer(A, B, measured, counts_rad, disturbed, Q, R):
    """Discrete model and Kalman gain; a constant torque on the axis `disturbed` is a state of it."""
    size = len(A)
    wide = np.zeros((size + 1, size + 1))
    wide[:size, :size], wide[disturbed, size] = A, 1.0
    C = np.eye(size + 1)[measured]
    discrete = control.ss(wide, np.append(B, 0.0)[:, None], C, 0).sample(DT_s)
    noise = np.diag([*np.full(size, 1e-9), 1e-8])
    noise[disturbed, disturbed] = 1e-6
    L = control.dlqe(discrete.A, np.eye(size + 1), C, noise, np.diag(np.square(counts_rad) / 12))[0]
    K = control.lqr(A, B[:, None], np.diag(Q), [[R]])[0][0]
    return discrete.A, discrete.B[:, 0], np.atleast_2d(L), K


# Elevation, rate, thrust, torque; pitch, travel, their rates, thrust, torque.
COUNTS_rad = count_rad(rig)
AE, BE, LE, KE = observer(plant.elevation_A, plant.elevation_B, [0], COUNTS_rad[:1], 1, [80.0, 8.0, 0.0], 1.0)
AT, BT, LT, KT = observer(
    plant.tilt_A, plant.tilt_B, [0, 1], COUNTS_rad[1:], 3, [4.0, 12.0, 0.4, 12.0, 0.0], 4.0
)
ELEVATION = ["e0", "e1", "e2", "e3"]
TILT = ["t0", "t1", "t2", "t3", "t4", "t5"]


def dot(row, values):
    return sum(float(k) * x for k, x in zip(row, values, strict=True) if k != 0.0)


@control_law(rate_Hz=500, states=dict.fromkeys([*ELEVATION, *TILT, "collective_V", "differential_V"], 0.0))
def lqg(now, state, parameter):
    e, t = [getattr(state, name) for name in ELEVATION], [getattr(state, name) for name in TILT]
    # What is seen now corrects what was foreseen.
    gap_rad = now.elevation_rad - e[0]
    e = [x + float(g[0]) * gap_rad for x, g in zip(e, LE, strict=True)]
    gaps_rad = [now.pitch_rad - t[0], now.travel_rad - t[1]]
    t = [x + dot(g, gaps_rad) for x, g in zip(t, LT, strict=True)]
    error = [e[0] - now.elevation_setpoint_rad, e[1] - now.elevation_setpoint_rad_s, e[2]]
    # The torque that it sees is taken back.
    collective_V = saturated(-dot(KE, error) - e[3] / plant.elevation_gain, -2.0, 3.0)
    error = [
        t[0] + t[5] / plant.travel_gain,
        t[1] - now.travel_setpoint_rad,
        t[2],
        t[3] - now.travel_setpoint_rad_s,
        t[4],
    ]
    differential_V = saturated(-dot(KT, error), -1.4, 1.4)
    foreseen_e = [dot(row, e) + float(b) * collective_V for row, b in zip(AE, BE, strict=True)]
    foreseen_t = [dot(row, t) + float(b) * differential_V for row, b in zip(AT, BT, strict=True)]
    return Command(
        *motor_volts(plant.hover_V + collective_V, differential_V),
        states=dict(zip([*ELEVATION, *TILT], [*foreseen_e, *foreseen_t], strict=True)),
        signals={"torque_elevation": e[3], "torque_travel": t[5]},
    )


LAW = lqg
