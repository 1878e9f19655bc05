"""Thresholds of a diagnosis: unit, origin, and what breaks on either side of each.

Three sets of flights set or checked them. **Simulated flights**: the simulated board flies rigs with one
known effect hidden, 34 s to fit and 26 s held out, as `tests/diagnose` does. **Blind cases**: MuJoCo flies
127 cases of known seed with hidden effects, 60 s and 40 s (`make blind`, `tests/blind`). **Measured
flights**: eight flights of real machines (`docs/measured.md`). "By judgement" means that no record of a
tuning exists: the value follows from the reasoning that stands there and passed the blind cases, whose counts
are in `docs/diagnosing.md`.

Log-likelihood ratios are in nats, each model under the weather that suits it best. Constants of numerical
methods (batches, tolerances, bounds of searches) stand beside their use.
"""

from __future__ import annotations

import math
from typing import Final

# Which candidates are refitted.

MAX_CAUSES: Final = 6
"""Effects in one model. By judgement: twice the most that a blind case hides. Fewer: real rigs with many
effects stop early. More: time."""

SHORTLIST: Final = 3
"""Effects that are refitted in a round. Was 4 before scores were taken under coloured noise.
Fewer: one wrong first-order score decides. More: time."""

SHORTLIST_SHARE: Final = 0.25
"""Share of the round's best score that an effect must reach to be refitted. Was 0.08 and 0.1 as long as
errors counted as independent, which made scores less comparable. Lower: time. Higher: where first-order
scores are off by more than a factor 4, the true effect is not refitted."""

HELD_SHARE: Final = 0.5
"""Share of the time at rest from which on an axis may be held by dry friction that no score sees. By
judgement; on the case of the blind set (2026-11) that needs it the arm rests nine tenths of the time, the
score is below 3 nats and a refit gains 1200. Lower: time, a refit an axis. Higher: friction that holds for
long is missed."""

EXPECTED_REFIT_GAIN: Final = 2.0
"""Factor by which a refit may exceed a first-order score: an effect whose score is below its penalty by more
is not refitted. By judgement. Lower: nonlinear effects are lost. Higher: time."""

ALTERNATIVE_SHARE: Final = 0.2
"""Share of the round's best score that an effect must have to be refitted in the place of one of several
causes, to be named in `ambiguous_with`. By judgement. Lower: time. Higher: confidence too high."""

EVENT_EDGE_s: Final = 1.0
"""A moment (`thrust_step`, `counterweight_shift`) that is found closer than this to a flight's start or end
is refused: initial states or the last window imitate it. Half a window, by judgement. Lower: false steps at
the edges. Higher: true ones there are lost."""

# What a candidate must reach.

MIN_MARGIN: Final = 6.0
"""Log-likelihood ratio beyond the penalty, nats. By judgement; with the penalty of one parameter it asks for
14 nats, 5.3 standard deviations. Lower: chance of an unmodelled kind gets a name. Higher: weak causes are
lost."""

NOTHING_STD_ERRORS: Final = 2.0
"""Standard errors within which an effect's size is nothing, and the effect is not named. By definition of the
intervals given. Higher: weak causes are lost."""

WALD_OVERRIDE_NATS: Final = 50.0
"""Margin from which an effect is something whatever the standard error of its size: that of friction that
holds an axis says how little the flights know of more of it, not of less (Hauck and Donner, J. Am. Stat.
Assoc. 72 (1977) 851). By judgement; ten standard errors where both tests hold. Lower: sizes are named whose
interval has nothing in it. Higher: an axis that friction holds is not understood."""

LIKE_REFITTED: Final = 2
"""Effects of a spline's own channel that are refitted over their grids before the spline may displace them.
By judgement. Fewer: a smooth curve displaces the listed effect that it imitates. More: time."""

ALTERNATIVES: Final = 2
"""Other effects that are refitted in the place of a cause. By judgement. Fewer: confidence too high. More:
time."""

SPLINE_MARGIN: Final = 0.2
"""Share of its own margin by which a spline must beat the best effect to be taken in its place. By judgement:
a spline also takes up what the effect's equation idealises. Lower: listed causes are called unexplained.
Higher: unlisted ones get the name of the closest effect."""

SPLINE_MIN: Final = 20.0
"""Least score of a spline, and least lead over the best effect, nats. By judgement: 76 splines are tried in
each round. Sides as for `SPLINE_MARGIN`."""

CANDIDATES_TRIED: Final = 60
"""Effects and splines that share a flight, for the penalty of multiple testing, ln(60) = 4 nats. About the
size of the catalogue. Its logarithm alone matters."""

SPLINE_COEFFICIENT_WEIGHT: Final = 0.5
"""Share of a free parameter that a spline's coefficient counts in the BIC penalty: priors and overlapping
basis functions leave about half of them free. By judgement. Lower: splines beat effects. Higher: the
reverse."""

