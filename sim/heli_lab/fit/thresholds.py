"""Thresholds of identification: the meaning, unit and source of each, and the effect of other values.

"Set by judgement" means that no measurement is on record. "Measured flights" are the eight flights of
docs/validation/measured-flights.md; "coverage" is the count of `make bench` over 50 rigs drawn from
their tolerances.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

# The free flight in a log

TABLE_MARGIN_DEG: Final = 1.5
"""Elevation above the table that still counts as contact, deg. Set by judgement. Lower: bounces are
fitted as flight. Higher: low flight is lost."""
TAKE_OFF_DEG: Final = 10.0
"""A take-off or landing is over only this far above the table, deg. Set by judgement. Lower: the cushion
of air near the table is fitted as lift. Higher: slow climbs are lost."""
LAG_S: Final = 0.3
"""Cut before and after a contact with a stop, and time over which the last voltages of a flight are averaged,
s: three times the rotors' lag of 0.1 s. Set by judgement. Shorter: a motion that a contact began is fitted.
Longer: free flight is lost."""
SETTLED_S: Final = 1.0
"""Cut after the end of a take-off, and free run before a window from which the states of effects are taken,
s. Set by judgement: half of it leaves 0.1 % of a lag of 0.07 s. Longer costs flight."""
LANDING_VOLTAGE_SHARE: Final = 0.6
"""A flight ends in a landing if its last voltages add up to less than this share of the typical sum. One
measured log ends in the air with a share of 0.04; the others end with 0.7 and more."""
DESCENT_VOLTAGE_SHARE: Final = 0.85
"""Below this share of the typical sum, the descent before such an end counts as landing. Set by judgement.
Lower: the beginning of the descent is fitted. Higher: flight is lost."""
LANDING_DEG: Final = 5.0
"""How far below the typical elevation a flight must end to have landed in the air, deg. Set by judgement."""
ROTOR_m: Final = 0.1
"""Radius of a rotor, m: propellers of rigs of this kind have diameters of 0.2 m and more. In two measured
flights, a rotor of a tilted arm strikes the table. With 0, these strikes are fitted as flight."""
STOP_MARGIN_DEG: Final = 1.0
"""Angle before a mechanical stop that counts as contact, deg. Set by judgement, as `TABLE_MARGIN_DEG`."""
MAX_UNSURE_DEG: Final = 3.0
"""Largest part of the tolerance of a table or a stop that counts, deg. Set on the Quanser rig, whose
tolerances cover the difference between two courses. More: free flight near the stops is lost. Less: contacts
are fitted."""
BEYOND_STOP_DEG: Final = 5.0
"""If a flight goes beyond a stop by more than its tolerance and this, deg, the stop of the rig file is
ignored, with a note. Set by judgement."""
MIN_SEGMENT_S: Final = 1.0
"""Shortest piece of free flight that is fitted, s. Set by judgement: a shorter piece has more unknown
initial states than information about the parameters."""

# Windows and their initial states

BLOCK_S: Final = 0.01
"""Approximate duration of a block, s. A window is a whole number of blocks, whatever the step, so that means
over blocks exist."""
STATE_FIT_S: Final = 0.15
"""The first guess of a window's state is a parabola through the angles of twice this time, s. Set by
judgement. Shorter: quantisation makes the rate wrong. Longer: the acceleration is not constant."""
SHORT_FIT_S: Final = 0.05
"""The same for a second guess, which is robust to a jump of the torque nearby, s. Set on flights with dry
friction and backlash (tests/identify/test_shooting.py)."""
STATE_STD: Final[Mapping[str, float]] = {"rad": 0.02, "N m": 0.1}
"""Prior standard deviation of an effect's state at the beginning of a window, by its unit. Set by judgement:
twice a typical backlash, several typical torques. Much smaller: a wrong run-in decides. Much larger: the
state is unconstrained."""
STATE_STD_V: Final = 0.15
"""The same for a rotor's thrust, V. Unconstrained, each window of a measured flight fits its own thrust, and
a lag of 0.12 s is estimated as 0.13 to 0.35 s. With 0, the error of the run-in biases the lag."""
FAR_RAD: Final = 0.1
"""RMS error of the first prediction, rad, above which short windows are fitted first. Set on measured
flights, with `SHORT_WINDOW_S`. Larger: long windows diverge. Smaller: the fit only takes longer."""
SHORT_WINDOW_S: Final = 0.4
"""Windows of that first fit, s. From 0.7 standard deviations of the rig file `quanser-course`, one fit in
four of measured flights diverges in windows of 2 s; with these before them, none of forty does."""

# Noise of the residuals

LONGEST_LAG_S: Final = 0.5
"""Bartlett window of the long-run (HAC) variance, s. Set by judgement, confirmed by coverage (94.9 % of
estimates within two standard errors). Shorter: standard errors are too small if a model is wrong. Longer:
they scatter."""
MIN_SHARE: Final = 0.5
"""Every axis gets at least this share of the largest unexplained variance of an axis, in rad^2. With 0,
pitch has twice the error on measured flights. 0.25 is too small for the wide tolerances of the Quanser rig.
With 1, all axes weigh the same."""
OUTLIER: Final = 3.0
"""A window whose RMS residual is this many times that of the median window loses weight. Set by judgement.
Lower: good windows of a wrong model are discarded. Higher: one disturbed window decides."""
GROSS: Final = 10.0
"""Beyond this many times the median, the weight of a window decreases with its error: a person touched the
arm. Set on a flight with a disturbed window, which must neither decide the fit nor widen its errors. With
`OUTLIER` alone, each such window counts as one at that limit."""
WHITE_LAG_S: Final = 0.1
"""Lag at which the autocorrelation of a residual is tested, s. Set by judgement. Shorter: quantisation, which
stays for several samples, is seen. Longer: only the slowest errors are seen."""

# The solver

ROUNDS: Final = 8
"""Most updates of the weights on the coarse grid. Set on flights with dry friction, fitted from zero
friction. Fewer: a fit ends before its weights are final. More only cost time."""
ROUGH_ROUNDS: Final = 3
"""First rounds, with preliminary weights: four steps are enough, and multimodal parameters stay fixed. Set on
a periodic torque, whose frequency diverges while its amplitude is still wrong."""
FINE_ROUNDS: Final = 4
"""Most updates of the weights on every sample. Set with `ROUNDS`."""
SETTLED_CHANGE: Final = 0.15
"""Weights are final if no variance changed by more than this share. Set by judgement: standard errors
change with the square root, by 7 % at most. Smaller costs rounds that change no digit."""
STATE_DAMPING: Final = 0.01
"""Damping of the initial states, as a share of their own diagonal, for each unit of the parameters' damping.
Set so that dry friction is estimated from zero friction. With 0, only the parameters take small steps."""
DIVERGED_FACTOR: Final = 1.1
"""A window whose cost grows by this factor in a step has diverged, and its states are optimised separately.
Set on flights with dry friction, fitted from zero friction. Higher: one diverged window rejects the whole
step. Lower costs evaluations."""
DIVERGED_SHARE: Final = 1e-3
"""The cost of a diverged window also grows by this share of the whole cost. Set by judgement: less is not
worth an evaluation."""
WORTHWHILE_GAIN: Final = 0.01
"""Share of the cost that separately optimised windows must gain: in one step to be worth another, and in
total for the fit to continue from them. Set by judgement."""
RESTART_OUTLIER: Final = 1.5
"""A window whose mean square is this many times that of the median window starts again from other states. Set
on backlash of travel and sticking axes, whose windows may converge to a wrong minimum. Lower: sound windows
restart. Higher: wrong windows stay."""
MAX_RESTART_MEDIAN: Final = 9.0
"""Mean square of the median window, in variances of the quantisation, above which the model is wrong and no
window restarts. Set by judgement. Higher: restarts that cannot help cost time. Lower: windows stay at a wrong
minimum in a model that is only somewhat wrong."""
RESTARTS: Final = 2
"""Rounds of restarts: in the second, the neighbouring window may have left its own wrong minimum."""
WEIGHT_TURNS: Final = 3
"""Iterations between variances and robust weights, so that an outlier does not widen the scale that it is
compared with. Set on a flight with a disturbed window. The loop ends earlier if no weight changes."""
WINDOW_PATIENCE: Final = 2
"""Steps without that gain before windows stop. Set with `RESTART_PATIENCE`."""
RESTART_PATIENCE: Final = 5
"""The same for windows that start from other states, because their damping has to grow first. Set on backlash
of travel."""

# Uncertainty and reported quantities

DITHER_PHASES: Final = 24
"""Random phases of the counts that simulate the effect of quantisation on the estimates. Set by
judgement: their scatter is known to 15 %. More cost time in proportion."""
UNINFORMED: Final = 0.9
"""A parameter whose standard error is above this share of the prior's is uninformed by the flights. Set
by judgement: at 0.9 the flights hold a fifth of the information."""
COMBINATION_WEIGHT: Final = 0.25
"""Smallest part of a parameter in a combination, as a share of the largest. Set by judgement, for legibility
only."""
STRONG_CORRELATION: Final = 0.9
"""Correlation above which a pair is reported. Set by judgement, for legibility only."""
UNEXPLAINED: Final = 0.6
"""Share of the motion of the best axis (RMS, no unit) above which the voltages do not explain a flight; see
`unexplained_shares`. Lower: hovers in disturbances are refused. Higher: slow noise is accepted.

