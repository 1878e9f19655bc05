"""Compare the motion with a rig: its gains at hover, and regressions of accelerations on their causes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig
from heli_sim.rig.rig import counts_per_turn

from heli_lab.errors import IdentifyError
from heli_lab.setup.guess.names import AXES, SUMS
from heli_lab.setup.guess.result import DECISIVE_NATS, Ambiguity
from heli_lab.setup.guess.signals import SAMPLE_STEP_s, Signal, Signals, delay, filtered_signal, lagged

_MIN_STIFFNESS_STD: Final = 1.0
"""Smallest standard deviation of a stiffness [1/s^2]. Measured rigs have a pitch stiffness of -0.3 to -1.4,
and their rig files state 0."""
_MIN_REGRESSION_ROWS: Final = 20
"""Smallest number of rows of a regression; it has four coefficients."""
_DECIMATION: Final = 10
"""The regressions use every tenth row: 10 Hz samples all that the low-pass filter leaves."""
_INDEPENDENT_SAMPLES_Hz: Final = 1.0
"""Independent samples per second in filtered residuals. A third of what the filter's bandwidth gives, because
model errors are slow. Set by judgement: a higher value overstates every certainty."""
_LAGS_s: Final = tuple(round(0.02 * number, 2) for number in range(-12, 25))
"""Lags between cause and acceleration that are compared [s]. Rotors lag by 0.05 to 0.2 s."""
REST_DURATION_S: Final = 0.2
"""A flight begins on its table if it rests this long at its lowest elevation [s]. Measured flights are logged
from full voltage on, and rise after 0.2 s."""
FEEDBACK_MATCH: Final = 0.8
"""Share of a sum's variance that the rate of elevation explains, from which on the sum counts as state
feedback. Encoder noise takes up to 15 % in weakly excited flights; other controllers give less than 60 %."""
_RATE_SCALES: Final = (1.0, 180.0 / np.pi, np.pi / 180.0)
"""Factors between the units of an angle and of its logged rate: equal units, or radians and degrees."""
_UNIT_SLOPE_RANGE: Final = (0.6, 1.5)
"""Range of the measured slope divided by a factor between units. It is wide enough for a rate that the
logging program has filtered, and far narrower than the ratio of two factors, 57.3."""
_MAX_TRAVEL_LAG_S: Final = 0.08
"""Lag from pitch to travel from which on the guess doubts the times of travel [s]. Measured and simulated
flights have -0.04 to 0.06 s by this estimate."""
_MAX_LAG_DIFFERENCE_S: Final = 0.11
"""Difference between the lags of elevation and pitch from which on the guess doubts the times of elevation
[s]. Seven of eight measured flights have up to 0.08 s. A higher value hides delays, a lower one doubts weakly
excited flights."""
_MAX_DECISIVE_LAG_S: Final = 0.07
"""The same difference if the flight decisively excludes that elevation lags like pitch. Simulated flights
without a delay have up to 0.06 s."""
_PLAUSIBLE_LAGS_S: Final = (0.02, 0.28)
"""Plausible lags from voltages to angles [s]: rotors of 0.05 to 0.2 s, and the error of the estimate.
Outside, the voltages were logged at other times than the angles. Voltages that are delayed by as much as slow
rotors lag are just below the lower end, and so are flights of simulations without a rotor lag;
`no_rotor_lag_nats` distinguishes the two."""
_ROTOR_LAG_CUTOFF_Hz: Final = 5.0
"""Corner of the low-pass filter of the test for a rotor lag [Hz]. At 1.5 Hz, a lag looks like a delay. On
four simulated flights, 5 Hz separates flights with and without a lag by 12 nats; 3 Hz by 5."""
_ROTOR_LAGS_s: Final = (0.05, 0.07, 0.1, 0.15)
"""Time constants of rotors that this test compares with rotors without a lag [s]."""
_MIN_PITCH_ZERO_DEG: Final = 1.0
"""Smallest error of the pitch zero that is in doubt [deg]. Simulated flights show it within 0.6 deg, by
travel and by the voltages that hold it."""
_TYPICAL_LAG_s: Final = 0.1
"""Lag of an ordinary rotor, for the message how late or early the voltages are [s]."""


class Normal(NamedTuple):
    """Mean and standard deviation of a quantity."""

    mean: float
    std: float


ZERO: Final = Normal(0.0, 0.0)


class VoltageLimits(NamedTuple):
    """Smallest and largest voltage of a motor, in the unit of its column."""

    low: float
    high: float


NO_LIMITS: Final = VoltageLimits(-math.inf, math.inf)
"""Limits of the voltages if no command is beyond what the amplifier gives."""


@dataclass(frozen=True)
class Reference:
    """Gains and stiffnesses of a rig, linearised at hover."""

    stiffness: Mapping[str, Normal]  # By axis: acceleration per deflection [1/s^2]
    gain: Mapping[str, float]
    """By axis: elevation acceleration per sum of the voltages and pitch acceleration per their difference
    [rad/s^2/V], travel acceleration per pitch [1/s^2]."""
    hover_V: float  # Sum of the voltages at hover [V]
    rest_deg: float  # rest_deg, rest_tolerance_deg: Elevation on the table, and its tolerance [deg]
    rest_tolerance_deg: float
    counts: Mapping[str, float]  # Encoder counts per turn, by axis
    supply_V: float  # Largest voltage of a motor [V]
    supply_column: str = ""  # Column with the supply voltage, of which `supply_V` is the mean; may be empty
    reverses: bool = False  # Whether a rotor gives thrust at reversed voltage
    travel_rad_s2: Normal = ZERO
    """Constant acceleration of travel at level pitch; 0 if the rig has no torque about travel."""
    pitch_zero_deg: float = 3.0  # Error of the pitch zero that the rig file allows [deg]
    level_pitch_deg: Normal = ZERO
    """Pitch at which travel is steady; its standard deviation is that of the torque about travel."""


def reference_of(rig: Rig) -> Reference:
    """Linearise the baseline model of a rig at hover."""
    model = MultibodyModel()
    try:
        hover = trim(model, rig)
    except PlantError as error:
        raise IdentifyError(
            f"units cannot be checked with rig {rig.name}: {error.cause}", error.remedy
        ) from error
    linear = derivatives(model, rig, hover.state, hover.volts_V)
    # The states are the three angles, then their rates. These are the derivatives of the accelerations.
    by_angle, by_rate, by_voltage = linear.A[3:, :3], linear.A[3:, 3:], linear.B[3:]
    elevation, pitch, travel = range(3)
    travel_by_pitch = float(by_angle[travel, pitch])
    torque, friction = rig["torque_travel"], rig["friction_travel"].value
    # Friction brakes travel by minus friction over inertia.
    inverse_inertia = float(-by_rate[travel, travel]) / friction if friction > 0.0 else 0.0
    pitch_deg_per_Nm = math.degrees(inverse_inertia / travel_by_pitch)
    # An error of the pitch zero also accelerates travel. Its whole tolerance is one standard deviation here,
    # because programs set the zero wherever the short arm hangs; otherwise the tolerance is two.
    zero_error_rad_s2 = travel_by_pitch * np.radians(rig["offset_pitch"].tolerance)
    std_rad_s2 = float(np.hypot(inverse_inertia * 0.5 * torque.tolerance, zero_error_rad_s2))
    has_torque = bool(inverse_inertia and torque.value)
    means = {"elevation": float(by_angle[elevation, elevation]), "pitch": float(by_angle[pitch, pitch])}
    stiffness = {axis: Normal(mean, max(_MIN_STIFFNESS_STD, 0.5 * abs(mean))) for axis, mean in means.items()}
    # No torque depends on the travel angle: the regressions get no deflection, and any deviation will do.
    stiffness["travel"] = Normal(0.0, 0.1)
    front_gain, back_gain = by_voltage[pitch]
    return Reference(
        stiffness=stiffness,
        gain={
            "elevation": float(np.mean(by_voltage[elevation])),
            "pitch": float(0.5 * (front_gain - back_gain)),
            "travel": travel_by_pitch,
        },
        hover_V=float(hover.volts_V.sum()),
        rest_deg=rig["elevation_min"].value,
        rest_tolerance_deg=rig["elevation_min"].tolerance,
        counts=dict(zip(AXES, counts_per_turn(rig).tolist(), strict=True)),
        supply_V=rig["supply"].value,
        reverses=rig["reverse_thrust"].value != 0.0,
        travel_rad_s2=Normal(inverse_inertia * torque.value, std_rad_s2) if has_torque else ZERO,
        pitch_zero_deg=max(_MIN_PITCH_ZERO_DEG, rig["offset_pitch"].tolerance),
        level_pitch_deg=Normal(
            -pitch_deg_per_Nm * torque.value, abs(pitch_deg_per_Nm) * 0.5 * torque.tolerance
        ),
    )


@dataclass(frozen=True)
class Assignment:
    """Columns of a table, by role: three angles, and two motors or their sum and difference."""

    columns: Mapping[str, str]
    polarity: tuple[float, float] = (1.0, 1.0)  # Factors, 1 or -1, after which positive voltages lift
    log_likelihood: float = 0.0  # Log-likelihood of the motion [nats]

    @property
    def summed(self) -> bool:
        """Whether the voltages are sum and difference instead of front and back."""
        return SUMS[0] in self.columns

    @property
    def voltages(self) -> tuple[str, str]:
        """Columns of the voltages, in the order of their roles."""
        first, second = (column for role, column in self.columns.items() if role not in AXES)
        return first, second

    def same_as(self, other: Assignment) -> bool:
        """Whether another assignment uses the same columns; front and back may be exchanged."""
        same_angles = all(self.columns[axis] == other.columns[axis] for axis in AXES)
        same_voltages = self.voltages == other.voltages or (
            not self.summed and self.voltages == other.voltages[::-1]
        )
        return same_angles and self.summed == other.summed and same_voltages

    def __str__(self) -> str:
        return ", ".join(f"{role} is {column}" for role, column in self.columns.items())


@dataclass(frozen=True)
class RegressionFit:
    """Regression of an axis' acceleration on the signal that may drive it."""

    log_likelihood_ratio: float
    """Log-likelihood with this signal minus log-likelihood with the axis' deflection and rate only [nats]."""
    gain: float  # Acceleration per unit of the signal, with its sign
    lag_s: float = 0.0  # Delay from the signal to the acceleration [s]
    lag_range_s: tuple[float, float] = (-math.inf, math.inf)
    """Shortest and longest delay that are not decisively less likely [s]."""
    no_rotor_lag_nats: float = 0.0
    """Log-likelihood without a rotor lag minus log-likelihood with the best lag [nats]; 0 if not computed."""


