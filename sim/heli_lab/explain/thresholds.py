"""Thresholds of a diagnosis: one table of hand-set constants with unit, value and source.

The annotation of each constant holds its unit and its source; ``python -m heli_lab.explain.thresholds``
prints the table. The text below each constant states the reason and what breaks on either side. Sources:

theory
    The value follows from a distribution, a convention or a definition.

measurement
    The value was measured on flights whose truth is known: **simulated flights** of `tests/diagnose` (34 s
    to fit and 26 s held out, one known effect hidden), and the development cases of `tests/field`.

judgement
    No record of a tuning exists; the value follows from the stated reason.

No constant may be set on cases that judge the project. Log-likelihood ratios are in nats (6 nats: 400 times
as likely), each model with its own estimate of the disturbances. Constants of numerical methods (batch
sizes, grids, tolerances, bounds) are next to their use.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Any, Final, get_args, get_type_hints


class Source(Enum):
    """Where a value comes from."""

    THEORY = "theory"
    MEASUREMENT = "measurement"
    JUDGEMENT = "judgement"


THEORY: Final[Source] = Source.THEORY
MEASUREMENT: Final[Source] = Source.MEASUREMENT
JUDGEMENT: Final[Source] = Source.JUDGEMENT

# Search: which candidates are refitted.

MAX_CAUSES: Final[Annotated[int, "effects", JUDGEMENT]] = 6
"""Effects in one model: twice as many as a rig usually lacks. Fewer: rigs with many effects end too early.
More: time."""

SHORTLIST: Final[Annotated[int, "effects", JUDGEMENT]] = 3
"""Effects that are refitted in a round before one of them is accepted.
Fewer: one wrong first-order score decides. More: time."""

SHORTLIST_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.25
"""Share of the round's best score that an effect must reach to be refitted. Also the share of its score that
a refit of an equation must gain to count as one of `EQUATION_FINALISTS`. First-order scores are wrong by up
to a factor of 4. Lower: time, and terms that gain nothing in a refit displace the true one. Higher: the true
effect is not refitted."""

MIN_REST_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.5
"""Share of the time at rest above which dry friction is tried on an axis without regard to its score:
friction that holds an axis has no derivative. Lower: time, one refit per axis. Higher: friction that holds
an axis for long is missed."""

MIN_PAUSE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.15
"""Share of the time with an unchanged count, for `RETURN_s` and longer, above which play is tried on an axis
without regard to its score. Lower: time, one refit per axis. Higher: small plays are missed."""

EXPECTED_REFIT_GAIN: Final[Annotated[float, "1", JUDGEMENT]] = 2.0
"""Factor by which a refit may exceed a first-order score: an effect whose score is further below its penalty
is not refitted. Lower: nonlinear effects are lost. Higher: time."""

ALTERNATIVE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.2
"""Share of the round's best score that an effect needs to be refitted in the place of one of several causes.
Lower: time. Higher: confidences are too high, because `ambiguous_with` is incomplete."""

EVENT_EDGE_s: Final[Annotated[float, "s", JUDGEMENT]] = 1.0
"""A change at a moment (`thrust_step`, `counterweight_shift`) this close to the start or end of a flight is
refused, because initial states or the last window imitate it: half a window. Lower: false steps at the
edges. Higher: true steps there are lost."""

CHANCE_NATS: Final[Annotated[float, "nats", THEORY]] = 5.0
"""Score that chance reaches at the best of 60 moments or quantities in one of ten flights: three standard
errors. Above it, the disturbances are estimated again together with an effect that has a moment, and a
quantity is listed in `correlates_with`. Lower: time, 0.1 s per candidate, and chance correlations. Higher:
large events that hide themselves in the disturbances are missed."""

EVENT_STD_ERRORS: Final[Annotated[float, "standard errors", MEASUREMENT]] = 5.0
"""Level in a held-out flight, about any axis, from which on an effect with a moment is tried there. Slips of
10 and 30 mm reach 10 to 14, the largest of other levels 3.0 (development seeds 5000 of `heli_benchmark`,
2026-11). Lower: time. Higher: an event in a held-out flight contradicts its own cause."""

NEW_DISTURBANCES_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 20.0
"""Gain of a refit above which the disturbances are estimated again from other start values: a cause of six
standard deviations. Lower: time. Higher: disturbances keep the size that they had while they replaced the
cause."""

# Search: what a candidate must reach.

MIN_MARGIN: Final[Annotated[float, "nats", JUDGEMENT]] = 6.0
"""Log-likelihood ratio that decides: 400 to 1, if the noise model were exact. A cause must exceed its penalty
by it, and a term of an equation must gain it on held-out flights. It also separates the names of two effects,
and selects the disturbances that a report mentions. With the penalty of one parameter a cause requires 14
nats, 5.3 standard deviations. A grid is refined from half of it. Lower: unmodelled chance is named, and wrong
names get high confidence. Higher: weak causes are lost, and right names are called `ambiguous`."""

PLAY_NEXT_TO_FRICTION_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 20.0
"""Margin that a play needs next to dry friction about the same axis. The play also fits what the equation of
an axis at rest idealises: a false one had 8 nats in case 72 of the opened split (2026-11). Lower: friction is
named twice, with half of its size. Higher: plays about axes that stick are lost."""

SIGNIFICANT_STD_ERRORS: Final[Annotated[float, "standard errors", THEORY]] = 2.0
"""Distance from its neutral value at which a parameter is significant: a 95 % interval. Higher: weak causes
are lost. Lower: causes are named whose interval contains nothing."""

WALD_OVERRIDE_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 50.0
"""Margin above which an effect is significant whatever its Wald test: the standard error of friction that
holds an axis describes more friction, not less (Hauck and Donner, J. Am. Stat. Assoc. 72 (1977) 851). Ten
standard errors if both tests are valid. Lower: sizes are named whose interval contains nothing. Higher: held
axes are missed."""

ALTERNATIVES: Final[Annotated[int, "effects, groups of terms", JUDGEMENT]] = 2
"""Rivals for one place that are refitted. They are other effects in the place of a cause, effects on a
spline's channel before the spline may displace them, and groups of terms with the same channel and
quantities. Fewer: confidences are too high, and a smooth curve displaces the listed effect that it imitates.
More: time, and shapes of one dependence displace another quantity that is the true one."""

SPLINE_MARGIN: Final[Annotated[float, "1", JUDGEMENT]] = 0.2
"""Share of its own margin by which a spline must beat the best effect to be accepted instead: a spline also
fits what the effect's equation idealises. Lower: listed causes are called unexplained. Higher: unlisted
causes get the name of the closest effect."""

SPLINE_MIN: Final[Annotated[float, "nats", JUDGEMENT]] = 20.0
"""Least margin of a spline, and least lead over the best effect: 76 splines are tried in each round. Sides
as for `SPLINE_MARGIN`."""

CANDIDATES_TRIED: Final[Annotated[int, "tests", THEORY]] = 60
"""Number of tests in the penalty for multiple testing, ln(60) = 4 nats: about the size of the catalogue.
Only its logarithm matters."""

SPLINE_COEFFICIENT_WEIGHT: Final[Annotated[float, "1", JUDGEMENT]] = 0.5
"""Share of a free parameter that a spline's coefficient counts in the BIC penalty: priors and overlapping
basis functions leave about half of them free. Lower: splines beat effects. Higher: the reverse."""

JOINT_MIN_NATS: Final[Annotated[float, "nats", THEORY]] = 2.0
"""Score on the fitted flights from which on an effect is also scored on all flights together: two standard
errors. Lower: time, 0.2 s per diagnosis. Higher: effects are missed that each flight shows weakly."""

HELD_OUT_AGAINST: Final[Annotated[float, "nats", JUDGEMENT]] = -4.0
"""Log-likelihood ratio on held-out flights below which they contradict a cause, and it is removed: 50 to 1.
Lower: peculiarities of one flight are named. Higher: causes are lost that a weak flight hardly shows."""

SPLINE_HELD_OUT_NATS: Final[Annotated[float, "nats", THEORY]] = 0.0
"""The same for a spline: even odds, because no physics supports a smooth curve. Lower: splines that follow a
peculiarity of one flight stay, and the verdict is `unexplained`. Higher: unlisted causes are lost."""

# Terms of the baseline that are absent.

ABSENT_MIN_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 15.0
"""Gain from which on the model is estimated without a tightly specified term: by the score test, or from the
prior against which the fit shrank its parameter. Lower: time. Higher: absent terms are not tried."""

ABSENT_SHARE_RANGE: Final[Annotated[tuple[float, float], "1", JUDGEMENT]] = (0.2, 5.0)
"""Shares of a term by which the score test may remove it: the whole, as far as a first-order test shows it.
Narrower: absent terms are not tried. Wider: time."""

TIGHT_TOLERANCE: Final[Annotated[float, "1", JUDGEMENT]] = 0.5
"""Relative tolerance below which a prior keeps a parameter away from zero, so that only a refit without the
term shows its absence: rig files specify lengths tightly and frictions loosely."""

PRESENT_MIN_STD: Final[Annotated[float, "1", JUDGEMENT]] = 0.5
"""Least standard deviation of the parameter of a term that is present, as a share of the rig file's value:
that of a tolerance of 100 %, which rig files state for frictions. Lower: a parameter that deviates from a too
tight file is called absent. Higher: absent terms need more precise flights."""

ABSENT_MIN_CONFIDENCE: Final[Annotated[float, "1", MEASUREMENT]] = 0.8
"""Probability from which on a term is named as absent. Frictions of 0.03 to 0.08 of the rig file's value
reach 0.57 in four slow logs (seeds 9022, 9154, 9186 and 9203 of `tests.field.slow_logs`, 2026-11); absent
terms reach 0.97. Lower: small frictions are called absent. Higher: absent terms that the flight hardly shows
are not named."""

ABSENT_MIN_STD: Final[Annotated[float, "1", THEORY]] = 1e-3
"""Least standard error of a parameter, as a share of the rig's value: a fit keeps parameters that cannot be
negative this far from zero. Lower: an absent term would be estimated as small."""

# Residual analysis and verdict.

NOISE_FLOOR: Final[Annotated[float, "standard deviations of the quantisation", MEASUREMENT]] = 1.04
"""Root mean square free-run error on all flights up to which nothing is missing. Exact models reach 1.00 to
1.02 on simulated flights (2026-11). Lower: the integration error, a tenth of a mN m, is called unexplained.
Higher: small unlisted terms are missed."""

MATTERS_COUNTS: Final[Annotated[float, "encoder counts", JUDGEMENT]] = 0.1
"""Root mean square change of the 2 s open-loop prediction, or of its error on held-out flights, from which on
a significant effect is named: a third of the quantisation's standard deviation. A sag of 0.005 per volt
changes 0.085 counts, a delay of 30 ms 4.7 (development seeds 7000 of `heli_benchmark.runs.calm`, 2026-11).
Lower: numerical errors are named in flights without disturbances. Higher: weak causes are not named."""

MATTERS_NATS_PER_ROW: Final[Annotated[float, "nats", MEASUREMENT]] = 0.5
"""Log-likelihood ratio for each measurement of the filter above which a cause matters without a free run: it
changes the innovations by one standard deviation of their noise. This is at least 0.19 counts, by a sag that
has 120 nats in 1500 measurements and changes 0.075 counts (development seed 7003, 2026-11). Lower: small
effects in long flights are named. Higher: time, one free run for each of several causes."""

DISTURBED_STD: Final[Annotated[float, "standard deviations of the quantisation", THEORY]] = 5.0
"""Root mean square free-run error, disturbances included, above which every significant effect matters: the
least significant has 5.3 standard errors in 850 innovations, a fifth of the disturbances, or 0.28 counts.
Lower: effects below `MATTERS_COUNTS` are named in weak disturbances. Higher: time, one free run for each
cause."""

DEPENDENCE_NATS: Final[Annotated[float, "nats", MEASUREMENT]] = 10.0
DEPENDENCE_NATS_PER_COEFFICIENT: Final[Annotated[float, "nats", MEASUREMENT]] = 2.0
"""Log-likelihood ratio that a regressor of the innovations must gain, and more of it for each coefficient.
In theory, the best of 130 tests on white innovations exceeds 6.3 nats with one coefficient and 14 with 8 in
5 % of all cases. 6 more with one and 12 more with 8 are for disturbances that are not Gauss-Markov, and for
small errors of a named cause (19 nats with 6 coefficients in a field case, 2026-11). Lower: disturbances
become `unexplained`. Higher: unmodelled dynamics are taken for disturbances; an unlisted term under strong
disturbances of a field case has 18 nats."""

NEAR_REST_NATS: Final[Annotated[float, "nats", MEASUREMENT]] = 20.0
"""Additional gain that a function of an axis' own rate near rest needs, as a regressor and as an equation's
term. The encoder of a resting axis repeats its count, which the filter takes for a torque towards rest (22
nats in two of ten field cases without friction, 2026-11). Lower: disturbances become `unexplained`. Higher:
axes that stick are missed, unless the catalogue has their friction."""

RESOLVED_REST_COUNTS: Final[Annotated[float, "counts", MEASUREMENT]] = 2.0
UNRESOLVED_REST_NATS: Final[Annotated[float, "nats", MEASUREMENT]] = 120.0
"""Counts per measurement by which an axis must turn at the rates near rest for `NEAR_REST_NATS` to suffice,
and the gain that is needed otherwise. In nine simulated flights without friction, it was 0.8 to 0.9 counts.
Counts that repeat then looked like a torque of 0.6 to 3 mN m towards rest, with 44 to 83 nats (2026-12).
Lower: gusts about pitch are `unexplained`. Higher: as above."""

KICK_STD_ERRORS: Final[Annotated[float, "standard errors", JUDGEMENT]] = 6.0
"""Impulse at one instant that is reported as a kick, in robust standard errors: by chance one of a hundred
million instants. It decides a sentence, not the verdict. Lower: gusts are called kicks. Higher: kicks are
called gusts."""

RANDOM_TORQUE_MIN_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.1
"""Share of its typical size from which on a random torque about a single axis is named. Lower: integration
errors are called a random torque. Higher: weak random torques count as disturbances."""

RANDOM_TORQUE_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 15.0
"""Log-likelihood ratio of the disturbances about one axis above which they may be a cause, if those about
both other axes are below: disturbances about several axes are no single cause. Lower: discretisation errors
are called a random torque. Higher: weak ones are missed."""

RANDOM_TORQUE_MIN_CORRELATION_s: Final[Annotated[float, "s", MEASUREMENT]] = 0.05
"""Correlation time from which on a disturbance may be a cause: a little more than a measurement interval of
the filter, 0.04 s. Random torques of 0.1 s are estimated at 0.072 s to 0.099 s on three development flights
(`python -m tests.diagnose.calibration`, seeds 6200 to 6208, 2026-11). Dry friction that the catalogue lacks
leaves torques of 0.044 s to 0.118 s on four. It is not named there, because those torques depend on the
motion. Lower: weak friction that holds an axis is called a random torque. Higher: the shortest random torques
of the catalogue's grid are missed."""

