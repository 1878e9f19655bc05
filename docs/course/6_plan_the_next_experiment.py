# %% [markdown]
# # 6. Plan the next experiment
#
# **Goals.** You predict how precisely a flight determines the parameters *before* you fly it. You use sensitivities, the Fisher information and
# expected standard errors. Then you choose the most informative flight.
#
# **Before.** Do notebook 2. A parameter is visible if the angles change with it by more than the encoders' step of 0.088 degrees.
#
# The sensitivities J are the derivatives of all angles by the parameters. With a measurement noise of standard deviation s, the Fisher information is J'J / s².
# The square roots of the diagonal of its inverse are the expected standard errors.

# %%
import numpy as np
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import trim
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.rig.rig import count_rad

rig = load_rig("makki2024")
names = ("thrust_gain", "friction_pitch", "friction_travel")
hover_V = trim(MultibodyModel(), rig).volts_V
NOISE_RAD = count_rad(rig).max() / np.sqrt(12.0)  # the three encoders of this rig are alike
TICKS = 8_000
t_s = np.arange(TICKS) * 1e-3
# One compiled millisecond, eight thousand times; numbers of the rig are arguments.
step = Plant(MultibodyModel(), rig).function.mapaccum("flight", TICKS)


def angles_rad(rig, volts_V):
    """Fly voltages, shape (TICKS, 2), from level: angles, shape (TICKS, 3)."""
    numbers = Plant(MultibodyModel(), rig).parameters
    _, measured = step(np.zeros(6), volts_V.T, np.zeros((3, TICKS)), np.tile(numbers[:, None], TICKS))
    return np.asarray(measured).T


def expected_errors(volts_V):
    """Standard errors that a flight with these voltages would leave, as shares of the values."""
    columns = []
    for name in names:
        value = rig[name].value
        up, down = (rig.replace(**{name: value * factor}) for factor in (1.001, 0.999))
        columns.append((angles_rad(up, volts_V) - angles_rad(down, volts_V)).ravel() / 0.002)
    # Counts that stay the same for a second are not a thousand samples: 20 of them count as one.
    J = np.column_stack(columns)
    errors = np.full(len(names), np.inf)
    moves = np.linalg.norm(J, axis=0) > 1e-6  # a parameter that moves no angle cannot be estimated
    information = J[:, moves].T @ J[:, moves] / (20.0 * NOISE_RAD**2)
    errors[moves] = np.sqrt(np.diag(np.linalg.inv(information)))
    return errors


# %% [markdown]
# **Task 1.** Compare three flights of 8 s. The first is slow. The second strongly excites both rotors together. The third also excites their
# difference. Guess first: which parameters does each flight determine?

# %% tags=["solution"]
# flights: voltages (TICKS, 2) of "slow", "together" and "apart"; expected: their errors by name
slow = 0.02 * np.sin(2.0 * np.pi * 0.1 * t_s)
together = 0.15 * np.sin(2.0 * np.pi * 0.4 * t_s)
apart = 0.15 * np.sin(2.0 * np.pi * 0.25 * t_s) + 0.1 * np.sin(2.0 * np.pi * 0.55 * t_s)
flights = {
    "slow": hover_V + np.column_stack((slow, slow)),
    "together": hover_V + np.column_stack((together, together)),
    "apart": hover_V + np.column_stack((together + apart, together - apart)),
}
expected = {}
for name, volts_V in flights.items():
    expected[name] = expected_errors(volts_V)
    print(name, dict(zip(names, np.round(100.0 * expected[name], 4).tolist(), strict=True)), "%")

# %% [markdown] tags=["solution"]
# Rotors that act alike move neither pitch nor travel. Both frictions remain unknown in the first two flights. The third determines all three
# parameters.

# %% [markdown]
# **Task 2.** Is it better to fly twice as long, or with twice the amplitude? Information grows with the length, and with the *square* of the
# amplitude. Why does the error of `thrust_gain` hardly change?

# %% tags=["solution"]
# gain: expected errors at half the amplitude, divided by those of "apart"
half = hover_V + 0.5 * (flights["apart"] - hover_V)
gain = expected_errors(half) / expected["apart"]
print("half the amplitude costs in error:", np.round(gain, 2))

# %% [markdown] tags=["solution"]
# With twice the amplitude, the information becomes four times as large; with twice the length, only twice as large. The hover alone determines
# `thrust_gain`, whatever the amplitude.

# %% [markdown]
# **Task 3.** Where must you stop? In the linear theory, more amplitude is always better. Stops, the table and the rotors' dead zone limit it. Look
# how far the third flight goes.

# %% tags=["solution"]
# reach_deg: largest elevation, pitch and travel of "apart" [deg]
reach_deg = np.rad2deg(np.abs(angles_rad(rig, flights["apart"])).max(axis=0))
print("elevation, pitch and travel go to [deg]:", np.round(reach_deg, 1))

# %% [markdown]
# **Check.**

# %% tags=["check"]
assert np.isinf(expected["together"][1:]).all(), "both rotors alike pitch nothing, and nothing travels"
assert np.isfinite(expected["apart"]).all()
assert gain[0] < gain[1] and 1.5 < gain[1] < 3.0
assert reach_deg[0] < rig["elevation_max"].value and reach_deg[1] < rig["pitch_max"].value

# %% [markdown]
# **Common mistakes.**
# - You excite one axis and fit all axes. An axis that does not move is not measured.
# - You optimise the flight for the model that you believe. If a rival model is possible, plan the flight that distinguishes them
#   (`next_flight` of [Diagnose](../how-to/diagnosing.md)).
# - You forget the priors. A parameter that you know to 1 % beforehand needs no flight.

# %% [markdown] tags=["rubric"]
# **Rubric.**
#
# | task | points | full points for |
# |---|---|---|
# | 1 | 3 | three flights of the right kind; a guess before the numbers |
# | 2 | 2 | the ratio of errors; the reason names the square of the amplitude |
# | 3 | 2 | the angles, compared with the limits of the rig |
# | Check | 3 | the check passes |
