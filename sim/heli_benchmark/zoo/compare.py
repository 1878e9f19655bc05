"""Compare imported flights with the truth of a case, without any code of the importer."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES

from heli_benchmark.zoo.case import ImportTruth, Samples
from heli_benchmark.zoo.words import MOTORS

_SEARCH_STEP_S: Final = 0.04
_FINE_SHIFTS_S: Final = np.linspace(-0.08, 0.08, 81)
"""Times about the best one of the coarse search that are compared: two of its steps to each side."""
_CHANGE_S: Final = 0.2
"""Time over which changes of the angles are compared. Over single rows, quantised angles hardly change, and a
slow part resembles itself at many times."""
_SAME_PLACE: Final = 0.97
"""Share of the best score from which a short part of a flight is where the clock of a longer one says."""
_COMPARED_ROWS: Final = 1500
"""Rows of a flight at which voltages are compared at many lags; more change no verdict."""
_ANGLE_SCALE: Final = 0.02
"""Largest error of an angle's scale. Units that are confused differ by 10 % and more."""
_VOLTAGE_SCALE: Final = 0.03
_UNKNOWN_SUPPLY_SCALE: Final = 0.08
"""Largest error of a voltage's scale if the file does not show the supply."""
_ZERO_RAD: Final = np.radians(1.5)
"""Largest error of a zero that the file shows. The rest on the table and level differ by some 25 deg."""
_ANGLE_RMS: Final = 0.03
"""Largest rms error of an angle, as a share of its standard deviation."""
_PEAK_RAD: Final = np.radians(3.0)
"""Largest error of one row of an angle, in addition to what the clock permits. Damaged cells give more."""
_VOLTAGE_RMS: Final = 0.35
"""Largest rms error of a voltage, as a share of its standard deviation. Controllers switch voltages from row
to row, so that a row's error of time counts much; a wrong column has 1 and more."""
_MAX_LOST_S: Final = 0.6
"""Time of a flight that an import may lack at its ends [s]."""


@dataclass(frozen=True)
class ImportedFlight:
    """A flight as the importer has written it."""

    t_s: Floats
    columns: Mapping[str, Floats]  # Angles [rad] and voltages [V], by axis and motor


def mistakes(flights: Sequence[ImportedFlight], truth: ImportTruth) -> list[str]:
    """Name all differences between imported flights and the truth; empty if the import is right."""
    # The beginning of a flight's clock is free. Each flight is placed where its motion is that of the truth.
    differences: list[str] = []
    spans: list[tuple[float, float]] = []
    shifts_s: list[float] = []
    for flight in sorted(flights, key=lambda flight: -flight.t_s.size):
        shifts_s.append(_shift(flight, truth, shifts_s))
        span, flight_mistakes = _flight_mistakes(flight, truth, shifts_s[-1])
        spans.append(span)
        differences += flight_mistakes
    covered_s = _union_s(spans)
    true_s = truth.samples["pitch"].t_s
    available_s = float(true_s[-1] - true_s[0]) - truth.lost_s
    if covered_s < available_s - max(_MAX_LOST_S, 0.02 * available_s):
        differences.append(f"rows: {available_s - covered_s:.1f} of {available_s:.1f} s are not imported")
    return list(dict.fromkeys(differences))


def row_difference(flights: Sequence[ImportedFlight], truth: ImportTruth) -> int:
    """Imported rows minus the intact rows of the file."""
    return sum(flight.t_s.size for flight in flights) - truth.row_count


def _union_s(spans: Sequence[tuple[float, float]]) -> float:
    total, end = 0.0, -np.inf
    for start, stop in sorted(spans):
        total += max(0.0, stop - max(start, end))
        end = max(end, stop)
    return float(total)


