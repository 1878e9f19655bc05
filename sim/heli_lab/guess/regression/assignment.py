"""Assign columns to roles: the sum of the voltages drives elevation, their difference pitch, pitch travel."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from heli_host.arrays import Booleans, Floats

from heli_lab.guess import names, thresholds
from heli_lab.guess.regression.candidates import feedback_sign
from heli_lab.guess.regression.reference import Reference
from heli_lab.guess.regression.signals import Signal, Signals, delay

_MIN_REGRESSION_ROWS: Final = 20
"""Smallest number of rows of a regression; it has four coefficients."""
_DECIMATION: Final = 10
"""The regressions use every tenth row: 10 Hz samples all that the low-pass filter leaves."""


@dataclass(frozen=True)
class RegressionFit:
    """Regression of an axis' acceleration on the signal that may drive it.

    Parameters
    ----------
    log_likelihood_ratio : float
        Log-likelihood with this signal minus log-likelihood with the axis' deflection and rate only [nats].
    gain : float
        Acceleration per unit of the signal, with its sign.
    lag_s : float
        Delay from the signal to the acceleration [s].
    lag_range_s : tuple of (float, float)
        Shortest and longest delay that are not decisively less likely [s].
    no_rotor_lag_nats : float
        Log-likelihood without a rotor lag minus log-likelihood with the best lag [nats]; 0 if not computed.
    """

    log_likelihood_ratio: float
    gain: float
    lag_s: float = 0.0
    lag_range_s: tuple[float, float] = (-math.inf, math.inf)
    no_rotor_lag_nats: float = 0.0


@dataclass(frozen=True)
class ColumnAssignment:
    """Columns of a table, by role.

    Parameters
    ----------
    elevation, pitch, travel : str
        Names of the angle columns.
    voltages : tuple of (str, str)
        Names of the voltage columns.
    summed : bool
        Whether the voltages are sum and difference instead of front and back.
    polarity : tuple of (float, float)
        Factors, 1 or -1, after which positive voltages lift.
    log_likelihood : float
        Log-likelihood of the motion and the columns' names [nats].
    physics_log_likelihood : float
        Log-likelihood of the motion alone [nats].
    """

    elevation: str
    pitch: str
    travel: str
    voltages: tuple[str, str]
    summed: bool
    polarity: tuple[float, float]
    log_likelihood: float
    physics_log_likelihood: float

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all five columns, angles first."""
        return (self.elevation, self.pitch, self.travel, *self.voltages)

    def same_as(self, other: ColumnAssignment) -> bool:
        """Whether another assignment uses the same columns; front and back may be exchanged."""
        same_voltages = self.voltages == other.voltages
        if not self.summed:
            same_voltages = same_voltages or self.voltages == other.voltages[::-1]
        return self.columns[:3] == other.columns[:3] and self.summed == other.summed and same_voltages


def regress_acceleration(
    acceleration: Floats,
    axis_terms: tuple[Floats, Floats],
    cause: Floats,
    stiffness: tuple[float, float],
    rows: Booleans,
) -> RegressionFit:
    """Ridge regression of an axis' acceleration on a cause, with stiffness, damping and a constant.

    Parameters
    ----------
    acceleration : ndarray (n,)
        Acceleration of the axis, in the column's unit per s^2.
    axis_terms : tuple of ndarray (n,)
        Deflection and rate of the axis.
    cause : ndarray (n,)
        Signal that may drive the axis.
    stiffness : tuple of float
        Prior of the acceleration per deflection: mean and standard deviation [1/s^2].
    rows : ndarray of bool (n,)
        Rows to use.
    """
    deflection, rate, response, regressor = (
        signal[rows][::_DECIMATION] for signal in (*axis_terms, acceleration, cause)
    )
    y = response - stiffness[0] * deflection
    if len(y) < _MIN_REGRESSION_ROWS:
        return RegressionFit(0.0, 0.0)
    columns = np.column_stack([deflection, rate, np.ones(len(y)), regressor])
    # Columns of unit deviation keep the normal equations well conditioned; the constant column has none.
    scale = np.maximum(columns.std(axis=0), 1e-12)
    scale[2] = 1.0
    columns = columns / scale
    prior_std = np.array([stiffness[1], 1.0, np.inf, np.inf]) * scale
    # A file needs thousands of these regressions; the normal equations are built once for each.
    gram, moment, power = columns.T @ columns, columns.T @ y, float(y @ y)
    noise_variance = float(y.var())
    without_cause = with_cause = gain = 0.0

    def solve(count: int) -> tuple[Floats, float]:
        """Coefficients of the first `count` columns, and the mean of squared residuals plus penalty."""
        penalty = np.diag(noise_variance / prior_std[:count] ** 2 + 1e-9 * len(y))
        solution = np.linalg.solve(gram[:count, :count] + penalty, moment[:count])
        return solution, (power - float(solution @ moment[:count])) / len(y)

    # The penalty depends on the noise, which the residuals give.
    for _ in range(3):
        _, without_cause = solve(3)
        solution, with_cause = solve(4)
        gain = float(solution[-1] / scale[3])
        noise_variance = max(with_cause, 1e-12 * float(y.var()) + 1e-300)
    duration_s = len(y) * _DECIMATION * thresholds.SAMPLE_STEP_s
    independent_samples = duration_s * thresholds.INDEPENDENT_SAMPLES_Hz
    log_ratio = float(np.log(max(without_cause, 1e-300) / max(with_cause, 1e-300)))
    return RegressionFit(0.5 * independent_samples * log_ratio, gain)


