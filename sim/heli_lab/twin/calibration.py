"""The calibration of a twin: disturbances of the rig, and the tail of the evidence without a change."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.errors import TwinError
from heli_lab.estimation import DisturbanceModel
from heli_lab.identify.flight_model import DISTURBANCE_START
from heli_lab.twin.likelihood_ratio import WINDOW_s
from heli_lab.twin.parameter_uncertainty import EXACT, ParameterUncertainty

SEGMENT_s: Final = 5.0
"""Length of the segments whose maxima are counted as excursions of the evidence, s. An onset stays in the
window for some seconds. Longer: few excursions to fit. Shorter: one excursion counts several times, and the
alarms are rarer than stated."""
_LEVEL: Final = 0.8
"""Share of the segments whose maxima lie below the level from which the tail is exponential."""
_MIN_SCALE_nats: Final = 1.0
"""Scale of the tail of a likelihood ratio for white innovations, nats: by Wilks it falls by e per nat."""
_AXES: Final = 3


DEFAULT_DISTURBANCES: Final = replace(DISTURBANCE_START, quantisation=np.ones(3))
"""Disturbances of a rig without nominal flights: gusts of a quiet room, encoders that round."""


@dataclass(frozen=True)
class Tail:
    """Exponential tail of the evidence without a change.

    Parameters
    ----------
    level_nats : float
        Evidence from which the tail is exponential [nats].
    per_hour : float
        Rate of excursions above the level, per hour of free flight.
    scale_nats : float
        Mean excess of an excursion over the level [nats].
    excesses : int
        Number of excursions from which the scale was estimated.
    """

    level_nats: float
    per_hour: float
    scale_nats: float
    excesses: int

    def threshold_nats(self, false_alarm_interval_h: float) -> float:
        """Return the evidence that is exceeded once per `false_alarm_interval_h` of free flight [nats], on
        average over the sampling of the excursions.

        Given n exponential excesses with the sum T, another one exceeds c T with the probability (1 + c)^-n.
        Therefore few excesses give a longer tail, and many give an exponential one.
        """
        wanted = max(self.per_hour * false_alarm_interval_h, 1.0)
        beyond = self.excesses * math.expm1(math.log(wanted) / self.excesses)
        return self.level_nats + self.scale_nats * beyond


def segment_maxima(history: Sequence[tuple[float, float]]) -> list[float]:
    """Return the largest evidence [nats] of each segment of `SEGMENT_s`; `history` holds times [s] and
    evidence.
    """
    times, evidence = np.array(history, float).reshape(-1, 2).T
    known = np.isfinite(evidence)
    times, evidence = times[known], evidence[known]
    if not len(times):
        return []
    number = ((times - times[0]) // SEGMENT_s).astype(int)
    return [float(evidence[number == segment].max()) for segment in np.unique(number)]


def fit_tail(flights: Sequence[Sequence[tuple[float, float]]], training_s: float = math.inf) -> Tail:
    """Fit the tail of the evidence to nominal flights.

    If the rig's parameters were estimated from flights, their errors add to the error of an estimate from one
    window. The variance of the difference is larger by 1 + window / training time, and so is the evidence,
    which is half a squared standard score. Flights that are simulated with the estimated parameters, and the
    training flights themselves, do not show this.

    Parameters
    ----------
    flights : sequence of sequence of (float, float)
        Times [s] and evidence [nats] of each flight.
    training_s : float
        Length of the flights from which the rig's parameters were estimated [s]; infinite if these are exact.

    Raises
    ------
    TwinError
        The flights are too short.
    """
    maxima = [maximum for history in flights for maximum in segment_maxima(history)]
    if len(maxima) < 10:
        raise TwinError(
            f"{len(maxima)} segments of {SEGMENT_s:g} s of nominal flight are too few for a threshold",
            "give a longer flight",
        )
    level = float(np.quantile(maxima, _LEVEL))
    over = np.array([maximum - level for maximum in maxima if maximum > level])
    scale = max(float(over.mean()), _MIN_SCALE_nats)
    flown_h = len(maxima) * SEGMENT_s / 3600.0
    wider = 1.0 + WINDOW_s / training_s
    return Tail(level * wider, len(over) / flown_h, scale * wider, len(over))


@dataclass(frozen=True)
class Calibration:
    """Calibration of a twin.

    Parameters
    ----------
    disturbances : DisturbanceModel
        Gusts and drift of the rig, and the quantisation of its encoders.
    tail : Tail
        Tail of the evidence in nominal flights.
    source : str
        Flights from which both were estimated.
    uncertainty : ParameterUncertainty
        Errors of the rig's parameters, as far as these flights leave them open.
    """

    disturbances: DisturbanceModel
    tail: Tail
    source: str = ""
    uncertainty: ParameterUncertainty = EXACT

    def threshold_nats(self, false_alarm_interval_h: float) -> float:
        """Return the alarm threshold [nats] for one false alarm per `false_alarm_interval_h`."""
        return self.tail.threshold_nats(false_alarm_interval_h)


def calibration_text(calibration: Calibration, rig: str) -> str:
    """Return the text of a twin file (TOML); `rig` is the name or the path of the rig."""
    disturbances, tail = calibration.disturbances, calibration.tail

    def listed(values: Floats) -> str:
        return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"

    return (
        "# A twin: a rig, its disturbances, and the tail of the evidence without a change.\n"
        "# Written by heli-host twin; order of the axes: elevation, pitch, travel.\n"
        f"rig = {_quoted(rig)}\n"
        f"source = {_quoted(calibration.source)}\n\n"
        "[disturbances]\n"
        f"fast_std_Nm = {listed(disturbances.fast_std)}\n"
        f"correlation_time_s = {listed(disturbances.correlation_time_s)}\n"
        f"slow_std_Nm = {listed(disturbances.slow_std)}\n"
        f"quantisation = {listed(disturbances.quantisation)}\n\n"
        "[tail]\n"
        f"level_nats = {tail.level_nats:.6g}\n"
        f"per_hour = {tail.per_hour:.6g}\n"
        f"scale_nats = {tail.scale_nats:.6g}\n"
        f"excesses = {tail.excesses}\n"
    )


def write_calibration(path: Path, calibration: Calibration, rig: str) -> None:
    """Write a twin file to `path`; `rig` is the name or the path of the rig."""
    path.write_text(calibration_text(calibration, rig), encoding="utf-8")


def parse_calibration(data: Mapping[str, Any], name: str) -> Calibration:
    """Read the calibration in a twin file.

    Parameters
    ----------
    data : Mapping
        Parsed TOML of the file.
    name : str
        Name of the file, for error messages.

    Raises
    ------
    TwinError
        A key is missing, or a value is invalid.
    """
    numbers = {}
    for key, unit in (
        ("fast_std", "_Nm"),
        ("correlation_time_s", ""),
        ("slow_std", "_Nm"),
        ("quantisation", ""),
    ):
        values = _table(data, "disturbances", name).get(f"{key}{unit}")
        if not isinstance(values, list) or len(values) != _AXES or not all(map(_is_positive, values)):
            raise TwinError(f"{name}: disturbances.{key}{unit} is not three positive numbers", _AGAIN)
        numbers[key] = np.array(values, float)
    excesses = _table(data, "tail", name).get("excesses")
    if not isinstance(excesses, int) or isinstance(excesses, bool) or excesses < 1:
        raise TwinError(f"{name}: tail.excesses is not a count", _AGAIN)
    tail = {}
    for key in ("level_nats", "per_hour", "scale_nats"):
        value = _table(data, "tail", name).get(key)
        if value is None or not _is_number(value):
            raise TwinError(f"{name}: tail.{key} is not a number", _AGAIN)
        tail[key] = float(value)
    return Calibration(
        DisturbanceModel(**numbers), Tail(**tail, excesses=excesses), str(data.get("source", ""))
    )


_AGAIN: Final = "write it again with heli-host twin --learn"


def _table(data: Mapping[str, Any], key: str, name: str) -> Mapping[str, Any]:
    table = data.get(key)
    if not isinstance(table, dict):
        raise TwinError(f"{name} has no [{key}]", _AGAIN)
    return table


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_positive(value: Any) -> bool:
    return _is_number(value) and value > 0


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
