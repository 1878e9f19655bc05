# %% [markdown]
# # 3. A PID and an LQR, compared
#
# **Goals.** You design two controllers from one linear model: a PD controller, and an LQR (linear-quadratic regulator). You compute their
# stability margins before they fly, and compare the result with the board's PID cascade in flight.
#
# **Before.** Read [Tune](../how-to/tuning.md) and [Controllers](../how-to/controllers.md).

# %%
import control
import heli_host
import heli_lab
import numpy as np
from heli_lab.control.tune import linear_plant
from heli_lab.law import from_gain
from heli_sim.rig import load_rig

rig = load_rig("makki2024")
plant = heli_lab.linearise(rig)
print(plant.state_labels, np.round(control.poles(plant), 2))

# %% [markdown]
# **Task 1.** Design a PD controller for elevation by hand. Choose a damping of 0.8 and a natural frequency of 2 rad/s. Both rotors lift. The
# code below therefore uses the sum of B's two columns, divided by two.

# %%
A = plant.A[np.ix_([0, 3], [0, 3])]
B = plant.B[[0, 3]].sum(axis=1, keepdims=True) / 2.0

# %% tags=["solution"]
# kp [V/rad], kd [V s/rad]; closed: matrix of the closed loop
omega, damping = 2.0, 0.8
kp = (omega**2 + A[1, 0]) / B[1, 0]
kd = (2.0 * damping * omega + A[1, 1]) / B[1, 0]
closed = A - B @ np.array([[kp, kd]])
print(f"kp {kp:.2f} V/rad, kd {kd:.2f} V s/rad, poles {np.round(np.linalg.eigvals(closed), 2)}")

# %% [markdown]
# **Task 2.** Design an LQR for pitch and travel. The difference of the voltages moves pitch, and pitch moves travel.

# %%
tilt = [1, 2, 4, 5]
A_tilt = plant.A[np.ix_(tilt, tilt)]
B_tilt = (plant.B[tilt, :1] - plant.B[tilt, 1:]) / 2.0

# %% tags=["solution"]
# K_tilt: gains (1, 4); poles: of the closed loop
K_tilt, _, poles = control.lqr(A_tilt, B_tilt, np.diag([4.0, 12.0, 0.4, 12.0]), [[4.0]])
print(np.round(K_tilt, 2), np.round(poles, 2))


# %% [markdown]
# **Task 3.** How much additional gain and delay does each loop tolerate? Cut the loop at its input.


# %% tags=["solution"]
# margins(A, B, K): gain margin, phase margin [deg] and delay margin [s]; print them for both loops
def margins(A, B, K):
    """Gain margin up, phase margin [deg] and delay margin [s] of a loop cut at its input."""
    loop = control.ss(A, B, K, 0)
    gain, phase, _, _, crossover, _ = control.stability_margins(loop)[:6]
    return gain, phase, np.deg2rad(phase) / crossover if crossover else np.inf


for name, loop in {
    "elevation": (A, B, np.array([[kp, kd]])),
    "pitch and travel": (A_tilt, B_tilt, K_tilt),
}.items():
    gain, phase, delay_s = margins(*loop)
    print(f"{name}: gain {gain:.1f}, phase {phase:.0f} deg, delay {1e3 * delay_s:.0f} ms")

# %% [markdown] tags=["solution"]
# An LQR tolerates any larger gain at its input, and has a phase margin of at least 60 degrees. Its delay margin is the phase margin divided by
# the crossover frequency. The lag of the rotors uses a part of it.

# %% [markdown]
# **Task 4.** Fly your controller as one gain matrix on the board at 1 kHz. Fly the board's own PID cascade for comparison.

# %% tags=["solution"]
# law: your gains as one law, by from_gain
K = np.zeros((2, 6))
K[0, [0, 3]] = kp, kd
K[1, tilt] = K_tilt[0]
law = from_gain(K, hover_V=linear_plant(rig).hover_V, name="mine")

# %%
rms_deg = {}
for name in ("cascade", "mine"):
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        heli.wait(2.0)
        heli.setpoint(elevation_deg=5.0, travel_deg=20.0)
        if name == "mine":
            print(heli.fly_law(law.program, duration_s=12.0))
        else:
            heli.wait(12.0)
        flown = heli.samples(last_s=4.0)
        rms_deg[name] = float(
            np.sqrt(np.mean((flown.travel_deg - 20.0) ** 2 + (flown.elevation_deg - 5.0) ** 2))
        )
print(rms_deg)

# %% [markdown]
# **Check.**

# %% tags=["check"]
assert np.allclose(sorted(np.abs(np.linalg.eigvals(closed))), [2.0, 2.0], atol=0.05)
assert (poles.real < 0.0).all() and margins(A_tilt, B_tilt, K_tilt)[1] > 55.0, (
    "an LQR has 60 degrees at its input"
)
assert rms_deg["mine"] < 4.0 and rms_deg["cascade"] < 1.5

# %% [markdown]
# **Common mistakes.**
# - You apply `K` to angles in degrees. All angles inside are in radians.
# - Your controller has no integral term, so that gravity causes a constant error. In which axis is the error of `mine` larger, and how would you
#   remove it?
# - You compute the margins without the rotors' lag. Try `heli_lab.linearise(rig, effects=["rotor_lag=0.1"])`.

# %% [markdown] tags=["rubric"]
# **Rubric.**
#
# | task | points | full points for |
# |---|---|---|
# | 1 | 2 | both gains follow from damping and natural frequency, with the unstable or stiff term of A |
# | 2 | 2 | weights with a reason; all poles are stable |
# | 3 | 2 | the loop is cut at its input; gain, phase and delay for both loops |
# | 4 | 1 | one gain matrix with each gain in its place |
# | Check | 3 | the check passes |