def free_rows(signals: Signals, name: str) -> Booleans:
    """Rows in which the arm is off its table if the column `name` is the elevation, shape (n,): all inner
    rows if the column does not begin at rest.
    """
    raw = signals.raw[name]
    rest_rows = round(thresholds.REST_DURATION_S / thresholds.SAMPLE_STEP_s)
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


def polarity_of(values: Floats) -> float:
    """Return the sign, 1 or -1, that makes the mean of a voltage, `values`, positive; 1 if it is near 0."""
    mean = float(values.mean())
    return -1.0 if mean < 0.0 and abs(mean) > 0.5 * float(values.std()) else 1.0


def assignments(
    signals: Signals,
    reference: Reference,
    columns: list[str],
    encoders: Collection[str] = frozenset(),
    known: Mapping[str, str] = MappingProxyType({}),
) -> list[ColumnAssignment]:
    """Assignments of columns to roles with their log-likelihoods, the most likely first.

    Parameters
    ----------
    signals : Signals
        All columns.
    reference : Reference
        Prior of the stiffness of elevation and pitch.
    columns : list of str
        Names of the columns that may be an angle or a voltage.
    encoders : collection of str
        Columns quantised by an encoder: measured angles, not estimates or setpoints.
    known : Mapping[str, str]
        Roles that the user knows, by column.
    """
    count = len(columns)
    if count < 5:
        return []
    polarity = np.array([polarity_of(signals.raw[name]) for name in columns])
    encoder_nats = thresholds.ENCODER_NATS * np.array([name in encoders for name in columns], float)
    elevation_nats, pitch_nats = _voltage_nats(signals, columns, polarity, reference)
    elevation_nats = {key: nats + encoder_nats for key, nats in elevation_nats.items()}
    pitch_nats = {key: nats + encoder_nats for key, nats in pitch_nats.items()}
    travel_nats = _travel_nats(signals, columns) + encoder_nats
    name_nats = _name_scores(columns, known)

    def physics(sum_key: tuple[int, ...], difference_key: tuple[int, ...]) -> Floats:
        """Score of each choice of elevation, pitch and travel, shape (columns, columns, columns), for the
        columns of sum and difference.
        """
        elevation, pitch = elevation_nats[sum_key], pitch_nats[difference_key]
        return elevation[:, None, None] + pitch[None, :, None] + travel_nats[None, :, :]

    ranked = []
    for front_and_back in itertools.combinations(range(count), 2):
        nats = physics(front_and_back, front_and_back)
        ranked += _best(columns, nats, name_nats, front_and_back, False, polarity)
    for sum_and_difference in itertools.permutations(range(count), 2):
        nats = physics(sum_and_difference[:1], sum_and_difference[1:])
        ranked += _best(columns, nats, name_nats, sum_and_difference, True, polarity)
    return sorted(ranked, key=lambda assignment: -assignment.log_likelihood)


def _voltage_nats(
    signals: Signals, columns: list[str], polarity: Floats, reference: Reference
) -> tuple[dict[tuple[int, ...], Floats], dict[tuple[int, ...], Floats]]:
    """Evidence that voltages drive elevation by their sum, and pitch by their difference.

    Returns
    -------
    elevation_nats, pitch_nats : dict of ndarray (columns,)
        Log-likelihood ratio of each column as the angle [nats], by the indices of the voltage columns: one
        index for a column that is itself the sum or the difference, two for front and back.
    """
    count = len(columns)
    filtered = [signals.filtered[name] for name in columns]
    lifting = [polarity[i] * filtered[i].value for i in range(count)]
    sums: dict[tuple[int, ...], Floats] = {(i,): lifting[i] for i in range(count)}
    differences: dict[tuple[int, ...], Floats] = {(i,): filtered[i].value for i in range(count)}
    for i, j in itertools.combinations(range(count), 2):
        sums[i, j] = lifting[i] + lifting[j]
        differences[i, j] = lifting[i] - lifting[j]
    flying = [free_rows(signals, name) for name in columns]
    elevation_nats = _log_likelihood_table(sums, filtered, flying, reference.stiffness["elevation"])
    for i in range(count):
        has_feedback = np.array(
            [abs(feedback_sign(lifting[i], angle, signals.counts_per_turn)) for angle in filtered]
        )
        elevation_nats[i,] += thresholds.FEEDBACK_NATS * has_feedback
    everywhere = [signals.inner] * count
    pitch_nats = _log_likelihood_table(differences, filtered, everywhere, reference.stiffness["pitch"])
    return elevation_nats, pitch_nats