def _flight_mistakes(
    flight: ImportedFlight, truth: ImportTruth, shift_s: float
) -> tuple[tuple[float, float], list[str]]:
    """Return the part of the true flight that an imported flight covers, and its mistakes."""
    at_s = flight.t_s + shift_s
    span = (float(at_s[0]), float(at_s[-1]))
    differences = []
    duration_s, true_s = float(np.ptp(flight.t_s)), truth.samples["pitch"].t_s
    if duration_s > 1.02 * float(np.ptp(true_s)) + _MAX_LOST_S:
        differences.append(f"clock: {duration_s:.1f} s instead of {float(np.ptp(true_s)):.1f} s")
    rows = np.unique(np.linspace(0, at_s.size - 1, min(at_s.size, _COMPARED_ROWS)).round().astype(int))
    is_within = (at_s >= true_s[0]) & (at_s <= true_s[-1])
    rows = rows[is_within[rows]]
    if rows.size < 10:
        return span, [*differences, "clock: the flight is not the logged one"]
    for axis in AXES:
        differences += _angle_mistakes(
            axis, at_s[is_within], flight.columns[axis][is_within], truth.samples[axis], truth
        )
    motors = _voltage_mistakes(flight, at_s, rows, truth)
    if motors and not _voltage_mistakes(flight, at_s, rows, truth, exchanged=True):
        motors = ["mirror: front and back are exchanged"]
    return span, differences + motors


def _angle_mistakes(
    axis: str, at_s: Floats, imported: Floats, samples: Samples, truth: ImportTruth
) -> list[str]:
    """Compare an angle: sign, scale, values, and zero."""
    true = np.interp(at_s, samples.t_s, samples.values)
    deviation = true - true.mean()
    # Slope of the imported angle over the true one, by least squares.
    scale = float(deviation @ (imported - imported.mean()) / max(float(deviation @ deviation), 1e-12))
    sign = np.sign(scale) or 1.0
    differences = []
    if scale < 0.0:
        differences.append(f"{axis}: opposite sign")
    size = abs(scale)
    error = imported - imported.mean() - sign * deviation
    rates = np.gradient(samples.values, samples.t_s)
    rms_rate = float(np.sqrt(np.mean(rates**2)))
    peak_rate = float(np.quantile(np.abs(rates), 0.999))
    step = truth.value_step[axis]
    tolerance = max(_ANGLE_RMS * float(true.std()), 2.0 * step, rms_rate * truth.time_tolerance_s)
    if abs(size - 1.0) > _ANGLE_SCALE + 2.0 * tolerance / max(float(np.ptp(true)), 1e-9):
        differences.append(f"{axis}: scale {size:.3g}")
    elif float(error.std()) > tolerance:
        differences.append(f"{axis}: values differ by {np.degrees(error.std()):.2f} deg rms")
    elif float(np.abs(error).max()) > _PEAK_RAD + 2.0 * step + 4.0 * peak_rate * truth.time_tolerance_s:
        differences.append(f"{axis}: a row differs by {np.degrees(np.abs(error).max()):.1f} deg")
    zero = float(np.median(imported - sign * true))
    # The zero of the travel is free, and a wrong scale or sign would move any zero.
    if axis != "travel" and not differences and abs(zero) > _ZERO_RAD:
        differences.append(f"{axis}: zero differs by {np.degrees(zero):.1f} deg")
    return differences


def _voltage_mistakes(
    flight: ImportedFlight, at_s: Floats, rows: Floats, truth: ImportTruth, *, exchanged: bool = False
) -> list[str]:
    """Compare voltages: scale, values, and their time relative to the angles."""
    differences = []
    for motor, other in itertools.permutations(MOTORS):
        samples = truth.samples[other if exchanged else motor]
        imported = flight.columns[motor][rows]
        lags_s = np.arange(-0.3, 0.3001, 0.01)
        # The value that the logger had last, at each lag of the imported voltage.
        errors = []
        for lag_s in lags_s:
            true = _last_value(samples, at_s[rows] - lag_s)
            errors.append(float(np.mean((imported - true) ** 2)))
        lag_s = float(lags_s[int(np.argmin(errors))])  # of the imported voltage against the true one
        # No lag is assumed if the voltages agree nearly as well without it.
        error_without_lag = errors[int(np.argmin(np.abs(lags_s)))]
        if error_without_lag < 1.15 * min(errors):
            lag_s = 0.0
        true = _last_value(samples, at_s[rows] - lag_s)
        spread = max(float(np.std(true)), 1e-9)
        scale = float(true @ imported / max(float(true @ true), 1e-12))
        # Rows that switch from row to row pull the scale towards 0.
        mean_scale = float(imported.mean() / true.mean()) if abs(true.mean()) > 0.3 * spread else scale
        limit = _UNKNOWN_SUPPLY_SCALE if "supply" in truth.unknown else _VOLTAGE_SCALE
        step = truth.value_step[motor]
        time_step_s = float(np.median(np.diff(samples.t_s)))
        if abs(mean_scale - 1.0) > limit + 2.0 * step / max(abs(float(true.mean())), spread):
            differences.append(f"{motor}: scale {mean_scale:.3g}")
        else:
            neighbours = mean_scale * _values_near(samples, at_s[rows] - lag_s, truth.time_tolerance_s)
            error_V = float(np.sqrt(np.mean(np.abs(imported - neighbours).min(axis=0) ** 2)))
            if error_V > _VOLTAGE_RMS * spread + 2.0 * step:
                differences.append(f"{motor}: values differ by {error_V:.2f} V rms")
                continue
            if abs(lag_s) > max(0.015, 1.6 * time_step_s, 1.5 * truth.time_tolerance_s):
                differences.append(f"{motor}: late by {lag_s:.2f} s")
    return differences


