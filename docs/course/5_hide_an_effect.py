# %% [markdown]
# # 5. Hide an effect for your neighbour to find
#
# **Goals.** You run a blind experiment: you seal the truth, hand over data that do not reveal it, and judge the answer by a rule that was
# agreed beforehand.
#
# **Before.** Choose an effect from [Effects](../reference/effects.md).

# %%
import hashlib
import secrets
from pathlib import Path

import heli_host
import numpy as np
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_lab.diagnose import diagnose, summary
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

folder = Path("course/05")  # the files of this notebook

# %% [markdown]
# **Task 1, you.** Choose an effect and a size, and seal them. Give your neighbour the digest now, and the effect and the salt at the end. The
# salt prevents your neighbour from trying all effects against the digest.

# %% tags=["solution"]
# SECRET: effect and size, such as "rotor_lag=0.1"; salt: random text; sealed: SHA-256 of both, joined by a colon
SECRET = "rotor_lag=0.1"
parse_effects([SECRET])  # the name is valid
salt = secrets.token_hex(16)
sealed = hashlib.sha256(f"{SECRET}:{salt}".encode()).hexdigest()
print("sealed:", sealed)

# %% [markdown]
# **Task 2, you.** Fly with the effect, twice. Hand over six columns and nothing else, because a log names the rig and the board.

# %%
for name, plan, seed in (("a", "identify", 1), ("b", "step", 2)):
    with heli_host.connect(f"sil://?effect={SECRET}&seed={seed}") as heli:
        heli.fly(plan, log=folder / f"{name}.mcap", overwrite=True)

# %% tags=["solution"]
# a.csv and b.csv in the folder: rows from 3 s to 33 s of both flights, with time, voltages and angles only
for name in "ab":
    whole = heli_host.read_flight(folder / f"{name}.mcap").between(3.0, 33.0)
    bare = Flight(
        whole.t_s, whole.front_V, whole.back_V, whole.elevation_rad, whole.pitch_rad, whole.travel_rad
    )
    write_csv(bare, folder / f"{name}.csv")

# %%
handed_over = (folder / "a.csv").read_text() + (folder / "b.csv").read_text()

# %% [markdown]
# **Task 3, your neighbour.** Look before you compute. Which axis has an error? Is it a delay or an offset? Then diagnose. Write down the
# answer with its confidence *before* the seal is opened.

# %%
given = [heli_host.read_flight(folder / f"{name}.csv") for name in "ab"]
for flight in given:
    print(flight, f"pitch moves {np.ptp(flight.pitch_deg):.0f} deg")

# %% [markdown] tags=["solution"]
# The angles follow the voltages later than in the model. There is no constant error, so it is a delay or a lag. The answer
# names the effect, its size and its confidence.

# %% tags=["long"]
result = diagnose(MultibodyModel(), load_rig("makki2024"), given[:1], given[1:])
answer = [cause.effect for cause in result.verdict.causes]
print(summary(result))

# %% [markdown]
# **Task 4, both.** Open the seal, and judge by the agreed rule:
#
# | answer | points |
# |---|---|
# | the right name | 1 |
# | also the size, within 10 % | 1 more |
# | *unexplained*, although an effect was hidden | 0 |
# | a wrong name | -1 |


# %% tags=["solution"]
# opened(effect, salt, seal): whether the seal was made of this effect and salt
def opened(effect, salt, seal):
    """Whether this is what was sealed."""
    return hashlib.sha256(f"{effect}:{salt}".encode()).hexdigest() == seal


print("the seal holds:", opened(SECRET, salt, sealed))
assert result.label == "cause_found" and answer == [SECRET.partition("=")[0]], "the neighbour found it"

# %% [markdown]
# **Check.**

# %% tags=["check"]
assert opened(SECRET, salt, sealed) and not opened(f"{SECRET}1", salt, sealed)
assert not any(word in handed_over for word in (*catalogue(), "makki", "rig", "sil"))
assert handed_over.splitlines()[0] == "t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad"

# %% [markdown]
# **Common mistakes.**
# - You hand over the log. Its metadata hold the address of the simulated board, which includes the effect. On the command line,
#   `heli-host fly --sil --blind` and `heli-host export --blind` seal the address and omit it.
# - The effect is too small. `heli-host diagnose` lists the effects that a flight could not have shown. That is not the neighbour's fault.
# - You change the rule of judgement after the seal is open.

# %% [markdown] tags=["rubric"]
# **Rubric.**
#
# | task | points | full points for |
# |---|---|---|
# | 1 | 2 | a random salt; the digest covers effect and salt |
# | 2 | 2 | six columns; no metadata |
# | 3 | 2 | the axis and the kind of error before the diagnosis; an answer with its confidence before the seal is opened |
# | 4 | 1 | the function compares digests |
# | Check | 3 | the check passes |