class _AxisMotion(NamedTuple):
    """Motion of an axis, shape (n,) each: its deflection from the mean angle, and its derivatives."""

    deflection: Floats
    rate: Floats
    acceleration: Floats


def _axis_motion(axis: str, angle: Floats, rate: Floats, acceleration: Floats) -> _AxisMotion:
    """Return the motion of an axis; travel gets no deflection, because no torque depends on its angle."""
    return _AxisMotion(angle * 0.0 if axis == "travel" else angle - angle.mean(), rate, acceleration)


def regress_acceleration(
    signals: Signals, column: str, axis: str, cause: Floats, stiffness: Normal
) -> RegressionFit:
    """Regress the acceleration of a column, as the angle of an axis, on a cause. Shapes: `cause` (n,)."""
    angle = signals.filtered[column]
    rows = free_rows(signals, column) if axis == "elevation" else signals.inner
    motion = _axis_motion(axis, angle.value, angle.rate, angle.acceleration)
    return _ridge_regression(motion, cause, stiffness, rows)


def _ridge_regression(motion: _AxisMotion, cause: Floats, stiffness: Normal, rows: Booleans) -> RegressionFit:
    """Fit acceleration = stiffness deflection + damping rate + constant + gain cause, with normal priors of
    stiffness and damping, to some `rows`. Shapes: `cause` (n,), `rows` (n,).
    """
    deflection, rate, acceleration, regressor = (signal[rows][::_DECIMATION] for signal in (*motion, cause))
    # The prior mean of the stiffness is subtracted, so that all priors have the mean 0.
    y = acceleration - stiffness.mean * deflection
    if len(y) < _MIN_REGRESSION_ROWS:
        return RegressionFit(0.0, 0.0)
    columns = np.column_stack([deflection, rate, np.ones(len(y)), regressor])
    without_cause, with_cause = 3, 4
    # Columns of unit deviation keep the normal equations well conditioned; the constant column has none.
    scale = np.maximum(columns.std(axis=0), 1e-12)
    constant_column, cause_column = 2, 3
    scale[constant_column] = 1.0
    columns = columns / scale
    damping_std = 1.0
    prior_std = np.array([stiffness.std, damping_std, np.inf, np.inf]) * scale
    # A file may need thousands of these regressions, so each builds its normal equations only once.
    normal_matrix, right_side, sum_of_squares = columns.T @ columns, columns.T @ y, float(y @ y)
    noise_variance = float(y.var())
    variance_without_cause = variance_with_cause = gain = 0.0

    def solve(count: int) -> tuple[Floats, float]:
        """Coefficients of the first `count` columns, and the mean of squared residuals plus penalty."""
        # The last summand keeps the equations solvable if a column is constant.
        penalty = np.diag(noise_variance / prior_std[:count] ** 2 + 1e-9 * len(y))
        solution = np.linalg.solve(normal_matrix[:count, :count] + penalty, right_side[:count])
        return solution, (sum_of_squares - float(solution @ right_side[:count])) / len(y)

    # The penalty depends on the variance of the noise, which only the residuals give: three rounds settle it.
    for _ in range(3):
        _, variance_without_cause = solve(without_cause)
        solution, variance_with_cause = solve(with_cause)
        gain = float(solution[cause_column] / scale[cause_column])
        # A perfect fit, or an axis at rest, must not give 0.
        noise_variance = max(variance_with_cause, 1e-12 * float(y.var()) + 1e-300)
    independent_samples = len(y) * _DECIMATION * SAMPLE_STEP_s * _INDEPENDENT_SAMPLES_Hz
    log_ratio = float(np.log(max(variance_without_cause, 1e-300) / max(variance_with_cause, 1e-300)))
    return RegressionFit(0.5 * independent_samples * log_ratio, gain)


