# %% [markdown]
# # 1. Fly and look
#
# **Goals.** You can fly the helicopter from Python, read a flight as arrays, and measure how well it followed its setpoints.
#
# **Before.** Read the beginning of [From Python](../how-to/python.md). The rig has three axes: *elevation* of the long arm, *pitch* of the
# short arm, and *travel* about the vertical. Its two inputs are the motor voltages.

# %%
import heli_host
import matplotlib.pyplot as plt
import numpy as np

with heli_host.connect("sil://") as heli:
    print(heli)
    heli.take_off()
    heli.wait(3.0)
    begin = heli.latest.t_s
    heli.setpoint(travel_deg=20.0)
    heli.wait(12.0)
    flown = heli.samples(last_s=heli.latest.t_s - begin)
t_s = flown.t_s - flown.t_s[0]
flown  # in a notebook this line draws the flight

# %% [markdown]
# **Task 1.** The setpoint of travel grows. Which way does pitch go first, and why? Look at the figure, then at the sign.

# %% tags=["solution"]
# first: pitch between 0.5 s and 2 s [deg]
first = flown.pitch_deg[(t_s > 0.5) & (t_s < 2.0)]
print(f"pitch between 0.5 and 2 s: {first.mean():+.1f} degrees")

# %% [markdown] tags=["solution"]
# Positive pitch tilts the thrust, and the tilted thrust accelerates travel in the positive direction. The board therefore
# pitches positive first, and negative before the setpoint is reached, to brake.

# %% [markdown]
# **Task 2.** Measure overshoot, settling time to 1 degree, and the rms error of the last four seconds.

# %% tags=["solution"]
# overshoot_deg [deg], settling_s [s], rms_deg [deg]
target_deg = 20.0
travel = flown.travel_deg
overshoot_deg = travel.max() - target_deg
outside = np.flatnonzero(np.abs(travel - target_deg) > 1.0)
settling_s = t_s[outside[-1]]
rms_deg = np.sqrt(np.mean((travel[t_s > t_s[-1] - 4.0] - target_deg) ** 2))
print(f"overshoot {overshoot_deg:.1f} deg, settled after {settling_s:.1f} s, rms {rms_deg:.2f} deg")

# %% [markdown]
# **Task 3.** How does a motion of travel affect elevation? Tilted thrust lifts less. By how much did the arm sink, and how did the voltages
# change?

# %% tags=["solution"]
# sink_deg: lowest elevation [deg]
table = flown.dataframe()
sink_deg = table["elevation_deg"].min()
lift_V = (table["front_V"] + table["back_V"]) / 2
print(
    f"elevation was down to {sink_deg:.2f} deg; mean voltage {lift_V.iloc[:200].mean():.2f} to {lift_V.max():.2f} V"
)
axes = table[["elevation_deg", "pitch_deg", "travel_deg"]].plot(subplots=True, sharex=True)
plt.close()

# %% [markdown] tags=["solution"]
# Only the vertical part of the thrust lifts. The arm sinks by less than a degree, because the elevation loop raises the mean voltage.

# %% [markdown]
# **Check.**

# %% tags=["check"]
assert first.mean() > 2.0, "positive pitch accelerates travel positive"
assert 0.0 < overshoot_deg < 5.0 and 2.0 < settling_s < 11.0 and rms_deg < 1.0
assert -2.0 < sink_deg < 0.5

# %% [markdown]
# **Common mistakes.**
# - You mix radians and degrees. A log stores `travel_rad`; `travel_deg` is the same angle in degrees. Setpoints are in degrees.
# - You call `heli.samples()` without `last_s`. The samples then include the take-off and its overshoot.
# - You use `time.sleep` instead of `heli.wait`. Simulated time passes only while the program waits for the board.

# %% [markdown] tags=["rubric"]
# **Rubric.**
#
# | task | points | full points for |
# |---|---|---|
# | 1 | 2 | the mean pitch with its sign; the reason names the tilted thrust |
# | 2 | 3 | overshoot, settling time and RMS error, one point each; samples after the take-off only |
# | 3 | 2 | the lowest elevation; the reason names the vertical part of the thrust and the elevation loop |
# | Check | 3 | the check passes |