CORRELATE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.3
"""Share of the best spline's score from which on a quantity is listed in `correlates_with`. It decides the
length of a list."""

DETECTION_STD_ERRORS: Final[Annotated[float, "standard errors", THEORY]] = 5.0
"""Typical size of a detectable effect: its penalty (BIC with multiple testing) requires 4 to 5. Lower:
effects count as detectable that would be missed. Higher: more effects are listed as undetectable."""

FALSE_DISCOVERY_RATE: Final[Annotated[float, "1", THEORY]] = 0.05
"""Expected share of false ones among the cells in which a model is said to fail: a convention. Higher:
disturbances are outlined. Lower: regions that a flight visits briefly are not."""

PRIOR_CONFLICT_STD: Final[Annotated[float, "standard deviations of the prior", THEORY]] = 3.0
"""Distance from its prior mean at which a parameter is reported: by chance one of twenty parameters in 18
flights. Lower: lines without consequence. Higher: a parameter that replaces what the model lacks, or a wrong
rig file, is not reported."""

# Confidence.

MAX_CONFIDENCE: Final[Annotated[float, "1", JUDGEMENT]] = 0.99
"""No flight makes a name more certain than the class of models is."""

CONFIDENCE_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 15.0
"""Lead over the closest alternative that divides the doubt by e: ratios ignore the error of the noise model.
Lower: close decisions get too much confidence. Higher: clear ones too little."""

