# %% [markdown]
# # 4. What does my model get wrong?
#
# **Goals.** You measure a model's error with open-loop simulations (free runs). You distinguish noise from structure. You compute the missing
# torque from the model's error.
#
# **Before.** Read [Diagnose](../how-to/diagnosing.md). The cable of this rig pulls travel back like a spring, which the model does not contain.

# %%
from pathlib import Path

import casadi as ca
import heli_host
import matplotlib.pyplot as plt
import numpy as np
from heli_host.data.flight import rate as slope
from heli_sim.model import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig

folder = Path("course/04")  # the files of this notebook
rig = load_rig("makki2024")
SPRING = 0.06  # N m/rad
with heli_host.connect(f"sil://?effect=cable_spring.travel={SPRING}") as heli:
    heli.fly("sine", log=folder / "flight.mcap", overwrite=True)
flight = heli_host.read_flight(folder / "flight.mcap")
flying = flight.between(12.0, 42.0)

# %% [markdown]
# **Task 1.** Free runs: start the model from the measured state, simulate two seconds with the logged voltages alone, and compare with the
# measurement. The initial rates are slopes of the measured angles.

# %%
plant = Plant(MultibodyModel(), rig)
RUN = 2000
step = plant.function.mapaccum("run", RUN)
zeros, numbers = np.zeros((3, RUN)), np.tile(plant.parameters[:, None], RUN)
rates = np.deg2rad(
    np.column_stack([flying.elevation_rate_deg_s, flying.pitch_rate_deg_s, flying.travel_rate_deg_s])
)

# %% tags=["solution"]
# errors_deg: for each start, angles of the model minus measured angles over the run, shape (RUN, 3)
errors_deg = []
for start in range(100, len(flying) - RUN, RUN):
    state = np.concatenate((flying.angles_rad[start], rates[start]))
    _, run = step(state, flying.voltages_V[start : start + RUN].T, zeros, numbers)
    errors_deg.append(np.rad2deg(np.asarray(run).T - flying.angles_rad[start + 1 : start + 1 + RUN]))

# %%
ends_deg = np.array([error_deg[-1] for error_deg in errors_deg])
print(
    "rms error after 2 s [deg], elevation, pitch, travel:", np.round(np.sqrt(np.mean(ends_deg**2, axis=0)), 3)
)

# %% [markdown]
# **Task 2.** Is the error noise? Plot the error of travel after two seconds against travel at the start. Noise would give an unstructured cloud.

# %% tags=["solution"]
# correlation: of travel at the start of a run, and the error of travel at its end
where_rad = np.array([flying.travel_rad[start] for start in range(100, len(flying) - RUN, RUN)])
correlation = np.corrcoef(where_rad, ends_deg[:, 2])[0, 1]
plt.plot(np.rad2deg(where_rad), ends_deg[:, 2], "o")
plt.xlabel("travel [deg]")
plt.ylabel("error of travel after 2 s [deg]")
plt.close()
print(f"correlation {correlation:+.2f}")

# %% [markdown] tags=["solution"]
# The error grows with travel, in proportion: the points are on a line. Noise would not depend on the position. A torque is missing that depends on
# travel.

# %% [markdown]
# **Task 3.** Compute the missing torque:
#
# missing torque = inertia about travel x (measured acceleration - acceleration of the model)
#
# Its slope against travel is the spring constant, with a minus sign. The measured acceleration is a slope over a tenth of a second. Differences
# from row to row would show the encoder's steps, and give only a third of the spring constant.

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

# %% tags=["solution"]
# estimate: spring constant [N m/rad]
inertia = 1.0 / float(pushed(*here)[5] - rate(*here)[5])  # rad/s2 that 1 N m gives
missing_Nm = inertia * (measured - predicted)
estimate = -np.polyfit(flying.travel_rad[every], missing_Nm, 1)[0]
print(f"a spring of {estimate:.3f} N m/rad; hidden was {SPRING}")

# %% [markdown]
# **Task 4.** `diagnose` does the same, tries all alternatives, and gives a standard error (±). This takes a minute.

# %% tags=["long"]
from heli_lab.diagnose import diagnose, summary

with heli_host.connect(f"sil://?effect=cable_spring.travel={SPRING}&seed=2") as heli:
    heli.fly("step", log=folder / "second.mcap", overwrite=True)
second = heli_host.read_flight(folder / "second.mcap")
result = diagnose(MultibodyModel(), rig, [flight.between(12.0, 34.0)], [second])
print(summary(result))
for cause in result.verdict.causes:
    sizes = {
        name: f"{size.value:.3g} ± {size.std:.1g} {size.unit}" for name, size in cause.parameters.items()
    }
    print(cause.effect, f"confidence {cause.confidence:.2f}", sizes, "ambiguous with", cause.ambiguous_with)
assert result.label == "cause_found"
assert [cause.effect for cause in result.verdict.causes] == ["cable_spring.travel"]

# %% [markdown]
# **Check.**

# %% tags=["check"]
assert abs(correlation) > 0.8, "an error that goes with a state is structure, not noise"
assert abs(estimate - SPRING) < 0.015

# %% [markdown]
# **Common mistakes.**
# - You use one-step predictions. Over one millisecond every model is right. Only free runs show a missing effect.
# - You smooth the rates too much. The delay of the filter then looks like physics.
# - You accept the first cause that fits. Fit its rivals too, as task 4 does.

# %% [markdown] tags=["rubric"]
# **Rubric.**
#
# | task | points | full points for |
# |---|---|---|
# | 1 | 3 | each run starts from measured angles and rates, and uses the logged voltages alone |
# | 2 | 2 | figure and correlation; the reason distinguishes structure from noise |
# | 3 | 2 | the inertia by a torque of 1 N m; the spring constant with its sign |
# | Check | 3 | the check passes |