def free_rows(signals: Signals, column: str) -> Booleans:
    """Select the rows in which the arm is off its table, if a column is the elevation. Returns shape (n,)."""
    raw = signals.raw[column]
    rest_rows = round(REST_DURATION_S / SAMPLE_STEP_s)
    start, typical = float(raw[0]), float(np.median(raw))
    span = float(np.ptp(raw))
    # The unit is not known yet, so each limit is a share of the column's range, or of the rise from the
    # table.
    begins_in_motion = np.ptp(raw[:rest_rows]) > 0.01 * span
    stays_low = abs(typical - start) < 0.2 * span
    if span == 0.0 or begins_in_motion or stays_low:
        return signals.inner
    is_off_table = (raw - start) * np.sign(typical - start) > 0.4 * abs(typical - start)
    result: Booleans = signals.inner & is_off_table
    return result


def sum_and_difference(
    signals: Signals, assignment: Assignment, bias: float = 0.0, limits: VoltageLimits = NO_LIMITS
) -> tuple[Floats, Floats]:
    """Compute the sum and the difference of the voltages that the motors received, shape (n,) each."""
    first, second = (
        sign * signals.raw[column]
        for sign, column in zip(assignment.polarity, assignment.voltages, strict=True)
    )
    total, difference = (first + bias, second) if assignment.summed else (first + second, first - second)
    if limits == NO_LIMITS:
        return total, difference
    front = np.clip(0.5 * (total + difference), *limits)
    back = np.clip(0.5 * (total - difference), *limits)
    return front + back, front - back