HELD_OUT_NATS: Final[Annotated[float, "nats", JUDGEMENT]] = 2.0
"""Log-likelihood ratio on held-out flights that multiplies the odds by e: ratios ignore that disturbances
change from flight to flight."""

CONFIDENCE_RANDOM_TORQUE: Final[Annotated[float, "1", JUDGEMENT]] = 0.8
"""Confidence of a random torque: rare unmodelled dynamics pass the whiteness test. A cause with a lower
confidence is stated with "perhaps"."""

CONFIDENCE_FACTOR_UNEXPLAINED: Final[Annotated[float, "1", JUDGEMENT]] = 0.69
"""Factor on the confidence of causes if something unexplained remains that they may imitate: odds of about
two to one, because an imitation fits held-out flights too. On development flights with an effect that the
catalogue lacks, three of four names are true (`python -m tests.diagnose.calibration`, seeds 6000 to 6041,
2026-11): too few for a measured value. 1: false causes pass with high confidence. Lower: true causes are not
believed."""

MAX_CONFIDENCE_UNCONFIRMED: Final[Annotated[float, "1", MEASUREMENT]] = 0.875
"""Largest confidence of a cause that is not confirmed: the rule of succession for six of six right names
among the most confident ones of `tests/diagnose/confidence.py` (2026-11). Fresh seeds have 26 of 26. Lower:
right causes of a single flight are not believed. Higher: a false step of thrust had 0.99."""

