# %% [markdown]
# # 5. Hide an effect for your neighbour to find
#
# **Goals.** You make a blind experiment: the truth is sealed before the analysis, the data tell nothing by the way, and the judgement
# is fixed beforehand.
#
# **Before.** [effects.md](../reference/effects.md) lists what can be hidden.

# %%
import hashlib
import secrets
from pathlib import Path

import heli_host
import numpy as np
from heli_host.flight import Flight
from heli_host.log.table import write_csv
from heli_lab.diagnose import diagnose, summary
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

folder = Path("course/05")  # the files of this notebook

# %% [markdown]
# **Task 1, you.** Choose an effect and a size. Seal it: the digest goes to the neighbour now, effect and salt when it is over. The salt
# keeps the neighbour from trying all effects against the digest.

# %%
SECRET = "rotor_lag=0.1"
parse_effects([SECRET])  # a name that there is
salt = secrets.token_hex(16)
sealed = hashlib.sha256(f"{SECRET}:{salt}".encode()).hexdigest()
print("sealed:", sealed)

# %% [markdown]
# **Task 2, you.** Fly it, twice. Hand over six columns and nothing else: a log says which rig and which board it was.

# %%
for name, plan, seed in (("a", "identify", 1), ("b", "step", 2)):
    with heli_host.connect(f"sil://?effect={SECRET}&seed={seed}") as heli:
        heli.fly(plan, log=folder / f"{name}.mcap", overwrite=True)
    whole = heli_host.read_flight(folder / f"{name}.mcap").between(3.0, 33.0)
    bare = Flight(
        whole.t_s, whole.front_V, whole.back_V, whole.elevation_rad, whole.pitch_rad, whole.travel_rad
    )
    write_csv(bare, folder / f"{name}.csv")
handed_over = (folder / "a.csv").read_text() + (folder / "b.csv").read_text()

# %% [markdown]
# **Task 3, your neighbour.** Look before you compute: which axis is off, and does it lag or lean? Then diagnose. Write the answer down
# with its confidence, *before* the seal is opened.

# %%
given = [heli_host.read_flight(folder / f"{name}.csv") for name in "ab"]
for flight in given:
    print(flight, f"pitch moves {np.ptp(flight.pitch_deg):.0f} deg")

# %% tags=["long"]
result = diagnose(MultibodyModel(), load_rig("makki2024"), given[:1], given[1:])
answer = [cause.effect for cause in result.verdict.causes]
print(summary(result))
assert answer == ["rotor_lag"]

# %% [markdown]
# **Task 4, both.** Open the seal, and judge by what was agreed: right name, one point; size within 10 %, another; *unexplained* where
# something was hidden, none; a wrong name, one less.


# %%
def opened(effect, salt, seal):
    """Whether this is what was sealed."""
    return hashlib.sha256(f"{effect}:{salt}".encode()).hexdigest() == seal


print("the seal holds:", opened(SECRET, salt, sealed))

# %% [markdown]
# **Check.**

# %%
assert opened(SECRET, salt, sealed) and not opened("rotor_lag=0.2", salt, sealed)
assert not any(word in handed_over for word in (*catalogue(), "makki", "rig", "sil"))
assert handed_over.splitlines()[0] == "t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad"

# %% [markdown]
# **Common mistakes.**
# - Handing over the log: its metadata hold the address of the simulated board, effect included. On the command line,
#   `heli-host fly --sil --blind` and `heli-host export --blind` leave it out and seal it.
# - An effect too small to see: `heli-host diagnose` lists what a flight could not have shown. That is not the neighbour's fault.
# - Changing the rule of judgement after the seal is open.
