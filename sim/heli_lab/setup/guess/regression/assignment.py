"""Assign columns to roles: the sum of the voltages drives elevation, their difference pitch, pitch travel."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from heli_host.data.arrays import Booleans, Floats

from heli_lab.setup.guess import names, thresholds
from heli_lab.setup.guess.regression.acceleration_fit import regress_acceleration
from heli_lab.setup.guess.regression.candidates import feedback_sign
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.signals import Signal, Signals, delay

ColumnIndices = tuple[int, ...]
"""Columns whose sum or difference drives an axis: one index for a column that is itself the sum or the
difference, two indices for the front and the back voltage."""


@dataclass(frozen=True)
class ColumnAssignment:
    """Columns of a table, by role."""

    elevation: str  # elevation, pitch, travel: Names of the angle columns
    pitch: str
    travel: str
    voltages: tuple[str, str]  # Names of the voltage columns
    summed: bool  # Whether the voltages are sum and difference instead of front and back
    polarity: tuple[float, float]  # Factors, 1 or -1, after which positive voltages lift
    log_likelihood: float  # Log-likelihood of the motion and the columns' names [nats]
    physics_log_likelihood: float  # Log-likelihood of the motion alone [nats]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all five columns, angles first."""
        return (self.elevation, self.pitch, self.travel, *self.voltages)

    def same_as(self, other: ColumnAssignment) -> bool:
        """Whether another assignment uses the same columns; front and back may be exchanged."""
        same_voltages = self.voltages == other.voltages
        if not self.summed:
            same_voltages = same_voltages or self.voltages == other.voltages[::-1]
        same_angles = self.columns[:3] == other.columns[:3]
        return same_angles and self.summed == other.summed and same_voltages


def free_rows(signals: Signals, name: str) -> Booleans:
    """Select the rows in which the arm is off its table, if the column `name` is the elevation. Returns
    shape (n,).
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
    """Return the sign, 1 or -1, that makes the mean of a voltage's `values` positive; 1 if it is near 0."""
    mean = float(values.mean())
    return -1.0 if mean < 0.0 and abs(mean) > 0.5 * float(values.std()) else 1.0


def assignments(
    signals: Signals,
    reference: Reference,
    columns: list[str],
    encoders: Collection[str] = frozenset(),
    known: Mapping[str, str] = MappingProxyType({}),
) -> list[ColumnAssignment]:
    """List the assignments of columns to roles with their log-likelihoods, the most likely first."""
    count = len(columns)
    if count < 5:
        return []
    polarity = np.array([polarity_of(signals.raw[name]) for name in columns])
    encoder_nats = thresholds.ENCODER_NATS * np.array([name in encoders for name in columns], float)
    elevation_nats = _elevation_nats(signals, columns, polarity, reference)
    pitch_nats = _pitch_nats(signals, columns, polarity, reference)
    elevation_nats = {voltages: nats + encoder_nats for voltages, nats in elevation_nats.items()}
    pitch_nats = {voltages: nats + encoder_nats for voltages, nats in pitch_nats.items()}
    travel_nats = _travel_nats(signals, columns) + encoder_nats
    name_nats = _name_scores(columns, known)

    def physics_nats(sum_columns: ColumnIndices, difference_columns: ColumnIndices) -> Floats:
        """Score each choice of elevation, pitch and travel for given voltage columns; one array dimension per
        axis, shape (columns, columns, columns).
        """
        elevation, pitch = elevation_nats[sum_columns], pitch_nats[difference_columns]
        return elevation[:, None, None] + pitch[None, :, None] + travel_nats[None, :, :]

    ranked = []
    for front_and_back in itertools.combinations(range(count), 2):
        nats = physics_nats(front_and_back, front_and_back)
        ranked += _best_angles(columns, nats, name_nats, front_and_back, polarity, summed=False)
    for sum_and_difference in itertools.permutations(range(count), 2):
        nats = physics_nats(sum_and_difference[:1], sum_and_difference[1:])
        ranked += _best_angles(columns, nats, name_nats, sum_and_difference, polarity, summed=True)
    return sorted(ranked, key=lambda assignment: -assignment.log_likelihood)


def _elevation_nats(
    signals: Signals, columns: list[str], polarity: Floats, reference: Reference
) -> dict[ColumnIndices, Floats]:
    """Weigh, for each sum of voltages, which column it drives as the elevation. Shapes: `polarity`
    (columns,); returns (columns,).
    """
    filtered = [signals.filtered[name] for name in columns]
    lifting = [sign * signal.value for sign, signal in zip(polarity, filtered, strict=True)]
    sums: dict[ColumnIndices, Floats] = {(i,): voltage for i, voltage in enumerate(lifting)}
    for i, j in itertools.combinations(range(len(columns)), 2):
        sums[i, j] = lifting[i] + lifting[j]
    off_table = [free_rows(signals, name) for name in columns]
    nats = _log_likelihood_table(sums, filtered, off_table, reference.stiffness["elevation"])
    for i, voltage in enumerate(lifting):
        has_feedback = np.array(
            [abs(feedback_sign(voltage, angle, signals.counts_per_turn)) for angle in filtered]
        )
        nats[i,] += thresholds.FEEDBACK_NATS * has_feedback
    return nats


