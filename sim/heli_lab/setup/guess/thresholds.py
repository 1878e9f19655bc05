"""Thresholds of the guess, each with its unit, its source and the effect of other values.

"Measured flights" are the eight flights of docs/validation/measured-flights.md. "Simulated flights" are
those of `python -m tests.guess`.
"""

from __future__ import annotations

from typing import Final

SAMPLE_STEP_s: Final = 0.01
"""Step of the resampled signals [s]. Set by judgement: far shorter than any motion of the arm."""
CUTOFF_Hz: Final = 1.5
"""Corner of the low-pass filter before differentiation [Hz]. Set on measured flights: at 3 Hz the
quantisation of 50 Hz logs hides elevation, at 0.7 Hz the pitch loop is filtered out."""
EDGE_S: Final = 0.7
"""Time that is ignored at both ends because of the filter's transients [s]: one period of the corner."""
LAGS_S: Final = (-0.24, 0.5, 0.02)
"""Lags between cause and acceleration that are compared: first, end, step [s]. Rotors lag by 0.05 to 0.2
s."""
ROLE_LAGS_S: Final = (0.0, 0.06, 0.12, 0.2)
"""Lags that are compared while columns are assigned to roles [s]."""
INDEPENDENT_SAMPLES_Hz: Final = 1.0
"""Independent samples per second in filtered residuals. A third of what the filter's bandwidth gives, because
model errors are slow. Set by judgement: a higher value overstates every certainty."""
DECISIVE_NATS: Final = 6.0
"""Log-likelihood ratio from which on a choice is sure [nats]: 400 times as likely. Below it, the guess
reports an ambiguity. Set by judgement, checked with 200 distorted flights."""
CANDIDATE_MARGIN_NATS: Final = 25.0
"""Assignments of columns within this margin of the most likely one are compared by their units, too [nats].
An assignment without plausible units loses about this much. A higher value takes longer, a lower one neglects
the units."""
MAX_CANDIDATES: Final = 12
"""Largest number of assignments whose units are compared."""
NAME_NATS: Final = 8.0
"""Log-likelihood of a column's name [nats]. Above `DECISIVE_NATS`: a name is sure if the motion does not
contradict it, and an ambiguity if it does."""
KNOWN_NATS: Final = 1000.0
"""Log-likelihood of a column that the user's profile states [nats]: above that of every motion."""
DERIVED_SIGNAL_NATS: Final = 12.0
"""Penalty of a column whose name means a setpoint, a rate or an estimate [nats]: a setpoint that is followed
well obeys the same equations as the angle."""
FEEDBACK_MATCH: Final = 0.8
"""Share of a sum's variance that the rate of elevation explains, from which on the sum counts as state
feedback. Encoder noise takes up to 15 % in weakly excited flights; other controllers give less than 60 %."""
FEEDBACK_NATS: Final = 4.0
"""Reward of a sum of the voltages that is proportional to the rate of elevation [nats]. State feedback
gives such a sum, and its motion then shows no cause. Below `DECISIVE_NATS`: such a column stays in doubt."""
ENCODER_NATS: Final = 10.0
"""Reward of an angle column that is quantised by an encoder of the rig [nats]. Estimates, setpoints and rates
move like angles but are not quantised. Above `NAME_NATS`."""
SIGN_CHANGE_NATS: Final = 1.0
"""Log-likelihood of each further sign or exchange of motors that differs from the usual ones [nats]. Set by
judgement: one sign in four is turned. Higher values ignore the travel torque, lower ones follow it alone."""
UNIT_NATS: Final = 6.0
"""Log-likelihood of a stated unit [nats]. Accelerations that fit another unit much better overrule it."""
GAIN_STD: Final = {"elevation": 0.5, "pitch": 0.7, "travel": 0.4}
"""Standard deviation of the logarithm of measured over modelled gain. On measured flights this logarithm is
up to 0.87 on pitch, 0.57 on elevation and 0.45 on travel. Smaller values give wrong units with a rough rig
file, larger ones do not distinguish counts from degrees."""
HOVER_STD: Final = 0.25
"""Standard deviation of the logarithm of measured over modelled hover voltage. Measured and simulated flights
are within 0.15."""
MAX_DEVIATION_STD: Final = 3.0
"""Deviation from the rig file, in standard deviations, from which on the guess reports that no unit fits."""
REST_TOLERANCE_DEG: Final = 4.0
"""Largest difference between elevation at rest and the rig file's table angle, in addition to its tolerance
[deg]. Measured flights rest at -30.0 and -30.4 deg. Rest and level differ by 25 deg, so any value between 2
and 10 distinguishes them."""
REST_DURATION_S: Final = 0.1
"""A flight begins on its table if it rests this long at its lowest elevation [s]. Measured flights are logged
from full voltage on, and rise after 0.2 s."""
RATE_MATCH: Final = 0.9
"""Share of a column's variance that another column's derivative explains, from which on it counts as a
rate."""
MAX_TRAVEL_LAG_S: Final = 0.08
"""Lag from pitch to travel from which on the guess doubts the times of travel [s]. Measured and simulated
flights have -0.04 to 0.06 s by this estimate."""
MAX_LAG_DIFFERENCE_S: Final = 0.11
"""Difference between the lags of elevation and pitch from which on the guess doubts the times of elevation
[s]. Seven of eight measured flights have up to 0.08 s. A higher value hides delays, a lower one doubts weakly
excited flights."""
MAX_DECISIVE_LAG_S: Final = 0.07
"""The same difference if the flight decisively excludes that elevation lags like pitch. Simulated flights
without a delay have up to 0.06 s."""
PLAUSIBLE_LAGS_S: Final = (0.02, 0.28)
"""Plausible lags from voltages to angles [s]: rotors of 0.05 to 0.2 s, and the error of the estimate.
Outside, the voltages were logged at other times than the angles, and the guess reports an ambiguity. Voltages
that are delayed by as much as slow rotors lag are just below the lower end, and so are flights of simulations
without a rotor lag; `no_rotor_lag_nats` distinguishes the two."""
ROTOR_LAG_CUTOFF_Hz: Final = 5.0
"""Corner of the low-pass filter of the test for a rotor lag [Hz]. At `CUTOFF_Hz`, a lag looks like a delay.
On four simulated flights, this corner separates flights with and without a lag by 12 nats; 3 Hz by 5."""
ROTOR_LAGS_s: Final = (0.05, 0.07, 0.1, 0.15)
"""Time constants of rotors that this test compares with rotors without a lag [s]."""
SIMULATED_S: Final = 20.0
"""Longest time of a flight that is simulated for each choice of signs [s], from the parts in which pitch
moves most. Set by judgement: simulating all of it takes longer and gives the same result."""
AMBIGUOUS_ERROR_RATIO: Final = 1.15
"""Product of the axes' errors for another choice of signs, over that for the profile, below which the signs
are ambiguous. Wrong choices have 1.3 and more on measured flights. A lower value trusts chance."""
WRONG_SIGN_ERROR_RATIO: Final = 0.5
"""The same ratio below which the signs of a flight to be fitted are wrong. Correcting one sign gives 0.03 to
0.8. The regressions must agree by `DECISIVE_NATS`. A higher value refuses rigs that are only unusual."""
CLIP_SHARE: Final = 1.02
"""Share of the supply from which on a voltage is a command before saturation. Rounding stays below it."""
MIN_CLIPPED_SHARE: Final = 0.002
"""Share of rows beyond the supply from which on the fits use limited commands. Fewer rows change no gain."""
MAX_CLIPPED_SHARE: Final = 0.5
"""Share of rows beyond the supply from which on the supply differs from the rig file's, so that no limit is
set. Set on simulated flights: control loops with commands beyond the supply for 40 % of the time still
fly."""
