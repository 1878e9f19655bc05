"""Where a prediction extrapolates: voltages outside of those in the fitted flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.explain.evaluate.free_run import FreeRun
from heli_lab.explain.thresholds import OUTSIDE_SHARE, VOLTAGE_TAIL
from heli_lab.fit.records import Record

_ROTORS: Final = ("front", "back")


@dataclass(frozen=True)
class Extrapolation:
    """Windows of a flight whose voltages are outside of those of the fitted flights."""

    label: str  # Name of the flight
    ranges_V: dict[str, tuple[float, float]]
    """Voltages of each rotor in the fitted flights, without the tails."""
    windows: int  # Number of windows of 2 s that are predicted
    spans_s: tuple[tuple[float, float], ...]
    """Begin and end of each window that has other voltages for more than `OUTSIDE_SHARE` of its time."""


def extrapolations(fitted: Sequence[Record], runs: Sequence[FreeRun]) -> tuple[Extrapolation, ...]:
    """Find the windows of free runs in which the model extrapolates."""
    voltages_V = np.concatenate(
        [record.voltages_V[start:stop] for record in fitted for start, stop in record.segments]
    )
    low_V, high_V = np.quantile(voltages_V, [VOLTAGE_TAIL, 1.0 - VOLTAGE_TAIL], axis=0)
    ranges_V = {
        rotor: (float(low), float(high)) for rotor, low, high in zip(_ROTORS, low_V, high_V, strict=True)
    }
    return tuple(_extrapolation(run, ranges_V, low_V, high_V) for run in runs)


def _extrapolation(
    run: FreeRun, ranges_V: dict[str, tuple[float, float]], low_V: Floats, high_V: Floats
) -> Extrapolation:
    """Find the windows of a free run whose voltages are outside of `low_V` and `high_V`, shape (2,) each."""
    (record,) = run.fit.problem.records
    windows = run.fit.problem.windows(0)
    spans_s = []
    for first, count in windows:
        rows = slice(first, first + count)
        voltages_V = record.voltages_V[rows]
        is_outside = ((voltages_V < low_V) | (voltages_V > high_V)).any(axis=1)
        if is_outside.mean() > OUTSIDE_SHARE:
            spans_s.append((float(record.t_s[rows][0]), float(record.t_s[rows][-1])))
    return Extrapolation(run.label, ranges_V, len(windows), tuple(spans_s))
