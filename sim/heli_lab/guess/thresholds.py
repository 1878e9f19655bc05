"""Thresholds of the guess: what each means, in which unit, how it was set, and what happens beside it.

"Measured flights" are the eight flights of docs/measured.md, "simulated" those of `python -m tests.guess`.
"""

from __future__ import annotations

from typing import Final

SAMPLE_STEP_s: Final = 0.01
"""Step of the signals that are compared, s. Set by judgement: far below anything that the arm does."""
CUTOFF_Hz: Final = 1.5
"""Corner of the low-pass before derivatives are taken, Hz. Set on measured flights: at 3 Hz quantisation at
50 rows a second hides elevation, at 0.7 Hz the pitch loop is gone."""
EDGE_S: Final = 0.7
"""Left out at either end, where the filter knows half a flight, s: one period of the corner."""
LAGS_S: Final = (-0.24, 0.5, 0.02)
"""Lags tried between a cause and its effect: first, beyond last, step, s. Rotors lag by 0.05 to 0.2 s."""
ROLE_LAGS_S: Final = (0.0, 0.06, 0.12, 0.2)
"""Lags tried while columns are being told apart, s."""
INDEPENDENT_Hz: Final = 1.0
"""Independent samples a second in filtered residuals; a third of what the filter's width gives, because what
a model lacks is slow. Set by judgement: higher makes every answer sound surer."""
SURE_NATS: Final = 6.0
"""Difference of log-likelihoods from which on a choice is sure: 400 to 1. Below, the answer is that it is
unsure. Set by judgement, held by the 200 distortions."""
FITTING_NATS: Final = 25.0
"""Assignments of columns within this of the likeliest are compared by what units say of them, too: what no
unit fits is off by that much. Higher takes longer, lower believes how columns move alone."""
MOST_FITTED: Final = 12
"""Assignments compared so, at most."""
NAME_NATS: Final = 8.0
"""What a column's name is worth: more than a sure choice, so that a name and nothing against it is sure, and
a name against a sure choice is a doubt."""
OTHER_NATS: Final = 12.0
"""What a name counts against a column that says it is a setpoint, a rate or an estimate: a setpoint that is
followed well obeys the same physics."""
ENCODER_NATS: Final = 10.0
"""What it counts for an angle that its column is in steps of the rig's encoders: an estimate, a setpoint or a
rate is in none, and moves alike. More than a name."""
UNIT_NATS: Final = 6.0
"""What a stated unit is worth. It is overruled by a scale that is off by `SCALE_STD` times five."""
GAIN_STD: Final = {"elevation": 0.5, "pitch": 0.7, "travel": 0.4}
"""Standard deviation of the logarithm of how much an axis accelerates, against what the rig file says: up to
0.87 on measured pitch, 0.57 on elevation, 0.45 on travel. Smaller says wrong units where the rig file is
rough, larger cannot tell counts from degrees."""
HOVER_STD: Final = 0.25
"""The same of the voltage at hover; measured and simulated flights are within 0.15."""
MOST_OFF_STD: Final = 3.0
"""Standard deviations from which on a scale does not fit the rig, whatever the unit: said, as a doubt."""
REST_DEG: Final = 4.0
"""How far the elevation at rest may be from the rig file's table, beside its tolerance, deg. Measured flights
rest at -30.0 and -30.4 deg; at rest level is 25 deg away, so anything between 2 and 10 tells them apart."""
REST_S: Final = 0.1
"""A flight that stands still this long at its beginning, where it is lowest, begins on its table, s. Measured
ones are logged from full voltage on, and rise after 0.2 s."""
RATE_MATCH: Final = 0.9
"""Share of the variance of a column that is another one's derivative, from which on it is a rate."""
LATE_S: Final = 0.08
"""Lag from pitch to travel from which on travel is taken to be logged late, s. Measured and simulated ones
are -0.04 to 0.06 s by this estimate; shorter delays are said and left as they are."""
APART_S: Final = 0.16
"""Difference of the lags of elevation and pitch from which on one is taken to be logged late, s; up to 0.14 s
on measured flights."""
OWN_LAG_S: Final = (-0.03, 0.28)
"""Lag from voltages to angles that rigs have, s: rotors of 0.05 to 0.2 s, within what the estimate scatters.
Outside, the voltages were logged at another time than the angles, and the answer is unsure of them."""
FLOWN_S: Final = 20.0
"""Of each flight at most this much is flown through the model for each choice of signs, s: the parts in which
pitch moves most. Set by judgement; all of it takes longer and says the same."""
FLOWN_RATIO: Final = 1.15
"""Product of the axes' errors of another choice of signs over that of the profile's below which the model
does not tell them apart. Wrong choices are off by 1.3 and more on measured flights; lower believes chance."""
CLEARLY_WORSE: Final = 0.5
"""The same below which a flight that is to be fitted has wrong signs. One sign makes 0.03 to 0.8 of it; with
the answers' own margin, `SURE_NATS`, which must agree. Higher stops fits of rigs that are only unusual."""
CLIP_SHARE: Final = 1.02
"""Share of the supply from which on a voltage cannot have acted, and was a command before a clip. Rounding is
below."""
MOST_CLIPPED: Final = 0.2
"""Share of the rows beyond the supply from which on the supply is another one than the rig file's, no limit.
Set by judgement: a loop that is beyond its limits for longer does not fly."""
