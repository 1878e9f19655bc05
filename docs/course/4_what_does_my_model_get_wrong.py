# %% [markdown]
# # 4. What does my model get wrong?
#
# **Goals.** You see a model's error where it counts (free runs), tell noise from structure, and get from a residual to the torque that
# is missing.
#
# **Before.** [diagnosing.md](../how-to/diagnosing.md). This rig's cable pulls travel back to where it was laid: a spring that no model has.

# %%
from pathlib import Path

import casadi as ca
import heli_host
import matplotlib.pyplot as plt
import numpy as np
from heli_host.views import rate as slope
from heli_sim.model import MultibodyModel
from heli_sim.plant import Plant
from heli_sim.rig import load_rig

folder = Path("course/04")  # the files of this notebook
rig = load_rig("makki2024")
SPRING = 0.06  # N m/rad
with heli_host.connect(f"sil://?effect=cable_spring.travel={SPRING}") as heli:
    heli.fly("sine", log=folder / "flight.mcap", overwrite=True)
flight = heli_host.read_flight(folder / "flight.mcap")
flying = flight.between(12.0, 42.0)

# %% [markdown]
# **Task 1.** Free runs: start the model from the measured state, give it the voltages alone for two seconds, and compare. The state's
# rates are slopes of the measured angles.

# %%
plant = Plant(MultibodyModel(), rig)
RUN = 2000
step = plant.function.mapaccum("run", RUN)
zeros, numbers = np.zeros((3, RUN)), np.tile(plant.parameters[:, None], RUN)
rates = np.deg2rad(
    np.column_stack([flying.elevation_rate_deg_s, flying.pitch_rate_deg_s, flying.travel_rate_deg_s])
)
errors_deg = []
for start in range(100, len(flying) - RUN, RUN):
    state = np.concatenate((flying.angles_rad[start], rates[start]))
    _, run = step(state, flying.voltages_V[start : start + RUN].T, zeros, numbers)
    errors_deg.append(np.rad2deg(np.asarray(run).T - flying.angles_rad[start + 1 : start + 1 + RUN]))
ends_deg = np.array([one[-1] for one in errors_deg])
print(
    "rms error after 2 s [deg], elevation, pitch, travel:", np.round(np.sqrt(np.mean(ends_deg**2, axis=0)), 3)
)

# %% [markdown]
# **Task 2.** Is it noise? Draw the error of travel after two seconds against where travel was. Noise would be a cloud.

# %%
where_rad = np.array([flying.travel_rad[start] for start in range(100, len(flying) - RUN, RUN)])
correlation = np.corrcoef(where_rad, ends_deg[:, 2])[0, 1]
plt.plot(np.rad2deg(where_rad), ends_deg[:, 2], "o")
plt.xlabel("travel [deg]")
plt.ylabel("error of travel after 2 s [deg]")
plt.close()
print(f"correlation {correlation:+.2f}")

# %% [markdown]
# **Task 3.** The torque that is missing: acceleration measured less acceleration by the model, times the inertia about travel. Its slope
# against travel is the spring. The acceleration is again a slope over a tenth of a second: differences from row to row would show the
# encoder's steps, and a spring of a third of its size.

# %%
model = plant.model
x, u = ca.SX.sym("x", 6), ca.SX.sym("u", 2)
p = model.parameter_values(rig)
rate = ca.Function("rate", [x, u], [model.dynamics(x, u, ca.SX(p))])
every = slice(200, -200, 20)
states = np.column_stack((flying.angles_rad, rates))[every]
predicted = np.asarray(rate.map(len(states))(states.T, flying.voltages_V[every].T)).T[:, 5]
measured = slope(flying.t_s, rates[:, 2])[every]
pushed_p = ca.SX(model.parameter_values(rig.replace(torque_travel=1.0)))
pushed = ca.Function("pushed", [x, u], [model.dynamics(x, u, pushed_p)])
here = states[0], flying.voltages_V[0]
inertia = 1.0 / float(pushed(*here)[5] - rate(*here)[5])  # rad/s2 that 1 N m gives
missing_Nm = inertia * (measured - predicted)
estimate = -np.polyfit(flying.travel_rad[every], missing_Nm, 1)[0]
print(f"a spring of {estimate:.3f} N m/rad; hidden was {SPRING}")

# %% [markdown]
# **Task 4.** Now let the machine do it, with an interval and all alternatives tried. This takes a minute.

# %% tags=["long"]
from heli_lab.diagnose import diagnose, summary

with heli_host.connect(f"sil://?effect=cable_spring.travel={SPRING}&seed=2") as heli:
    heli.fly("step", log=folder / "second.mcap", overwrite=True)
second = heli_host.read_flight(folder / "second.mcap")
result = diagnose(MultibodyModel(), rig, [flight.between(12.0, 34.0)], [second])
print(summary(result))
for cause in result.verdict.causes:
    sizes = {name: f"{one.value:.3g} ± {one.std:.1g} {one.unit}" for name, one in cause.parameters.items()}
    print(cause.effect, f"confidence {cause.confidence:.2f}", sizes, "ambiguous with", cause.ambiguous_with)
assert [cause.effect for cause in result.verdict.causes] == ["cable_spring.travel"]

# %% [markdown]
# **Check.**

# %%
assert abs(correlation) > 0.8, "an error that goes with a state is structure, not noise"
assert abs(estimate - SPRING) < 0.015

# %% [markdown]
# **Common mistakes.**
# - One-step prediction: over a millisecond every model is right. Only free runs show what is missing.
# - Smoothing the rates so much that the delay looks like physics.
# - Naming the first cause that fits: fit its rivals too. That is what task 4 does.
