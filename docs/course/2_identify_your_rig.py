# %% [markdown]
# # 2. Identify your rig
#
# **Goals.** You get a rig's numbers from a flight, each with a standard error, and know which numbers that flight cannot tell.
#
# **Before.** [identifying.md](../how-to/identifying.md). The rig of this notebook has stronger rotors and more friction about travel
# than its file says; on a real rig skip the first cell and give the port.

# %%
from pathlib import Path

import heli_host
import numpy as np
from heli_lab.identify.run import identify
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
# **Task 1.** Fit 18 s of it. Which numbers moved, and by how many of their *prior* standard deviations?

# %%
found = identify(MultibodyModel(), believed, [flight], stop_s=22.0)
mine = found.rig("mine")
for name, number in mine.items():
    prior = believed[name]
    if prior.tolerance and abs(number.value - prior.value) > 0.5 * prior.tolerance:
        moved = 2.0 * (number.value - prior.value) / prior.tolerance
        print(
            f"{name}: {prior.value:g} -> {number.value:.4g} (tolerance {number.tolerance:.2g}) {number.unit}, {moved:+.1f} sigma"
        )

# %% [markdown]
# **Task 2.** A flight tells combinations: thrust over mass, mass times length. Which numbers did this one not inform?

# %%
print(found.uninformed_parameters)

# %% [markdown]
# **Task 3.** Fit the hover before the sines alone (3 s) and compare the standard error of `friction_travel`. Why is a hover so
# much poorer?

# %%
hover = identify(MultibodyModel(), believed, [flight.between(3.0, 7.0)])
ratio = hover.rig("hover")["friction_travel"].tolerance / mine["friction_travel"].tolerance
print(f"from the hover it is {ratio:.0f} times less certain")

# %% [markdown]
# **Check.**

# %%
for name, truth in {"thrust_gain": 0.63, "friction_travel": 0.055}.items():
    number = mine[name]
    # Two standard errors hold the truth in 95 of 100 flights; three in 997 of 1000.
    assert abs(number.value - truth) < 1.5 * number.tolerance, (name, number)
assert ratio > 3.0
assert np.isclose(mine["M_h"].value, believed["M_h"].value, rtol=0.05), "a prior holds what no flight tells"

# %% [markdown]
# **Common mistakes.**
# - Reading a value without its standard error. A number whose error is as wide as its prior was not measured.
# - Fitting take-off and landing: the table is not in the model. `start_s` and `stop_s` cut.
# - Judging the fit on the flight that was fitted: fly a second one and give it as `validation`.
