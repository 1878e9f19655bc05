"""Thresholds of a diagnosis: unit, origin, and what breaks on either side of each.

Three sets of flights set or checked them. **Simulated flights**: the simulated board flies rigs with one
known effect hidden, 34 s to fit and 26 s held out, as `tests/diagnose` does. **Blind cases**: MuJoCo flies
127 cases of known seed with hidden effects, 60 s and 40 s (`make blind`, `tests/blind`). **Measured
flights**: eight flights of real machines (`docs/measured.md`). "By judgement" means that no record of a
tuning exists: the value follows from the reasoning that stands there and passed the blind cases, whose counts
are in `docs/diagnosing.md`.

Log-likelihood ratios are in nats. A *normalised error* is a root mean square error of the free run in
standard deviations of the encoders' quantisation: 1 when the model is exact. Constants of numerical methods
(batches, tolerances, bounds of searches) stand beside their use.
"""

from __future__ import annotations

import math
from typing import Final

# When nothing is missing.

AT_NOISE_FLOOR: Final = 1.04
"""Normalised error, on all flights, up to which only quantisation remains. Refitted exact models reach 1.00
to 1.02 on simulated flights (2026-11). Lower: false alarms where nothing is hidden. Higher: small effects go
unnamed; the four causes that the blind cases missed leave 1.00 to 1.04."""

NOTHING_LEFT: Final = 1.012
"""Normalised error, on all flights, below which no further candidate is refitted. The middle of what exact
models reach (see `AT_NOISE_FLOOR`). Lower: refits that find nothing, time alone. Higher: effects are not
tried."""

UNEXPLAINED_SHARE: Final = 0.01
"""Share of the excess mean square (over quantisation) that named causes may leave. By judgement, with the
coloured-noise comparison. Lower: a large cause, modelled to 1 %, is called unexplained. Higher: a second,
small cause beside it passes for explained."""

# Which candidates are refitted.

MAX_CAUSES: Final = 6
"""Effects in one model. By judgement: twice the most that a blind case hides. Fewer: real rigs with many
effects stop early. More: time."""

SCREENED: Final = 12
"""Effects, and as many splines, whose first-order scores are taken again under the coloured-noise model in a
round. Came with that comparison to save time (2026-11). Fewer: an effect behind imitators is lost. More:
time."""

SHORTLIST: Final = 3
"""Effects that are refitted in a round. Was 4 before scores were taken under coloured noise.
Fewer: one wrong first-order score decides. More: time."""

SHORTLIST_SHARE: Final = 0.25
"""Share of the round's best score that an effect must reach to be refitted. Was 0.08 and 0.1 as long as
errors counted as independent, which made scores less comparable. Lower: time. Higher: where first-order
scores are off by more than a factor 4, the true effect is not refitted."""

CLOSE_ALTERNATIVE: Final = 0.5
"""Share of the round's best score from which on an effect is refitted although another one has already
reached the noise floor. By judgement: first-order scores may be wrong by a factor 2. Higher:
`ambiguous_with` stays empty where two effects do as well. Lower: time."""

SECOND_CHANCE: Final = 2
"""Effects that are refitted by their white-noise score where none of the shortlist is accepted. Set on the
measured flights (rendellc, 2026-11): a rotor lag gains nothing there before the gyroscopic torque is in the
model. 0: that search ends with nothing. More: time."""

SECOND_CHANCE_SHARE: Final = 0.3
"""Share of the best white-noise score that these must have. By judgement, with `SECOND_CHANCE`; only time
depends on it."""

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

MIN_HELD_OUT: Final = 3.0
"""Log-likelihood ratio on the held-out flights that an effect must reach, nats: a likelihood ratio of 20. By
judgement. Lower: effects fitted to one flight's chance. Higher: effects that the held-out flight hardly
excites."""

DECISIVE_TRAIN: Final = 4.0
"""Times its penalty that an effect must gain on the flights fitted where the held-out flight, being short,
does not confirm it by its lower bound. By judgement. Lower: false causes beside short held-out flights.
Higher: causes lost there."""

