"""Thresholds of identification: the meaning, unit and source of each, and the effect of other values.

"Set by judgement" means that no measurement is on record. "Measured flights" are the eight flights of
docs/validation/measured-flights.md; "coverage" is the count of `make bench` over 50 rigs drawn from
their tolerances.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

# --- The free flight in a log -------------------------------------------------------------------------------

TABLE_MARGIN_DEG: Final = 1.5
"""Elevation above the table that still counts as contact, deg. Set by judgement. Lower, bounces are
fitted as flight; higher, low flight is lost."""
TAKE_OFF_DEG: Final = 10.0
"""A take-off or landing is over only this far above the table, deg. Set by judgement. Lower, the cushion
of air near the table is fitted as lift; higher, slow climbs are lost."""
TAKE_OFF_TAIL_S: Final = 1.0
"""Cut after a take-off is over, s. Set by judgement: several times the rotors' lag of 0.1 s."""
TAKEN_BACK: Final = 0.6
"""Share of the usual sum of the voltages below which the last moments of a flight are a landing. A measured
log that ends in the air ends with 0.04 of it; the others' last moments hold 0.7 and more."""
TAKEN_BACK_FROM: Final = 0.85
"""Share of it from which on the descent before those moments is counted as part of the landing. Set by
judgement: lower leaves the first of it in, higher cuts flight away."""
LANDING_TAIL_S: Final = 0.3
"""Time over which these shares are means, s: three times the rotors' lag."""
LANDING_DEG: Final = 5.0
"""How far below the usual elevation a flight must end to have landed in the air, deg. Set by judgement."""
ROTOR_m: Final = 0.1
"""How far a rotor reaches beyond its axle, m: propellers of rigs of this kind are 0.2 m and more across.
Found on measured flights, two of which strike the table with a leaning arm; 0 takes those strikes for
flight."""
STOP_MARGIN_DEG: Final = 1.0
"""Angle before a mechanical stop that counts as contact, deg. Set by judgement, as `TABLE_MARGIN_DEG`."""
MAX_UNSURE_DEG: Final = 3.0
"""Largest part of a table's or a stop's tolerance that counts, deg. Set when the Quanser rig's tolerances
were widened to the difference between two courses: more cuts free flight near the stops away, less keeps
contacts."""
BEYOND_STOP_DEG: Final = 5.0
"""Beyond a stop by more than its tolerance and this, deg, the rig file's stop is disbelieved and noted.
Set by judgement."""
AROUND_STOP_S: Final = 0.3
"""Cut on either side of a contact with a stop, s. Set by judgement: several times the rotors' lag."""
MIN_MOTION_COUNTS: Final = 10
"""Encoder counts an axis must span to have moved. Set by judgement: noise and drift give one or two."""
MIN_SEGMENT_S: Final = 1.0
"""Shortest stretch of free flight that is fitted, s. Set by judgement: a shorter one has more unknown
initial states than it shows of the parameters."""
JUMP_RAD: Final = 1.0
"""A move between two rows that no arm makes, rad: an angle that was not unwrapped jumps by 2 pi. Set by
judgement; at 500 Hz it is 500 rad/s."""
MAX_STRAY_STEPS: Final = 5.0
"""Steps by which times may stray from an even clock. Five steps of 2 ms at the fastest travel are half a
degree: far more than any other error. Below 1, times printed in whole milliseconds are refused."""

# --- Windows and their initial states -----------------------------------------------------------------------

BLOCK_S: Final = 0.01
"""Windows are whole numbers of blocks about this long, s, whatever the step, so that means over blocks
exist."""
STATE_FIT_S: Final = 0.15
"""Half the stretch that a parabola through the angles is fitted over for a window's first guess, s. Set
by judgement: shorter, the quantisation makes the rate wrong; longer, the acceleration is no longer
constant."""
SHORT_FIT_S: Final = 0.05
"""The same for another guess, which no jump of a torque nearby bends, s. Set on flights with dry friction
and backlash (tests/identify/test_window_states.py)."""
RUN_IN_S: Final = 1.0
"""Free run before a window that the states of effects are taken from, s: several times the slowest rotor
lag. Set by judgement; half of it leaves 0.1 % of a lag of 0.07 s."""
STATE_STD: Final[Mapping[str, float]] = {"rad": 0.02, "N m": 0.1}
"""Prior standard deviation of an effect's state at a window's beginning, by its unit. Set by judgement:
twice a usual backlash, several usual torques. Much smaller ties a window to a wrong run-in; much larger
leaves it open."""
STATE_STD_V: Final = 0.15
"""The same for a rotor's thrust, V. Left open, each window of a measured flight took the thrust that
suited it, and a lag of 0.12 s came out as 0.13 to 0.35 s. At 0 the error of the run-in biases the lag."""
FAR_RAD: Final = 0.1
"""Rms error of the first prediction, rad, beyond which short windows are fitted first. Set on measured
flights, with `SHORT_WINDOW_S`; larger lets long windows diverge, smaller only costs time."""
SHORT_WINDOW_S: Final = 0.4
"""Windows of that first fit, s. From 0.7 standard deviations of the rig file `quanser-course`, one fit in
four of measured flights diverged in windows of 2 s; with these before them, none of forty did."""