def axis_regressions(
    signals: Signals,
    assignment: Assignment,
    reference: Reference,
    rad: Mapping[str, float] | None = None,
    bias: float = 0.0,
    limits: VoltageLimits = NO_LIMITS,
) -> dict[str, RegressionFit]:
    """Regress each axis' acceleration on its cause, at the lag with the highest likelihood.

    The cause of elevation is the sum of the voltages, that of pitch is their difference, and that of travel
    is pitch. With the radians per unit of each angle, `rad`, the sine and cosine of pitch are included.
    """
    total, difference = sum_and_difference(signals, assignment, bias, limits)
    pitch = signals.raw[assignment.columns["pitch"]]
    causes = {"elevation": total, "pitch": difference, "travel": pitch}
    if rad is not None:
        pitch_rad = rad["pitch"] * pitch
        mean = float(total.mean())
        causes["elevation"] = total * np.cos(pitch_rad)
        # A sum that was logged without its bias has a small mean, which is no measure of the thrust.
        if not assignment.summed or abs(mean) > float(total.std()):
            relative_thrust = total / max(abs(mean), 1e-12) if mean else np.ones(total.size)
            causes["travel"] = np.sin(pitch_rad) / rad["pitch"] * np.clip(relative_thrust, 0.0, 2.0)
    fits = {
        axis: _fit_at_best_lag(
            signals, assignment.columns[axis], axis, filtered_signal(causes[axis]).value, reference
        )
        for axis in AXES
    }
    if _responds_without_lag(fits["pitch"].lag_s):
        nats = _no_rotor_lag_nats(signals, assignment.columns["pitch"], difference, reference)
        fits["pitch"] = replace(fits["pitch"], no_rotor_lag_nats=nats)
    return fits