LOWER_BOUND_SHARE: Final = 0.75
"""Share of the held-out gain by which its 5 % bound may then be below zero: with few windows a single one
decides the bound. By judgement; sides as for `DECISIVE_TRAIN`."""

UNCONFIRMED_FACTOR: Final = 2.0
"""Times its penalty that an effect must gain where no flight was held out. By judgement. Lower: false
causes."""

MIN_REDUCTION: Final = 0.015
"""Share by which an effect must lower the mean square of at least one axis, in each set of flights. By
judgement: below it a cause explains nothing that can be seen, however significant. Lower: tiny corrections of
the model's discretisation are named. Higher: small effects are lost."""

MIN_REDUCTION_SPLINE: Final = 0.08
"""The same for a spline, which has 8 coefficients. By judgement: splines also fit what integration and
quantisation leave. Lower: `unexplained` where only these remain. Higher: unlisted effects are lost."""

PRIOR_RELIEF: Final = 20.0
"""Drop of the prior penalty, nats, that counts as a visible reduction of the error: without the effect the
parameters of the rig hide it by leaving their tolerances. By judgement: six standard deviations of one
parameter. Lower: any shift of parameters passes for an effect. Higher: effects that parameters imitate are
lost."""

MIN_COLOURED: Final = 6.0
"""Log-likelihood ratio beyond the penalty, under the coloured-noise model, nats. By judgement, when that
comparison came: gusts had passed for eccentric encoders and periodic torques. Lower: they do again. Higher:
weak causes beside real disturbances are lost."""

PLAIN: Final = 0.5
"""Share of an axis' mean square that, removed with only quantisation left, is accepted without the
coloured-noise comparison: a disturbance cannot be removed to the noise floor by a deterministic effect. By
judgement. Lower: a small gust may pass for a cause. Higher: time."""

DECIDED: Final = 60.0
"""|Log-likelihood ratio less penalty|, nats, beyond which the noise model is not estimated again about the
shifted parameters. By judgement: ten times `MIN_COLOURED`. Lower: decisions on a likelihood that has not
converged. Higher: time."""

COMPARED: Final = 3
"""Effects of a round that are compared under the coloured-noise model after their refit. By judgement. Fewer:
where the first ones imitate a gust, a true one behind them is lost."""

SPLINE_MARGIN: Final = 0.2
"""Share of its own margin by which a spline must beat the best effect to be taken in its place. By judgement:
a spline also takes up what the effect's equation idealises. Lower: listed causes are called unexplained.
Higher: unlisted ones get the name of the closest effect."""

SPLINE_MIN: Final = 20.0
"""Least score of a spline, and least lead over the best effect, nats. By judgement: 76 splines are tried in
each round. Sides as for `SPLINE_MARGIN`."""

INDEPENDENT_SAMPLES_EVERY: Final = 5
"""Samples of the log that count as one in the BIC penalty: 10 ms at 500 Hz. By judgement; the penalty depends
on its logarithm alone, 0.8 nats a parameter from 1 to 5."""

CANDIDATES_TRIED: Final = 60
"""Effects and splines that share a flight, for the penalty of multiple testing, ln(60) = 4 nats. About the
size of the catalogue. Its logarithm alone matters."""

SPLINE_COEFFICIENT_WEIGHT: Final = 0.5
"""Share of a free parameter that a spline's coefficient counts in the BIC penalty: priors and overlapping
basis functions leave about half of them free. By judgement. Lower: splines beat effects. Higher: the
reverse."""

# What is said.

AMBIGUOUS: Final = 6.0
"""Log-likelihood ratio, nats, below which two effects are not told apart: 400 to 1, had the noise model been
exact. By judgement. Lower: wrong names given for sure. Higher: `ambiguous` where the name was right."""

OFF_LIST_SHARE: Final = 0.3
"""Share of the explained evidence that splines may have before the verdict is `unexplained`. By judgement.
Lower: listed causes with a small curve beside them become `unexplained`. Higher: unlisted causes hide behind
them."""