def _pitch_nats(
    signals: Signals, columns: list[str], polarity: Floats, reference: Reference
) -> dict[ColumnIndices, Floats]:
    """Weigh, for each difference of voltages, which column it drives as pitch; like `_elevation_nats`."""
    filtered = [signals.filtered[name] for name in columns]
    lifting = [sign * signal.value for sign, signal in zip(polarity, filtered, strict=True)]
    # A logged difference has no polarity: its mean is near 0.
    differences: dict[ColumnIndices, Floats] = {(i,): signal.value for i, signal in enumerate(filtered)}
    for i, j in itertools.combinations(range(len(columns)), 2):
        differences[i, j] = lifting[i] - lifting[j]
    inner_rows = [signals.inner] * len(columns)
    return _log_likelihood_table(differences, filtered, inner_rows, reference.stiffness["pitch"])


def _travel_nats(signals: Signals, columns: list[str]) -> Floats:
    """Weigh for each pair of columns whether the first, as pitch, drives the second, as travel. Returns
    shape (columns, columns).
    """
    filtered = [signals.filtered[name] for name in columns]
    nats = np.zeros((len(columns), len(columns)))
    for pitch, travel in itertools.permutations(range(len(columns)), 2):
        axis_terms = (filtered[travel].value * 0.0, filtered[travel].rate)
        nats[pitch, travel] = regress_acceleration(
            filtered[travel].acceleration, axis_terms, filtered[pitch].value, (0.0, 0.1), signals.inner
        ).log_likelihood_ratio
    return nats


def _log_likelihood_table(
    causes: dict[ColumnIndices, Floats],
    filtered: Sequence[Signal],
    rows: list[Booleans],
    stiffness: tuple[float, float],
) -> dict[ColumnIndices, Floats]:
    """Weigh for each cause and each column whether the cause drives the column as an angle, at the best lag.
    Shapes: `causes` (n,), `rows` (n,), `stiffness` (float, float); returns (columns,).
    """
    table = {}
    for cause_columns, cause in causes.items():
        lagged = [delay(cause, lag_s) for lag_s in thresholds.ROLE_LAGS_S]
        nats = np.zeros(len(filtered))
        for index, signal in enumerate(filtered):
            if index in cause_columns:
                continue
            axis_terms = (signal.value - signal.value.mean(), signal.rate)
            nats[index] = max(
                regress_acceleration(
                    signal.acceleration, axis_terms, lagged_cause, stiffness, rows[index]
                ).log_likelihood_ratio
                for lagged_cause in lagged
            )
        table[cause_columns] = nats
    return table


def _name_scores(columns: list[str], known: Mapping[str, str]) -> dict[str, Floats]:
    """Score each column for each role by its name [nats], shape (columns,) per role; `known` roles by
    column.
    """

    def score(name: str, role: str) -> float:
        """Log-likelihood ratio of a `role` of the column `name`; a role that the user knows decides."""
        named_role = names.role_of(name)
        if name in known or role in known.values():
            return thresholds.KNOWN_NATS * (1.0 if known.get(name) == role else -1.0)
        if named_role:
            return thresholds.NAME_NATS * (1.0 if named_role == role else -1.0)
        return -thresholds.DERIVED_SIGNAL_NATS if names.is_derived_signal(name) else 0.0

    return {role: np.array([score(name, role) for name in columns]) for role in names.ROLES}


def _best_angles(
    columns: list[str],
    physics_nats: Floats,
    name_nats: dict[str, Floats],
    voltage_columns: tuple[int, int],
    polarity: Floats,
    *,
    summed: bool,
) -> list[ColumnAssignment]:
    """Find the three most likely choices of the angle columns for given voltage columns. Shapes:
    `physics_nats` (columns, columns, columns), `name_nats` (columns,), `voltage_columns` (int, int),
    `polarity` (columns,).
    """
    names_nats = np.add.outer(np.add.outer(name_nats["elevation"], name_nats["pitch"]), name_nats["travel"])
    i, j = voltage_columns
    if summed:
        names_nats = names_nats + name_nats["sum"][i] + name_nats["difference"][j]
    else:
        front_first = name_nats["front"][i] + name_nats["back"][j]
        back_first = name_nats["front"][j] + name_nats["back"][i]
        names_nats = names_nats + max(front_first, back_first)
        if back_first > front_first:
            i, j = j, i
    total_nats = physics_nats + names_nats
    elevation, pitch, travel = np.indices(total_nats.shape)
    # No column has two roles.
    total_nats[(elevation == pitch) | (elevation == travel) | (pitch == travel)] = -np.inf
    for voltage in voltage_columns:
        total_nats[(elevation == voltage) | (pitch == voltage) | (travel == voltage)] = -np.inf
    three_best = np.argsort(total_nats.ravel())[::-1][:3]
    return [
        ColumnAssignment(
            elevation=columns[angles[0]],
            pitch=columns[angles[1]],
            travel=columns[angles[2]],
            voltages=(columns[i], columns[j]),
            summed=summed,
            polarity=(float(polarity[i]), 1.0 if summed else float(polarity[j])),
            log_likelihood=float(total_nats[angles]),
            physics_log_likelihood=float(physics_nats[angles]),
        )
        for angles in zip(*np.unravel_index(three_best, total_nats.shape), strict=True)
        if np.isfinite(total_nats[angles])
    ]