CLEAR_CONFIDENCE: Final[Annotated[float, "1", MEASUREMENT]] = 0.95
"""Confidence that a cause would have with confirmation, from which on it is clear without: 35 of 35 such
causes are right. Lower: causes whose measured share is smaller count as clear. Higher: right ones are
doubted."""

MAX_CONFIDENCE_UNCLEAR: Final[Annotated[float, "1", MEASUREMENT]] = 0.74
"""Largest confidence of a cause that is neither confirmed nor clear: the rule of succession for 19 right
ones of 25 in `tests/diagnose/confidence.py` (2026-11). The bins below `CLEAR_CONFIDENCE` are pooled,
because more confident causes were not more often right: 7 of 13 from 0.7 to 0.95. Lower: right causes are
not believed. Higher: false ones are."""

# Equations of what the catalogue lacks.

EQUATION_MAX_TERMS: Final[Annotated[int, "terms", JUDGEMENT]] = 3
"""Terms of a proposed equation: four terms are a curve by another name."""

EQUATION_FINALISTS: Final[Annotated[int, "groups of terms", JUDGEMENT]] = 4
"""Groups of terms that are refitted in a round. Fewer: one first-order score decides. More: time."""

EQUATION_MIN_SPLINE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.5
"""Share of the gain of spline terms that an equation in their place must gain. Lower: an equation is
proposed that explains the smaller part of what is missing. Higher: equations that the grammar only
approximates are not."""

