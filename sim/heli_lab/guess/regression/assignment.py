"""Assign columns to roles: the sum of the voltages drives elevation, their difference pitch, pitch travel."""

from __future__ import annotations

import itertools
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
    """

    log_likelihood_ratio: float
    gain: float
    lag_s: float = 0.0


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
        pair = set if not self.summed else tuple
        return (self.columns[:3], self.summed, pair(self.voltages)) == (
            other.columns[:3],
            other.summed,
            pair(other.voltages),
        )


def explain(
    acceleration: Floats,
    axis_terms: tuple[Floats, Floats],
    cause: Floats,
    stiffness: tuple[float, float],
    rows: Booleans,
) -> RegressionFit:
    """Regress an axis' acceleration on a cause, together with stiffness, damping and a constant.

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
    deflection, rate, driven, driving = (
        signal[rows][::_DECIMATION] for signal in (*axis_terms, acceleration, cause)
    )
    y = driven - stiffness[0] * deflection
    if len(y) < 20:
        return RegressionFit(0.0, 0.0)
    columns = np.column_stack([deflection, rate, np.ones(len(y)), driving])
    spread = np.maximum(columns.std(axis=0), 1e-12)
    spread[2] = 1.0
    columns = columns / spread
    ridge = np.array([stiffness[1], 1.0, np.inf, np.inf]) * spread
    # A file needs thousands of these regressions; the normal equations are built once for each.
    gram, moment, power = columns.T @ columns, columns.T @ y, float(y @ y)
    noise = float(y.var())
    mean_squares: list[float] = []
    gain = 0.0
    for _ in range(3):
        mean_squares = []
        for count in (3, 4):
            penalised = gram[:count, :count] + np.diag(noise / ridge[:count] ** 2 + 1e-9 * len(y))
            solution = np.linalg.solve(penalised, moment[:count])
            # At the solution this is the sum of squared residuals and of the penalty.
            mean_squares.append((power - float(solution @ moment[:count])) / len(y))
            gain = float(solution[-1] / spread[count - 1])
        noise = max(mean_squares[1], 1e-12 * float(y.var()) + 1e-300)
    seconds = len(y) * _DECIMATION * thresholds.SAMPLE_STEP_s
    independent = seconds * thresholds.INDEPENDENT_SAMPLES_Hz
    return RegressionFit(
        0.5 * independent * float(np.log(max(mean_squares[0], 1e-300) / max(mean_squares[1], 1e-300))), gain
    )


def free_rows(signals: Signals, name: str) -> Booleans:
    """Select the rows in which the arm is off its table, if the column `name` is the elevation.

    Returns
    -------
    ndarray of bool (n,)
        All inner rows if the column does not begin at rest.
    """
    raw = signals.raw[name]
    rest = round(thresholds.REST_DURATION_S / thresholds.SAMPLE_STEP_s)
    start, typical = float(raw[0]), float(np.median(raw))
    span = float(np.ptp(raw))
    if span == 0.0 or np.ptp(raw[:rest]) > 0.01 * span or abs(typical - start) < 0.2 * span:
        return signals.inner
    off = (raw - start) * np.sign(typical - start) > 0.4 * abs(typical - start)
    free: Booleans = signals.inner & off
    return free


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
    """Score assignments of columns to roles, and return them with the most likely first.

    Parameters
    ----------
    columns : list of str
        Names of the columns that may be an angle or a voltage.
    reference : Reference
        Prior of the stiffness of elevation and pitch.
    encoders : collection of str
        Columns quantised by an encoder: measured angles, not estimates or setpoints.
    known : Mapping[str, str]
        Roles that the user knows, by column.
    """
    count = len(columns)
    if count < 5:
        return []
    filtered = [signals.filtered[name] for name in columns]
    rows = [free_rows(signals, name) for name in columns]
    polarity = np.array([polarity_of(signals.raw[name]) for name in columns])
    level = [polarity[i] * filtered[i].value for i in range(count)]
    pairs = list(itertools.combinations(range(count), 2))
    sums: dict[tuple[int, ...], Floats] = {(i,): level[i] for i in range(count)}
    sums |= {(i, j): level[i] + level[j] for i, j in pairs}
    differences: dict[tuple[int, ...], Floats] = {(i,): filtered[i].value for i in range(count)}
    differences |= {(i, j): level[i] - level[j] for i, j in pairs}
    elevation_nats = _log_likelihood_table(sums, filtered, rows, reference.stiffness["elevation"])
    for i in range(count):
        feedback = np.array(
            [abs(feedback_sign(level[i], signal, signals.counts_per_turn)) for signal in filtered]
        )
        elevation_nats[i,] += thresholds.FEEDBACK_NATS * feedback
    pitch_nats = _log_likelihood_table(
        differences, filtered, [signals.inner] * count, reference.stiffness["pitch"]
    )
    travel_nats = np.zeros((count, count))
    for p, t in itertools.permutations(range(count), 2):
        axis_terms = (filtered[t].value * 0.0, filtered[t].rate)
        travel_nats[p, t] = explain(
            filtered[t].acceleration, axis_terms, filtered[p].value, (0.0, 0.1), signals.inner
        ).log_likelihood_ratio
    measured = thresholds.ENCODER_NATS * np.array([name in encoders for name in columns], float)
    elevation_nats = {key: nats + measured for key, nats in elevation_nats.items()}
    pitch_nats = {key: nats + measured for key, nats in pitch_nats.items()}
    travel_nats += measured
    stated = _name_scores(columns, known)

    def physics(by_sum: tuple[int, ...], by_difference: tuple[int, ...]) -> Floats:
        """Score of each choice of elevation, pitch and travel for columns of the voltages."""
        elevation, pitch = elevation_nats[by_sum], pitch_nats[by_difference]
        return elevation[:, None, None] + pitch[None, :, None] + travel_nats[None, :, :]

    ranked = []
    for pair in pairs:
        ranked += _best(columns, physics(pair, pair), stated, pair, False, polarity)
    for pair in itertools.permutations(range(count), 2):
        ranked += _best(columns, physics(pair[:1], pair[1:]), stated, pair, True, polarity)
    return sorted(ranked, key=lambda assignment: -assignment.log_likelihood)