Largest share that a flight leaves: 0.22 (practice), 0.27 (measured machines), 0.45 (field), 0.18 (a hover of
12 s, one free parameter), 0.47 (a hover in the strongest disturbances of heli_benchmark). On other seeds,
hovers leave 0.41 at most. In five times as strong disturbances, one of three hovers leaves 0.61.

Smallest share that noise leaves: 0.67 in 176 flights of white to twice integrated noise, 0.72 in 80 flights
on other seeds."""
MIN_MOTION: Final = 1.7
"""Smallest RMS motion of an axis without its parabolas that is tested, in standard deviations of the
quantisation: half a count. Quantisation alone has 1. Lower: an axis at rest decides by chance. Higher: slow
axes are not tested."""
REST_COUNTS: Final = 1
"""Range of an axis in counts up to which it rests: on the edge of a count, an axis at rest alternates between
two counts. Smaller: an axis at rest is said to move. Larger: slow motion is said to be rest."""
QUANTISATION_ONLY: Final = 1.05
"""Up to this normalised error, only quantisation remains. Coverage has at most 1.01 on held-out flights; the
difference allows for slightly uneven encoders."""
MIN_OF_PRIOR: Final = 1e-3
"""Lower bound of a parameter that cannot be negative, as a share of its prior mean: every rig has a length
and a gain. Set by judgement. An estimate on this bound is reported as such."""