def _values_near(samples: Samples, at_s: Floats, tolerance_s: float) -> Floats:
    """Return the values of each row within the tolerance of its time, shape (3, n)."""
    # Rows of a clock that jitters are brought to even times, and the voltage may be switched between the two.
    return np.array([_last_value(samples, at_s + shift_s) for shift_s in (0.0, -tolerance_s, tolerance_s)])


def _last_value(samples: Samples, at_s: Floats) -> Floats:
    last = np.clip(np.searchsorted(samples.t_s, at_s + 1e-6, side="right") - 1, 0, None)
    return np.asarray(samples.values[last])


def _shift(flight: ImportedFlight, truth: ImportTruth, longer_s: Sequence[float]) -> float:
    """Find the time of the truth minus that of an imported flight, by the motion of all angles."""
    # The parts of a flight may have one clock, so the times of longer parts, `longer_s`, are preferred.
    true_s = truth.samples["pitch"].t_s
    rows = np.unique(np.linspace(0, flight.t_s.size - 1, min(flight.t_s.size, 500)).round().astype(int))
    first_s, last_s = true_s[0] - flight.t_s[0] - 1.0, true_s[-1] - flight.t_s[-1] + 1.0
    if last_s < first_s:
        first_s, last_s = last_s, first_s
    coarse = np.arange(first_s, last_s + _SEARCH_STEP_S, _SEARCH_STEP_S)
    best = _best_shift(flight, truth, rows, coarse)
    if longer_s:
        scores = _shift_scores(flight, truth, rows, np.array([best, *longer_s]))
        likeliest = int(np.argmax(scores[1:]))
        best = longer_s[likeliest] if scores[1 + likeliest] > _SAME_PLACE * scores[0] else best
    return _best_shift(flight, truth, rows, best + _FINE_SHIFTS_S)


def _best_shift(flight: ImportedFlight, truth: ImportTruth, rows: Floats, shifts_s: Floats) -> float:
    return float(shifts_s[int(np.argmax(_shift_scores(flight, truth, rows, shifts_s)))])


def _shift_scores(flight: ImportedFlight, truth: ImportTruth, rows: Floats, shifts_s: Floats) -> Floats:
    """Return how well the imported flight agrees with the truth if the truth's clock is ahead by each of
    `shifts_s`: the sum over the angles of the correlation between their changes.
    """
    # Slow motion carries no information about the time, therefore changes are compared and not angles.
    change_s = min(_CHANGE_S, 0.25 * float(np.ptp(flight.t_s)))
    later_rows = np.searchsorted(flight.t_s, flight.t_s[rows] + change_s)
    in_flight = later_rows < flight.t_s.size
    rows, later_rows = rows[in_flight], later_rows[in_flight]
    begin_s, end_s = flight.t_s[rows], flight.t_s[later_rows]
    scores = np.zeros(shifts_s.size)
    for axis in AXES:
        samples = truth.samples[axis]
        imported_change = flight.columns[axis][later_rows] - flight.columns[axis][rows]
        for index, shift_s in enumerate(shifts_s):
            true_end = np.interp(end_s + shift_s, samples.t_s, samples.values)
            true_change = true_end - np.interp(begin_s + shift_s, samples.t_s, samples.values)
            scores[index] += _correlation(true_change, imported_change)
    return scores


def _correlation(a: Floats, b: Floats) -> float:
    """Return the absolute cosine similarity of two vectors; 0 if one of them is 0."""
    norms = float(np.linalg.norm(a) * np.linalg.norm(b))
    return abs(float(a @ b)) / norms if norms > 0.0 else 0.0