# What is said.

AT_NOISE_FLOOR: Final = 1.04
"""Root mean square error of the free run, in standard deviations of the quantisation, on all flights, up to
which nothing shows. Exact models reach 1.00 to 1.02 on simulated flights (2026-11). Lower: what the method's
own steps leave, a tenth of a mN m, is called unexplained. Higher: small unlisted laws go unnoticed."""

GUST_SHARE: Final = 0.1
"""Share of its typical size from which on a random torque about one axis alone is named. By judgement. Lower:
what the method's own steps leave gets the name of a gust. Higher: light gusts are passed over as weather."""

GUST_MIN: Final = 15.0
"""Log-likelihood ratio, nats, of torques by chance about one axis from which on they may be a cause. By
judgement. Lower: what the model's discretisation leaves is called a gust."""

GUST_BESIDE: Final = 15.0
"""The same about any other axis, above which they are weather, which every rig has, and no cause. By
judgement."""

GUST_LEAST_s: Final = 0.05
"""Memory from which on they may be one: a little more than a measurement of the filter, 0.04 s. Set on a case
of the blind set (2026-11): dry friction that holds the arm for moments leaves torques of 7.5 mN m without
memory. Lower: that is called a gust. Higher: the shortest gusts of the catalogue's grid are weather."""

HELD_OUT_EVEN: Final = 0.0
"""Log-likelihood ratio on flights that had no part in the choice, nats, at which a cause is as likely as not
by these flights alone."""

HELD_OUT_AGAINST: Final = -4.0
"""Log-likelihood ratio on the flights held out, nats, below which they speak against a cause, and it is not
named: 50 to 1. By judgement: on a measured pair (2026-11) a step at one moment had -6 and an odd curve -14,
all other causes 4 to 700. Lower: what one flight did by chance is named. Higher: true causes that a gentle
flight hardly shows are lost."""

HELD_OUT_NATS: Final = 2.0
"""By so many nats more the odds grow by a factor e. By judgement: ratios ignore that weather changes from
flight to flight."""

AMBIGUOUS: Final = 6.0
"""Log-likelihood ratio, nats, below which two effects are not told apart: 400 to 1, had the noise model been
exact. By judgement. Lower: wrong names given for sure. Higher: `ambiguous` where the name was right."""

MAX_CONFIDENCE: Final = 0.99
"""No flight makes surer than the model class is. By judgement; 88 of 88 blind answers at 0.9 and more were
right."""

CONFIDENCE_GUST: Final = 0.8
"""Confidence of a random torque: rare unmodelled dynamics pass the whiteness test. By judgement; of the blind
answers given with 0.7 to 0.85, most of them gusts, 12 of 14 were right."""

CONFIDENCE_BESIDE_UNKNOWN: Final = 0.69
"""Factor on the confidence of causes beside which something unexplained remains that they may imitate. From a
sample of 50 blind cases (2026-11): of 21 causes in such answers 16 were right, and one of the others had
63 nats on the flights held out, so that evidence does not tell them apart. 1: false causes beside unlisted
ones pass for sure. Lower: true ones beside them are not believed."""

CONFIDENCE_NATS: Final = 15.0
"""Log-likelihood ratio over the closest alternative by which the doubt falls by a factor e, nats. By
judgement: ratios ignore the error of the noise model. Lower: too sure of close decisions. Higher: too unsure
of clear ones."""

CORRELATE_SHARE: Final = 0.3
"""Share of the best spline's score from which on a quantity is named in `correlates_with`. By judgement; it
decides the length of a list: lower, a longer one."""

CORRELATE_MIN: Final = 5.0
"""Least score of a quantity that is named there, nats. By judgement. Lower: correlations by chance are
named."""

DETECTION_STD_ERRORS: Final = 5.0
"""Standard errors that an effect of typical size must measure to count as detectable. By judgement: its
penalty needs 4 to 5 (BIC with multiple testing). Lower: effects are called absent that would have been
missed. Higher: more are listed as undetectable."""

FEW_WINDOWS: Final = 5
"""Held-out windows of 2 s below which a caution is given: quantiles of the resampled ratio mean nothing
then. By judgement; only the caution depends on it."""

SHORT_s: Final = 15.0
"""Free flight below which another experiment is proposed, s. By judgement: fewer than eight windows
of 2 s. Lower: short flights get no proposal. Higher: the experiment is simulated for good flights, time."""

MANY_UNDETECTABLE: Final = 12
"""Undetectable effects above which another experiment is proposed: a third of the catalogue. By judgement; a
flight of `heli-host fly identify` leaves 2."""

# Terms of the baseline that are absent.

ABSENT_MIN: Final = 15.0
"""Score, nats, from which on the model is estimated without a closely stated term. By judgement: while the
term is in the model, weather stands for its absence and the score is low. Lower: time. Higher: absent terms
are not tried."""