def _fit_at_best_lag(
    signals: Signals, column: str, axis: str, cause: Floats, reference: Reference
) -> RegressionFit:
    """Regress the acceleration of an axis on its cause at each lag of `_LAGS_s`; return the most likely fit.
    Shapes: `cause` (n,).
    """
    stiffness = reference.stiffness[axis]
    fits = [
        replace(regress_acceleration(signals, column, axis, delay(cause, lag_s), stiffness), lag_s=lag_s)
        for lag_s in _LAGS_s
    ]
    best = max(fits, key=lambda fit: fit.log_likelihood_ratio)
    possible_s = [
        fit.lag_s for fit in fits if best.log_likelihood_ratio - fit.log_likelihood_ratio < DECISIVE_NATS
    ]
    return replace(best, lag_range_s=(min(possible_s), max(possible_s)))


def rate_nats(
    signals: Signals, assignment: Assignment, reference: Reference, limits: VoltageLimits = NO_LIMITS
) -> dict[str, float]:
    """Compare, by axis, a column that is the rate of its axis with one that is the angle [nats].

    The cause of an axis drives the second derivative of its angle, and the first one of its rate. Simulated
    and measured flights have -8 and less for angles, and 6 and more for rates.
    """
    total, difference = sum_and_difference(signals, assignment, 0.0, limits)
    causes = {"elevation": total, "pitch": difference, "travel": signals.raw[assignment.columns["pitch"]]}
    result = {}
    for axis, cause in causes.items():
        column, low_passed = assignment.columns[axis], filtered_signal(cause).value
        logged, stiffness = signals.filtered[column], reference.stiffness[axis]
        # If the column is a rate, its integral is the angle, and its derivative the acceleration.
        motion = _axis_motion(axis, np.cumsum(logged.value) * SAMPLE_STEP_s, logged.value, logged.rate)
        rate_fits = [
            _ridge_regression(motion, delay(low_passed, lag_s), stiffness, signals.inner) for lag_s in _LAGS_s
        ]
        nats_as_rate = max(fit.log_likelihood_ratio for fit in rate_fits)
        angle_fit = _fit_at_best_lag(signals, column, axis, low_passed, reference)
        result[axis] = nats_as_rate - angle_fit.log_likelihood_ratio
    return result


def _responds_without_lag(lag_s: float) -> bool:
    """Whether pitch follows the voltages after a lag, `lag_s` [s], that only rotors without a lag have."""
    shortest_s, _ = _PLAUSIBLE_LAGS_S
    return 0.0 <= round(lag_s, 3) < shortest_s