# --- Noise of the residuals ---------------------------------------------------------------------------------

LONGEST_LAG_S: Final = 0.5
"""Bartlett window of the long-run (HAC) variance, s. Set by judgement, confirmed by coverage (94.9 % of
estimates within two standard errors). Shorter, standard errors are too small where a model is wrong;
longer, they scatter."""
MIN_SHARE: Final = 0.5
"""Share of the largest unexplained variance of an axis, in rad^2, that every axis is given at least. At 0
pitch had twice the error on measured flights; 0.25 at first, raised when the tolerances of the Quanser
rig were widened; at 1 all axes weigh alike."""
MIN_VARIANCE: Final = 0.05
"""Mean square over a block that quantisation alone leaves at least, in its variances; keeps an axis at
rest from weighing all. Set by judgement: a constant angle would otherwise have a likelihood without
bound."""
OUTLIER: Final = 3.0
"""A window whose rms residual is this many times the median window's loses weight. Set by judgement:
lower discards honest windows of a wrong model, higher lets one disturbed window decide."""
GROSS: Final = 10.0
"""Beyond this many times the median, a window counts less the larger its error is: a person touched the arm.
Set on a flight with a disturbed window, which must neither decide the fit nor widen its errors; with
`OUTLIER` alone each such window counts as one at that limit."""
WHITE_LAG_S: Final = 0.1
"""Lag at which a residual's autocorrelation is tested, s. Set by judgement: shorter lags see the
quantisation, which stays for several samples, longer ones only the slowest errors."""

# --- The solver ---------------------------------------------------------------------------------------------