def _travel_nats(signals: Signals, columns: list[str]) -> Floats:
    """Evidence that one column as pitch drives another one as travel [nats], shape (columns, columns)."""
    filtered = [signals.filtered[name] for name in columns]
    nats = np.zeros((len(columns), len(columns)))
    for pitch, travel in itertools.permutations(range(len(columns)), 2):
        axis_terms = (filtered[travel].value * 0.0, filtered[travel].rate)
        nats[pitch, travel] = regress_acceleration(
            filtered[travel].acceleration, axis_terms, filtered[pitch].value, (0.0, 0.1), signals.inner
        ).log_likelihood_ratio
    return nats


def _log_likelihood_table(
    causes: dict[tuple[int, ...], Floats],
    filtered: Sequence[Signal],
    rows: list[Booleans],
    stiffness: tuple[float, float],
) -> dict[tuple[int, ...], Floats]:
    """Evidence that each cause drives each column as an angle, at the best lag.

    Parameters
    ----------
    causes : dict of ndarray (n,)
        Signals that may drive an axis, by the indices of the columns that they are made of.
    filtered : sequence of Signal
        The columns.
    rows : list of ndarray of bool (n,)
        Rows to use, for each column.
    stiffness : (float, float)
        As in `regress_acceleration`.

    Returns
    -------
    dict of ndarray (columns,)
        Log-likelihood ratio of each column [nats], by cause; 0 for the columns that the cause is made of.
    """
    table = {}
    for key, cause in causes.items():
        lagged = [delay(cause, lag_s) for lag_s in thresholds.ROLE_LAGS_S]
        nats = np.zeros(len(filtered))
        for index, signal in enumerate(filtered):
            if index in key:
                continue
            axis_terms = (signal.value - signal.value.mean(), signal.rate)
            nats[index] = max(
                regress_acceleration(
                    signal.acceleration, axis_terms, late_cause, stiffness, rows[index]
                ).log_likelihood_ratio
                for late_cause in lagged
            )
        table[key] = nats
    return table


def _name_scores(columns: list[str], known: Mapping[str, str]) -> dict[str, Floats]:
    """Score of each column's name for each role [nats], shape (columns,) per role."""

    def score(name: str, role: str) -> float:
        """Log-likelihood ratio of a `role` of the column `name`; what the user knows goes first."""
        named_role = names.role_of(name)
        if name in known or role in known.values():
            return thresholds.KNOWN_NATS * (1.0 if known.get(name) == role else -1.0)
        if named_role:
            return thresholds.NAME_NATS * (1.0 if named_role == role else -1.0)
        return -thresholds.DERIVED_SIGNAL_NATS if names.is_derived_signal(name) else 0.0

    return {role: np.array([score(name, role) for name in columns]) for role in names.ROLES}


def _best(
    columns: list[str],
    physics: Floats,
    name_nats: dict[str, Floats],
    pair: tuple[int, int],
    summed: bool,
    polarity: Floats,
) -> list[ColumnAssignment]:
    """The three most likely choices of angles for a pair of voltage columns.

    Parameters
    ----------
    columns : list of str
        Names of all columns.
    physics : ndarray (columns, columns, columns)
        Score of each choice of elevation, pitch and travel by the motion [nats].
    name_nats : dict of ndarray (columns,)
        Score of each column's name, by role [nats].
    pair : (int, int)
        Indices of the voltage columns: sum and difference if `summed`, otherwise the motors in any order.
    polarity : ndarray (columns,)
        Sign after which the mean of each column is positive.
    """
    by_name = np.add.outer(np.add.outer(name_nats["elevation"], name_nats["pitch"]), name_nats["travel"])
    i, j = pair
    if summed:
        by_name = by_name + name_nats["sum"][i] + name_nats["difference"][j]
    else:
        front_first = name_nats["front"][i] + name_nats["back"][j]
        back_first = name_nats["front"][j] + name_nats["back"][i]
        by_name = by_name + max(front_first, back_first)
        if back_first > front_first:
            i, j = j, i
    total = physics + by_name
    elevation, pitch, travel = np.indices(total.shape)
    # Every column has one role at most.
    total[(elevation == pitch) | (elevation == travel) | (pitch == travel)] = -np.inf
    for voltage in pair:
        total[(elevation == voltage) | (pitch == voltage) | (travel == voltage)] = -np.inf
    best = zip(*np.unravel_index(np.argsort(total.ravel())[::-1][:3], total.shape), strict=True)
    return [
        ColumnAssignment(
            elevation=columns[angles[0]],
            pitch=columns[angles[1]],
            travel=columns[angles[2]],
            voltages=(columns[i], columns[j]),
            summed=summed,
            polarity=(float(polarity[i]), 1.0 if summed else float(polarity[j])),
            log_likelihood=float(total[angles]),
            physics_log_likelihood=float(physics[angles]),
        )
        for angles in best
        if np.isfinite(total[angles])
    ]