GUST_MAX_LOSS: Final = 15.0
"""Log-likelihood ratio, nats, that a disturbance about one axis alone may lose against one about all three
and still be called `random_torque`. By judgement, with the whiteness test. Lower: true gusts are
`unexplained`. Higher: unmodelled dynamics, which act on several axes, pass for gusts."""

GUST_MAX_LOSS_SHARE: Final = 0.003
"""The same as a share of what the disturbance gains, for large ones, whose Gauss-Markov model is not
exact. By judgement; sides as for `GUST_MAX_LOSS`."""

GUST_MIN_SIGMA_OVER_STD: Final = 1.0
"""Standard deviation of a gust over the standard error of its estimate. By judgement: below it nothing is
seen of its course. Higher: small gusts are `unexplained`."""

MAX_CONFIDENCE: Final = 0.99
"""No flight makes surer than the model class is. By judgement; 88 of 88 blind answers at 0.9 and more were
right."""

CONFIDENCE_GUST: Final = 0.8
"""Confidence of a random torque: rare unmodelled dynamics pass the whiteness test. By judgement; of the blind
answers given with 0.7 to 0.85, most of them gusts, 12 of 14 were right."""

CONFIDENCE_BESIDE_UNKNOWN: Final = 0.5
"""Factor on the confidence of causes beside which something unexplained remains that they may imitate. By
judgement; 2 of 9 blind answers below 0.7, most of them such, were right, so it may still be too high. 1:
false causes beside unlisted ones pass for sure. Lower: true ones beside them are not believed."""

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

MIN_UNEXPLAINED: Final = 0.1
"""Share of the mean square beyond quantisation from which on `unexplained` is filled in without a spline. By
judgement. Lower: correlates are named that are none. Higher: the verdict stands without its details."""

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

PRESENT_LOG_STD: Final = math.log(2.0)
"""Standard deviation of the logarithm of a term that is present about the rig file's value: within half and
twice. By judgement, as the blind cases' frictions are drawn. Larger: small terms look absent. Smaller:
deviating ones."""

ABSENT_PRIOR: Final = 0.1
"""Probability before any flight that a term is absent. By judgement. Enters as ln(0.1/0.9) = -2.2 nats: 0.5
in its place would add 2.2."""

ABSENT_MIN_CONFIDENCE: Final = 0.5
"""Probability from which on a term is named as absent: more likely than not, by judgement. Lower: frictions
that are only small are called absent. Higher: absent terms that the flight hardly shows go unnamed."""

ABSENT_MIN_STD: Final = 1e-3
"""Least standard error of a parameter, as a share of the rig's: a fit keeps parameters that cannot be
negative this far from zero. Lower: an absent term would be found to be small."""

CLOSELY_STATED: Final = 0.5
"""Relative tolerance below which the prior holds a parameter away from zero, so that the model must be
refitted without the term to see that it is absent. By judgement: rig files state lengths closely and
frictions loosely."""

ABSENT_MIN_ERROR: Final = 1.5
"""Normalised error of the baseline from which on such refits are tried. On simulated flights without a
pendulum it is 6 and more (2026-11). Lower: time. Higher: nothing changes up to 6."""

ABSENT_MAX_SHARE: Final = 0.5
"""Share of the normalised error beyond 1 that may remain without the term. By judgement: without a pendulum
that is there the error grows. Higher: another effect may pass for the missing term."""

# Judging on another flight.

CALIBRATE_s: Final = 8.0
"""Free flight that the constants of a validation flight are estimated from, s: four windows. The goals for
the measured pairs are stated for it. Shorter: what a model lacks is taken for a constant of the flight.
Longer: less is left to judge."""

CALIBRATE_SHARE: Final = 1.0 / 3.0
"""Share of a flight's free seconds that calibration may take at most. By judgement. Higher: a short flight is
judged on a window or two. Lower: its constants are not known."""