def _no_rotor_lag_nats(signals: Signals, column: str, difference: Floats, reference: Reference) -> float:
    """Compare rotors without a lag with rotors that lag while the logged voltages are too late. Shapes:
    `difference` (n,).

    A lag of the rotors and late voltages can cancel on average: pitch then follows the voltages without a
    delay in both cases. But lagging rotors also smooth the voltages, which distinguishes the two.
    """
    pitch = filtered_signal(signals.raw[column], _ROTOR_LAG_CUTOFF_Hz)
    motion = _axis_motion("pitch", pitch.value, pitch.rate, pitch.acceleration)

    def highest_nats(voltage: Floats, delays_s: Floats) -> float:
        """Evidence that this voltage drives pitch, at the best of several delays [nats]."""
        cause = filtered_signal(voltage, _ROTOR_LAG_CUTOFF_Hz).value
        fits = [
            _ridge_regression(motion, delay(cause, delay_s), reference.stiffness["pitch"], signals.inner)
            for delay_s in delays_s
        ]
        return max(fit.log_likelihood_ratio for fit in fits)

    # Voltages that were logged too late act before their rows: with negative delays.
    nats_with_lag = max(
        highest_nats(lagged(difference, lag_s), np.arange(-1.6 * lag_s, 0.0, SAMPLE_STEP_s))
        for lag_s in _ROTOR_LAGS_s
    )
    return highest_nats(difference, np.zeros(1)) - nats_with_lag


def pooled_fits(fits_by_file: Sequence[Mapping[str, RegressionFit]]) -> dict[str, RegressionFit]:
    """Add up the regressions of all files by axis; files whose gains have opposite signs weaken each other.

    Lags are averaged with the evidence of the files as weights; the gain is that of the strongest file.
    """
    pooled = {}
    for axis in AXES:
        fits = [fits_of_file[axis] for fits_of_file in fits_by_file]
        # Positive if the files together show a positive gain.
        signed_nats = float(sum(fit.log_likelihood_ratio * np.sign(fit.gain) for fit in fits))
        strongest = max(fits, key=lambda fit: fit.log_likelihood_ratio)
        weights = np.array([max(fit.log_likelihood_ratio, 1e-6) for fit in fits])
        shortest_s, longest_s = np.average([fit.lag_range_s for fit in fits], axis=0, weights=weights)
        pooled[axis] = RegressionFit(
            abs(signed_nats),
            gain=abs(strongest.gain) * (1.0 if signed_nats >= 0.0 else -1.0),
            lag_s=float(np.average([fit.lag_s for fit in fits], weights=weights)),
            lag_range_s=(float(shortest_s), float(longest_s)),
            no_rotor_lag_nats=sum(fit.no_rotor_lag_nats for fit in fits),
        )
    return pooled


class LeastSquaresFit(NamedTuple):
    """Coefficients of a constant and of p causes, shape (1 + p,), and their covariance."""

    coefficients: Floats
    covariance: Floats

    @property
    def constant(self) -> float:
        """Coefficient of the constant, which comes first."""
        return float(self.coefficients[0])


def travel_equation(signals: Signals, assignment: Assignment, rad: Mapping[str, float]) -> LeastSquaresFit:
    """Regress the acceleration of travel on a constant, its rate, and the horizontal part of the thrust; the
    coefficients are in the unit of travel.
    """
    travel, pitch = (signals.filtered[assignment.columns[axis]] for axis in ("travel", "pitch"))
    rows = free_rows(signals, assignment.columns["elevation"])
    voltage_sum, _ = sum_and_difference(signals, assignment)
    total = filtered_signal(voltage_sum).value
    mean = float(total[rows].mean()) if rows.any() else 0.0
    # Some logs lack the voltage of hover: their mean is near 0, and the thrust counts as constant. Half a
    # standard deviation is a judgement. No thrust pushes down, and peaks count as twice the mean at most.
    hover_is_logged = mean > 0.5 * float(total.std())
    relative_thrust = np.clip(total / mean, 0.0, 2.0) if hover_is_logged else np.ones(total.size)
    return _least_squares(
        travel.acceleration, (travel.rate, np.sin(rad["pitch"] * pitch.value) * relative_thrust), rows
    )


