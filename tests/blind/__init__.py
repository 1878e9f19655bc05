"""Effects are hidden in flights, and the diagnosis has to find them.

Flights on a rig in MuJoCo that knows nothing of the project's equations (`mujoco_rig.py`), with something
hidden in it: an effect of the catalogue by other means than the project's (`hidden.py`,
`measured_effects.py`), something outside the catalogue (`unlisted.py`), several things, or nothing. The
diagnosis gets the two flights and nothing else (`run.py`).

Half of the cases are clean (`cases.py`): flights of the project's own flight code (`flights.py`) without
disturbances. Half have disturbances, as every real rig has (`disturbances.py`, `disturbed_case.py`,
`disturbed_cases.py`): random torques about all three axes, most with a rotor lag of a tenth of a second
among the causes, rigs of the paper's and of the course's kind, logs at 100 to 500 Hz, flown by other
controllers, some gently (`tracking.py`). A seed gives each all it has.

What can be seen is what counts. On clean flights `oracle.py` fits the flights told the answer: an effect
below three standard errors is too small to be fair, and its error held out is what the diagnosis is to come
close to. With disturbances `visibility.py` states by how many standard deviations a cause stands out, once
other numbers have imitated what they can: `replay.py` finds what each does along the true course
(`course.py`). Cases count from 15 on by the faintest of their causes; those from 8 to 15 are told apart.

`truth.py` translates what is hidden to the catalogue's parameters; `judge.py` compares; `goals.py` counts,
`reliability.py` asks whether a confidence is a frequency, `summary.py` writes both for people.

Unlisted equations have separate cases (`equations.py`, `equation_cases.py`): 28 equations, in two sizes,
with disturbances. `equation_oracle.py` compares the equation that a diagnosis proposes with the true torque
on the flight held out and against a fit that is told the law; `python -m tests.blind.equation_run`
(`equation_run.py`) counts. Listed effects are taken off the list (`taken_off.py`), and the laws in their
place flown and held against them (`taken_off_oracle.py`): `python -m tests.blind.taken_off_run`
(`taken_off_run.py`).

A fast share runs in `make test`; `make blind` runs all of it, goes on where it was interrupted, and writes
`blind.json` and the reliability diagram beside it. `python -m tests.blind 'w-lag*' --keep` runs some, on
flights that are there; `--flights` only flies, and tells what can be seen; `--read` tells what the JSON
file holds and runs nothing. `choice.py` has the options that both commands choose cases by.

Does not belong here: anything but `oracle.py`, `equation_oracle.py`, `taken_off_oracle.py` and tests that
imports `heli_sim.model`, `heli_lab.identify` or the inside of `heli_lab.diagnose`; the diagnosis' door and
`heli_sim.rig` are all that the rest knows.
"""
