# %% [markdown]
# # 2. Identify your rig
#
# **Goals.** You estimate rig parameters from a flight, each with a standard error. You know which parameters the flight does not determine.
#
# **Before.** Read [Identify](../how-to/identifying.md). The rig of this notebook has stronger rotors and more friction about travel
# than its file states. On a real rig, skip the first cell and give the port.

# %%
from pathlib import Path

import heli_host
import numpy as np
from heli_lab.fit import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig, write_rig

folder = Path("course/02")  # the files of this notebook
folder.mkdir(parents=True, exist_ok=True)
believed = load_rig("makki2024")
write_rig(believed.replace(thrust_gain=0.63, friction_travel=0.055), folder / "hidden.toml")

# %%
with heli_host.connect(f"sil://?rig={folder}/hidden.toml") as heli:
    print(heli.fly("identify", log=folder / "flight.mcap", overwrite=True).outcome)
flight = heli_host.read_flight(folder / "flight.mcap")
flight

# %% [markdown]
# **Task 1.** Fit 18 s of the flight. Which parameters changed, and by how many of their *prior* standard deviations? The prior is what you
# know before the flight: the tolerance in the rig file is two standard deviations.

# %% tags=["solution"]
# result: of the fit; mine: its rig; print the parameters that moved
result = identify(MultibodyModel(), believed, [flight], stop_s=22.0)
mine = result.rig("mine")
for name, number in mine.items():
    prior = believed[name]
    if prior.tolerance and abs(number.value - prior.value) > 0.5 * prior.tolerance:
        moved = 2.0 * (number.value - prior.value) / prior.tolerance
        print(
            f"{name}: {prior.value:g} -> {number.value:.4g} (tolerance {number.tolerance:.2g}) {number.unit}, {moved:+.1f} sigma"
        )

# %% [markdown] tags=["solution"]
# `friction_travel` moved by more than one prior standard deviation. `thrust_gain` moved by less, but by many of its new standard errors: the
# flight determines it far better than the rig file.

# %% [markdown]
# **Task 2.** A flight determines combinations of parameters, such as thrust over mass, or mass times length. Which parameters did this flight not
# determine?

# %% tags=["solution"]
# print the parameters without information
print(result.uninformed_parameters)

# %% [markdown] tags=["solution"]
# The angles depend on ratios only: a larger mass with a larger thrust gives the same flight. The priors keep such parameters at their values.

# %% [markdown]
# **Task 3.** Fit only the hover before the sines (3 s), and compare the standard error of `friction_travel`. Why does a hover contain so
# much less information?

# %% tags=["solution"]
# ratio: standard error of friction_travel in the hover, divided by that of task 1
hover = identify(MultibodyModel(), believed, [flight.between(3.0, 7.0)])
ratio = hover.rig("hover")["friction_travel"].tolerance / mine["friction_travel"].tolerance
print(f"from the hover it is {ratio:.0f} times less certain")

# %% [markdown] tags=["solution"]
# Friction acts on the rate of travel, which is nearly zero in a hover. The voltages hardly vary, so that no parameter changes the angles by
# more than the encoder's step.

# %% [markdown]
# **Check.**

# %% tags=["check"]
for name, truth in {"thrust_gain": 0.63, "friction_travel": 0.055}.items():
    number = mine[name]
    # Two standard errors hold the truth in 95 of 100 flights; three in 997 of 1000.
    assert abs(number.value - truth) < 1.5 * number.tolerance, (name, number)
assert ratio > 3.0
assert np.isclose(mine["M_h"].value, believed["M_h"].value, rtol=0.05), (
    "the prior determines what no flight shows"
)

# %% [markdown]
# **Common mistakes.**
# - You read a value without its standard error. If the error is as large as its prior, the flight did not measure the parameter.
# - You fit take-off and landing. The model does not contain the table. Cut the flight with `start_s` and `stop_s`.
# - You judge the fit on the fitted flight. Fly a second one, and pass it as `validation`.

# %% [markdown] tags=["rubric"]
# **Rubric.**
#
# | task | points | full points for |
# |---|---|---|
# | 1 | 3 | a fit without take-off and landing; each move in prior standard deviations, and compared with the new standard error |
# | 2 | 2 | the list, and a combination of parameters that explains it |
# | 3 | 2 | the ratio; the reason names the rate of travel or the lack of excitation |
# | Check | 3 | the check passes |