class SteadyPitch(NamedTuple):
    """Pitch at which travel does not accelerate, and pitch that equal voltages hold [deg]."""

    by_travel: Normal
    by_voltages: Normal


def steady_pitch_deg(
    signals: Signals, assignment: Assignment, rad: Mapping[str, float], lag_s: float
) -> SteadyPitch:
    """Estimate the pitch at which nothing accelerates [deg], with the sign of the column; the voltages drive
    pitch after a lag.

    A wrong zero moves both angles alike. A torque about travel moves only the angle that travel shows, and
    unequal rotors only the angle that the voltages hold, which is uncertain if the body has no pendulum.
    """
    pitch = signals.filtered[assignment.columns["pitch"]]
    _, difference = sum_and_difference(signals, assignment)
    cause = delay(filtered_signal(difference).value, lag_s)
    rows = free_rows(signals, assignment.columns["elevation"])
    pitch_equation = _least_squares(
        pitch.acceleration, (cause, pitch.rate, np.sin(rad["pitch"] * pitch.value)), rows
    )
    return SteadyPitch(
        by_travel=_balance_deg(travel_equation(signals, assignment, rad)),
        by_voltages=_balance_deg(pitch_equation),
    )


def _least_squares(response: Floats, causes: Sequence[Floats], rows: Booleans) -> LeastSquaresFit:
    """Regress a response on a constant and on causes. Shapes: `response` (n,), `causes` (n,), `rows`
    (n,).
    """
    regressors = np.column_stack((np.ones(response.size), *causes))[rows]
    solution, *_ = np.linalg.lstsq(regressors, response[rows], rcond=None)
    variance = float(np.mean((response[rows] - regressors @ solution) ** 2)) if rows.any() else 0.0
    # Filtered rows depend on each other: each row counts for less than one independent sample.
    per_row = variance / (SAMPLE_STEP_s * _INDEPENDENT_SAMPLES_Hz)
    covariance = per_row * np.linalg.pinv(regressors.T @ regressors)
    return LeastSquaresFit(np.asarray(solution, np.float64), covariance)


def _balance_deg(fit: LeastSquaresFit) -> Normal:
    """Return the angle whose sine, times the last coefficient, balances the constant [deg]; without such a
    coefficient, its standard deviation is infinite.
    """
    constant, gain = fit.constant, float(fit.coefficients[-1])
    if not gain:
        return Normal(0.0, math.inf)
    # The sine is -constant / gain; these are its derivatives by the two coefficients.
    gradient = np.zeros(fit.coefficients.size)
    gradient[0], gradient[-1] = -1.0 / gain, constant / gain**2
    std = math.sqrt(max(float(gradient @ fit.covariance @ gradient), 0.0))
    angle_rad = math.asin(float(np.clip(-constant / gain, -1.0, 1.0)))
    return Normal(math.degrees(angle_rad), math.degrees(std))


def abs_correlation(first: Floats, second: Floats) -> float:
    """Absolute correlation of two columns; 0 if one of them is constant."""
    if np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return 0.0
    return abs(float(np.corrcoef(first, second)[0, 1]))


def has_unit_slope(rate: Floats, values: Floats, signals: Signals) -> bool:
    """Whether `values` are an angle's `rate`, in the unit of the angle or in another unit, shape (n,) each.

    A negative slope is feedback: programs log an angle and its rate with the same sign.
    """
    variance = float(rate.var())
    slope = float(np.mean((rate - rate.mean()) * (values - values.mean()))) / variance if variance else 0.0
    from_counts = (turn / counts for turn in (2.0 * np.pi, 360.0) for counts in signals.counts_per_turn)
    min_ratio, max_ratio = _UNIT_SLOPE_RANGE
    return any(min_ratio < slope / scale < max_ratio for scale in (*_RATE_SCALES, *from_counts))