ROUNDS: Final = 8
"""Most updates of the weights on the coarse grid. Set when dry friction had to be found from none; fewer
end a fit before its weights are final, more only cost time."""
ROUGH_ROUNDS: Final = 3
"""First rounds, in which weights are rough, four steps are enough, and multimodal parameters stay where
they are. Set on a periodic torque whose frequency ran away while its amplitude was still wrong."""
FINE_ROUNDS: Final = 4
"""Most updates of the weights on every sample. Set with `ROUNDS`."""
ROUGH_STEPS: Final = 4
"""Most steps of a rough round. Set by judgement: more are lost when the weights change."""
COARSE_STEPS: Final = 30
"""Most steps of a later round on the coarse grid. Set by judgement; it is hardly ever reached."""
FINE_STEPS: Final = 10
"""Most steps of a round on every sample. Set by judgement: the coarse fit is near."""
SETTLED_CHANGE: Final = 0.15
"""Weights are final when no variance changed by more than this share. Set by judgement: standard errors
go with the root, so 7 % at most is left; smaller costs rounds that change no digit."""
SMALL_STEP: Final = 0.02
"""A step is small when no parameter moves by more of its standard error. Set by judgement; what is left
of a fit is then well inside its error. An undamped step of parameters and states together that is shorter,
measured by what it takes off the cost, is not taken."""
LARGEST_DAMPING: Final = 1e8
"""Levenberg-Marquardt damping beyond which a fit gives up, in units of the priors' precision. Set by
judgement: steps are then smaller than any digit printed."""
STATE_DAMPING: Final = 0.01
"""Damping of the initial states, as a share of their own diagonal, for each unit of the parameters'. Set
so that dry friction is found from a start without any: at 0 only the parameters take small steps."""
MIN_DAMPING: Final = 0.05
"""Damping below which it is set to 0, and Gauss-Newton steps are whole. Set by judgement."""
LEFT_BEHIND: Final = 1.1
"""A window whose cost grows by this factor in a step did not follow it, and its states are optimised
alone. 1.5 at first; lowered when dry friction had to be found from none. Higher, one lost window makes
the whole step be rejected; lower costs evaluations."""
LEFT_BEHIND_SHARE: Final = 1e-3
"""And by this share of the whole cost. Set by judgement: less is not worth an evaluation."""
IDLE_GAIN: Final = 1e-3
"""A fit whose cost falls by less than this share in each of two steps has converged, small steps or not.
Set on flights with backlash and dry friction, whose kinks keep steps from ever being small. On every
sample a fifth of it."""
CONVERGED_GAIN: Final = 1e-6
"""An undamped step that gains less than this share ends a fit; with a small step `IDLE_GAIN` does. Set by
judgement."""
WORTHWHILE: Final = 0.99
"""Where re-optimised or restarted states lower the cost below this share, the fit goes on from them. Set
by judgement."""
RESTART_OUTLIER: Final = 1.5
"""A window whose mean square is this many times the median window's starts again from other states. Set
on backlash of travel and sticking axes, whose windows may converge to a wrong minimum; lower restarts
sound windows, higher leaves wrong ones."""
TOO_WRONG: Final = 9.0
"""Mean square of the median window, in variances of the quantisation, above which the model is to blame
and no window restarts. Set by judgement: higher spends restarts that cannot help, lower leaves
windows at a wrong minimum in a model that is only somewhat wrong."""
RESTARTS: Final = 2
"""Turns of restarts: in the second, the window before may have left its own wrong basin."""
WEIGHT_TURNS: Final = 3
"""Turns between variances and robust weights, so that an outlier does not widen what it is measured
against. Set on a flight with a disturbed window; the loop ends sooner where no weight changes."""
SINGULAR_GUARD: Final = 1e-12
"""Added to a block's diagonal, as a share of its largest entry, so that a state that no data show keeps
the block regular. Set by judgement, far above the rounding of doubles and far below any information."""
WINDOW_DAMPING: Final = 1e-3
"""First damping of a window whose states are optimised alone, as a share of its diagonal. Set by
judgement."""
WINDOW_GAIN: Final = 0.01
"""Share of the windows' cost that a step must gain to be worth another. Set by judgement."""
WINDOW_PATIENCE: Final = 2
"""Steps without that gain before windows stop. Set with `RESTART_PATIENCE`."""
RESTART_PATIENCE: Final = 5
"""The same for windows that start from elsewhere: damping has to grow before they find a way. Set on
backlash of travel."""

# --- Uncertainty and what is reported -----------------------------------------------------------------------

DITHER_PHASES: Final = 24
"""Random phases of the counts by which the effect of quantisation on the estimates is simulated. Set by
judgement: their scatter is known to 15 %; more cost time in proportion."""
UNINFORMED: Final = 0.9
"""A parameter whose standard error is above this share of the prior's is uninformed by the flights. Set
by judgement: at 0.9 the flights hold a fifth of the information."""
COMBINATION_WEIGHT: Final = 0.25
"""Smallest part that a parameter has in a combination, of the largest. Set by judgement, for legibility
only."""
STRONG_CORRELATION: Final = 0.9
"""Correlation beyond which a pair is reported. Set by judgement, for legibility only."""
UNEXPLAINED: Final = 0.6
"""Share of the motion of the best axis (rms, no unit) above which the voltages do not explain a flight; see
`explained.py`. Flights leave at most 0.22 (practice), 0.27 (measured machines), 0.45 (field), 0.18 (a hover
of 12 s, one parameter free) and 0.47 (a hover in the strongest disturbances of heli_benchmark). 176 flights
of noise, white to twice integrated, leave 0.67 and more. On other seeds hovers leave at most 0.41, and 80
flights of noise 0.72 and more. Lower refuses hovers in disturbances; higher accepts slow noise. One of three
hovers in five times as strong disturbances leaves 0.61."""
MIN_MOTION: Final = 1.7
"""Motion of an axis without its parabolas that is looked at, rms, in standard deviations of the quantisation:
half a count. Quantisation alone has 1. Lower, an axis at rest decides by chance; higher, slow axes are left
out."""
NOTHING_LEFT: Final = 1.05
"""A normalised error up to here is quantisation alone. Coverage saw none above 1.01 on flights that no
fit saw; the rest is room for encoders that are not quite even."""
MIN_OF_PRIOR: Final = 1e-3
"""Lower bound of a number that cannot be negative, as a share of its value beforehand: a rig without a
length or a gain cannot be. Set by judgement; an estimate on this bound is reported as such."""