EQUATION_MAX_UNCONFIRMED: Final[Annotated[float, "1", THEORY]] = 0.5
"""Highest confidence in an equation that no other flight confirmed: as likely as not."""

EQUATION_SUPPORT_SHARE: Final[Annotated[float, "1", THEORY]] = 0.5
"""An equation matters where it is above this share of its largest value. The report gives this range of its
quantities."""

# Evaluation on another flight.

CALIBRATE_s: Final[Annotated[float, "s", JUDGEMENT]] = 8.0
"""Free flight from which constants of a validation flight are estimated: four windows.
Shorter: what a model lacks is taken for a constant. Longer: less is left to evaluate."""

CALIBRATE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 1.0 / 3.0
"""Largest share of a flight's free seconds for the calibration. Higher: a short flight is evaluated on a
window or two. Lower: its constants are not known."""

VOLTAGE_TAIL: Final[Annotated[float, "1", JUDGEMENT]] = 0.01
"""Share of the fitted flights' voltages beyond each end of the range in which the model counts as fitted:
brief extremes inform no thrust curve. Lower: a single step of the voltages widens the range. Higher: voltages
that the flights do show count as extrapolation."""

OUTSIDE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.1
"""Share of a window's time with voltages outside of that range from which on its prediction is marked: by the
tails alone, two rotors have 0.04. Lower: windows of the fitted flight would be marked. Higher: extrapolations
are not marked."""