def feedback_sign(voltage_sum: Floats, angle: Signal, signals: Signals) -> float:
    """Return the sign of the correlation if the sum of the voltages is proportional to an angle's rate, as
    under state feedback; otherwise 0. Shapes: `voltage_sum` (n,).
    """
    if abs_correlation(voltage_sum, angle.rate) <= FEEDBACK_MATCH**0.5:
        return 0.0
    if has_unit_slope(angle.rate, voltage_sum, signals):
        return 0.0
    return float(np.sign(np.corrcoef(voltage_sum, angle.rate)[0, 1]))


def lag_ambiguities(regressions: Mapping[str, RegressionFit]) -> list[Ambiguity]:
    """Report implausible delays between the columns.

    The guess removes no delay by itself, because a flight cannot separate a rotor lag from a late column.
    """
    elevation, pitch, travel = (regressions[axis] for axis in AXES)
    return [*_late_travel(travel), *_late_elevation(elevation, pitch), *_late_voltages(pitch)]


def lag_sentence(regressions: Mapping[str, RegressionFit]) -> str:
    """Describe all delays between the columns in one sentence."""
    elevation, pitch, travel = (regressions[axis] for axis in AXES)
    return (
        f"pitch follows the voltages after {pitch.lag_s:.2f} s, elevation after {elevation.lag_s:.2f} s "
        "(rotor lag, transport and logging delay; a flight cannot separate them); travel follows pitch "
        f"after {travel.lag_s:.2f} s"
    )


def _late_travel(travel: RegressionFit) -> list[Ambiguity]:
    """Report travel if it follows pitch too late or too early."""
    if abs(travel.lag_s) <= _MAX_TRAVEL_LAG_S:
        return []
    alternative = f"{travel.lag_s:.2f} s late{_range_words(travel)}"
    reason = "it follows pitch at another time than a rig can; check how it is logged, and set delay_s"
    return [Ambiguity("travel's time", "not late", alternative, reason)]


def _late_elevation(elevation: RegressionFit, pitch: RegressionFit) -> list[Ambiguity]:
    """Report elevation if it follows the voltages much later or earlier than pitch."""
    later_s = elevation.lag_s - pitch.lag_s
    shortest_s, _ = elevation.lag_range_s
    is_decisively_late = shortest_s > pitch.lag_s
    if abs(later_s) <= (_MAX_DECISIVE_LAG_S if is_decisively_late else _MAX_LAG_DIFFERENCE_S):
        return []
    return [
        Ambiguity(
            "elevation's time",
            "logged with pitch",
            f"{abs(later_s):.2f} s {'later' if later_s > 0.0 else 'earlier'} than pitch"
            f"{_range_words(elevation, pitch.lag_s)}",
            "the same rotors drive both, but a flight cannot separate their lag from a delay of the log; "
            "set delay_s only if your logger delays elevation",
        )
    ]


def _late_voltages(pitch: RegressionFit) -> list[Ambiguity]:
    """Report voltages that pitch follows with a lag that no rotor has."""
    shortest_s, longest_s = _PLAUSIBLE_LAGS_S
    without_lag = _responds_without_lag(pitch.lag_s)
    is_certain = without_lag and pitch.no_rotor_lag_nats >= DECISIVE_NATS
    if shortest_s <= pitch.lag_s <= longest_s or is_certain:
        return []
    reason = (
        "pitch responds without a lag, as only a simulation without rotor lag does"
        if without_lag
        else "no rotor responds with such a lag"
    )
    return [
        Ambiguity(
            "the voltages' time",
            "logged with the angles",
            f"{'late' if pitch.lag_s < shortest_s else 'early'} by about "
            f"{abs(pitch.lag_s - _TYPICAL_LAG_s):.2f} s relative to the angles",
            f"{reason}; check how they are logged, and set delay_s",
        )
    ]


def _range_words(fit: RegressionFit, origin_s: float = 0.0) -> str:
    """Describe the range of delays that a regression does not rule out, counted from `origin_s` [s]; empty if
    the range is short.
    """
    shortest_s, longest_s = (edge - origin_s for edge in fit.lag_range_s)
    if longest_s - shortest_s < _MAX_LAG_DIFFERENCE_S:
        return ""
    return f" ({shortest_s:.2f} to {longest_s:.2f} s are possible)"