PRESENT_LOG_STD: Final = math.log(2.0)
"""Standard deviation of the logarithm of a term that is present about the rig file's value: within half and
twice. By judgement, as the blind cases' frictions are drawn. Larger: small terms look absent. Smaller:
deviating ones."""

ABSENT_PRIOR: Final = 0.1
"""Probability before any flight that a term is absent. By judgement. Enters as ln(0.1/0.9) = -2.2 nats: 0.5
in its place would add 2.2."""

ABSENT_MIN_CONFIDENCE: Final = 0.8
"""Probability from which on a term is named as absent. A friction at its bound beside a lag that is not in
the model reaches 0.66 on a simulated flight (2026-11); absent ones reach 0.9 and more. Lower: frictions that
another cause hides are called absent. Higher: absent terms that the flight hardly shows go unnamed."""

ABSENT_MIN_STD: Final = 1e-3
"""Least standard error of a parameter, as a share of the rig's: a fit keeps parameters that cannot be
negative this far from zero. Lower: an absent term would be found to be small."""

CLOSELY_STATED: Final = 0.5
"""Relative tolerance below which the prior holds a parameter away from zero, so that the model must be
refitted without the term to see that it is absent. By judgement: rig files state lengths closely and
frictions loosely."""

# The law of what is on no list.

LAW_TERMS: Final = 3
"""Terms of a proposed law. By judgement: a law of four is a curve by another name."""

EQUATION_FINALISTS: Final = 4
"""Groups of terms that are refitted in a round. Fewer: one first-order score decides. More: time."""

LAW_KEPT_SHARE: Final = 0.25
"""Share of what its score promises that a refit must gain to count as one of them; up to twice as many are
refitted. A stretched encoder promises tens of nats on the course that the filter predicts, and then gains
nothing (blind cases, 2026-11). Lower: such terms take the places of the true one. Higher: time."""

LAW_ALIKE: Final = 2
"""Of those, most of the same channel and quantities. By judgement. More: shapes of one dependence crowd out
another quantity that is the true one."""

EQUATION_NEAR_REST: Final = 20.0
"""What a sign of an axis' own rate about that axis must gain more, nats: an encoder at rest repeats its
count, and the filter takes that for a pull towards rest (`residual_analysis.py` has the counts)."""

LAW_CONFIRMED: Final = 6.0
"""Log-likelihood ratio on the flights held out, nats, that each term of a law must gain: 400 to 1. By
judgement; visible laws of the blind cases have tens to hundreds. Lower: what one flight did by chance is
proposed as a law. Higher: laws that a short second flight hardly shows are not proposed."""

LAW_CURVE_SHARE: Final = 0.5
"""Share of what a curve in the law's place gains that the law must gain. By judgement. Lower: a law that
explains the smaller part of what is missing is proposed. Higher: laws that the grammar only comes near to are
not."""

LAW_UNCONFIRMED: Final = 0.5
"""Most that a law is believed that no other flight confirmed. By judgement: as likely as not."""

FALSE_DISCOVERY_RATE: Final = 0.05
"""Share of the cells in which a model is said to fail that may be said so by chance. By convention. Higher:
weather is outlined. Lower: regimes that a flight visits briefly are not."""

# Judging on another flight.

CALIBRATE_s: Final = 8.0
"""Free flight that the constants of a validation flight are estimated from, s: four windows. The goals for
the measured pairs are stated for it. Shorter: what a model lacks is taken for a constant of the flight.
Longer: less is left to judge."""

CALIBRATE_SHARE: Final = 1.0 / 3.0
"""Share of a flight's free seconds that calibration may take at most. By judgement. Higher: a short flight is
judged on a window or two. Lower: its constants are not known."""

# How closely numbers are told.

WITHIN_STEP_STD: Final = 1.4
"""Factor on the standard error of times. A controller answers within a step what the filter has not seen yet,
so that lags come out short in gusts: by 1.4 +- 1.1 ms on eleven simulated flights at 500 Hz (2026-11), by
nothing with steps of 5 ms, which take twice the time. Lower: intervals of lags miss the truth on windy
flights. Higher: they say less than the flights do."""

LEAST_STD_SHARE: Final = 0.007
"""Of an effect's size: the least standard error. Steps of 10 ms blur what changes within them: the quadratic
share of thrust comes out 1.2 % too large on clean simulated flights, 0.2 % with steps of 5 ms (2026-11).
Lower: on flights without weather the intervals miss the truth. Higher: they say less than the flights do."""

LEAST_COUNTS: Final = 0.5
"""Counts of an encoder: the least standard error of what lies between it and its axis. An axis turns back
within a count unseen: plays come out up to 0.9 counts off, too large about as often as too small (eight of
nine simulated flights within one, 2026-11). Lower: intervals of plays miss the truth. Higher: they say less
than the flights do."""