def _log_likelihood_table(
    causes: dict[tuple[int, ...], Floats],
    filtered: Sequence[Signal],
    rows: list[Booleans],
    stiffness: tuple[float, float],
) -> dict[tuple[int, ...], Floats]:
    """Log-likelihood ratio [nats] of each column for each cause, at its best lag; 0 for its own column."""
    table = {}
    for key, cause in causes.items():
        lagged = [delay(cause, lag_s) for lag_s in thresholds.ROLE_LAGS_S]
        nats = np.zeros(len(filtered))
        for index, signal in enumerate(filtered):
            if index in key:
                continue
            axis_terms = (signal.value - signal.value.mean(), signal.rate)
            nats[index] = max(
                explain(
                    signal.acceleration, axis_terms, late_cause, stiffness, rows[index]
                ).log_likelihood_ratio
                for late_cause in lagged
            )
        table[key] = nats
    return table


def _name_scores(columns: list[str], known: Mapping[str, str]) -> dict[str, Floats]:
    """Score of each column's name for each role [nats], shape (columns,) per role."""

    def score(name: str, role: str) -> float:
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
    stated: dict[str, Floats],
    pair: tuple[int, int],
    summed: bool,
    polarity: Floats,
) -> list[ColumnAssignment]:
    """Return the three most likely choices of angles for a pair of voltages."""
    words = np.add.outer(np.add.outer(stated["elevation"], stated["pitch"]), stated["travel"])
    i, j = pair
    if summed:
        words = words + stated["sum"][i] + stated["difference"][j]
    else:
        orders = (stated["front"][i] + stated["back"][j], stated["front"][j] + stated["back"][i])
        words = words + max(orders)
        if orders[1] > orders[0]:
            i, j = j, i
    total = physics + words
    count = len(columns)
    e, p, t = np.indices((count, count, count))
    total[(e == p) | (e == t) | (p == t)] = -np.inf
    for column in pair:
        total[(e == column) | (p == column) | (t == column)] = -np.inf
    voltages = (columns[i], columns[j])
    signs = (float(polarity[i]), 1.0 if summed else float(polarity[j]))
    best = zip(*np.unravel_index(np.argsort(total.ravel())[::-1][:3], total.shape), strict=True)
    return [
        ColumnAssignment(
            columns[angles[0]],
            columns[angles[1]],
            columns[angles[2]],
            voltages,
            summed,
            signs,
            float(total[angles]),
            float(physics[angles]),
        )
        for angles in best
        if np.isfinite(total[angles])
    ]