# Standard errors that are reported, and that decide whether a size differs from zero.

TIME_STD_FACTOR: Final[Annotated[float, "1", MEASUREMENT]] = 1.4
"""Factor on the standard error of times. A controller answers within a step to what the filter has not seen
yet: lags come out short under fast disturbances, by 1.4 ms +- 1.1 ms on eleven simulated flights at 500 Hz
(2026-11). Steps of 5 ms would avoid it, but take twice the time. Lower: intervals of lags miss the truth.
Higher: they are wider than the flights justify, and short delays are not named."""

MIN_STD_SHARE: Final[Annotated[float, "1", MEASUREMENT]] = 0.007
"""Least standard error, as a share of an effect's size. Steps of 10 ms blur what changes within them: the
quadratic share of thrust comes out 1.2 % too large on simulated flights without disturbances, 0.2 % with
steps of 5 ms (2026-11). Lower: intervals miss the truth. Higher: they are wider than the flights justify."""

MIN_STD_COUNTS: Final[Annotated[float, "counts", MEASUREMENT]] = 0.5
"""Least standard error of what lies between an axis and its encoder. An axis that turns back within a count
is not seen: backlashes have errors up to 0.9 counts, of either sign (eight of nine simulated flights within
one standard error, 2026-11). Lower: intervals of backlashes miss the truth, and a play of 0.4 counts is
named next to dry friction. Higher: intervals are too wide, and small plays are missed."""

# What a report shows.

SHORT_s: Final[Annotated[float, "s", JUDGEMENT]] = 15.0
"""Free flight below which another experiment is proposed, residuals are not tested on held-out flights, and a
caution is given: fewer than eight windows of 2 s, whose resampled ratio has no meaningful quantiles. Lower:
short flights get no proposal. Higher: time, an experiment is simulated."""

MANY_UNDETECTABLE: Final[Annotated[int, "effects", JUDGEMENT]] = 12
"""Undetectable effects above which another experiment is proposed: a third of the catalogue. A flight of
`heli-host fly identify` leaves 2."""

CURVE_SHARE: Final[Annotated[float, "1", JUDGEMENT]] = 0.8
"""Share of a term's variance that a smooth curve of one quantity must follow for the term to be drawn over
that quantity: the eye sees such a curve. Below, the missing torque is drawn over the term's value."""


@dataclass(frozen=True)
class Threshold:
    """A constant of this file, as a row of the table of thresholds."""

    name: str  # Name of the constant
    unit: str  # Unit of the value; ``1`` for a pure number
    value: Any  # Value in the unit; a pair is a range
    source: Source  # Whether the value comes from theory, measurement or judgement


def table() -> Iterator[Threshold]:
    """Yield all thresholds in the order of this file."""
    for name, hint in get_type_hints(sys.modules[__name__], include_extras=True).items():
        annotated = get_args(hint)[0] if get_args(hint) else None
        match getattr(annotated, "__metadata__", None):
            case (str(unit), Source() as source):
                yield Threshold(name, unit, globals()[name], source)


if __name__ == "__main__":
    for row in table():
        print(f"{row.name:33} {row.value!s:12.12} {row.source.value:12} {row.unit}")
