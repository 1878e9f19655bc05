"""What a twin knows besides equations: weather, and how far evidence wanders while nothing changed."""

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

SEGMENT_s: Final = 5.0
"""Evidence whose maxima count as one excursion, s: the onsets that make it outlive some seconds. Longer: few
excursions to fit. Shorter: one is counted several times, and the alarms are fewer than stated."""
_LEVEL: Final = 0.8
"""Share of the segments whose maxima lie below the level from which the tail is exponential."""
_LEAST_SCALE_nats: Final = 1.0
"""Of a likelihood ratio's tail for white innovations: by Wilks it falls by a factor e a nat."""
_AXES: Final = 3


QUIET: Final = replace(DISTURBANCE_START, quantisation=np.ones(3))
"""Weather of a rig of which no flight is given: gusts of a quiet room, encoders that round."""


@dataclass(frozen=True)
class Tail:
    """How often evidence exceeds a level while nothing changed: exponentially less often the higher it is.

    Parameters
    ----------
    level_nats : float
        From here on.
    per_hour : float
        Excursions beyond it in an hour of free flight.
    scale_nats : float
        Of which one in e goes this much further.
    excesses : int
        Excursions that the scale is the mean of.
    """

    level_nats: float
    per_hour: float
    scale_nats: float
    excesses: int

    def threshold_nats(self, hours: float) -> float:
        """Level that is exceeded once in so many `hours`, on average over what the excursions may have been.

        A mean of n exponential excesses, T in all, is exceeded c T by another one with the probability
        (1 + c)^-n: so the tail that is used is longer the fewer there were, and exponential for many.
        """
        wanted = max(self.per_hour * hours, 1.0)
        beyond = self.excesses * math.expm1(math.log(wanted) / self.excesses)
        return self.level_nats + self.scale_nats * beyond


def segment_maxima(course: Sequence[tuple[float, float]]) -> list[float]:
    """Largest evidence [nats] of each `SEGMENT_s` of a `course` of times [s] and evidence."""
    times, evidence = np.array(course, float).reshape(-1, 2).T
    known = np.isfinite(evidence)
    times, evidence = times[known], evidence[known]
    if not len(times):
        return []
    number = ((times - times[0]) // SEGMENT_s).astype(int)
    return [float(evidence[number == segment].max()) for segment in np.unique(number)]


def fit_tail(flights: Sequence[Sequence[tuple[float, float]]], taught_s: float = math.inf) -> Tail:
    """Fit the tail of the evidence to healthy flights.

    Where the rig's numbers were found in flights themselves, their error adds to that of what is found in a
    window: the variance of the difference is larger by the factor 1 + window / taught, and so is evidence,
    which is half a square in standard deviations. Flights that are simulated with these very numbers, and
    flights that they were found in, do not show it.

    Parameters
    ----------
    flights : sequence of sequence of (float, float)
        Times [s] and evidence [nats] of each.
    taught_s : float
        Flight that the rig's numbers were found in, s; infinite where they are known.

    Raises
    ------
    TwinError
        There are too few.
    """
    maxima = [maximum for course in flights for maximum in segment_maxima(course)]
    if len(maxima) < 10:
        raise TwinError(
            f"{len(maxima)} segments of {SEGMENT_s:g} s of nominal flight are too few for a threshold",
            "give a longer flight",
        )
    level = float(np.quantile(maxima, _LEVEL))
    over = np.array([maximum - level for maximum in maxima if maximum > level])
    scale = max(float(over.mean()), _LEAST_SCALE_nats)
    hours = len(maxima) * SEGMENT_s / 3600.0
    wider = 1.0 + WINDOW_s / taught_s
    return Tail(level * wider, len(over) / hours, scale * wider, len(over))


@dataclass(frozen=True)
class Calibration:
    """Weather and tail.

    Parameters
    ----------
    disturbances : DisturbanceModel
        Torques by chance that the rig meets.
    tail : Tail
        Of the evidence in healthy flights.
    source : str
        Where they come from.
    """

    disturbances: DisturbanceModel
    tail: Tail
    source: str = ""

    def threshold_nats(self, hours: float) -> float:
        """Evidence that is an alarm, for one false one in so many `hours`."""
        return self.tail.threshold_nats(hours)


def calibration_text(calibration: Calibration, rig: str) -> str:
    """Write a calibration as the text of a twin's file, TOML; `rig` is the name or the path of its rig."""
    disturbances, tail = calibration.disturbances, calibration.tail

    def listed(values: Floats) -> str:
        return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"

    return (
        "# A twin: a rig, the weather that it meets, and how far evidence wanders while nothing changed.\n"
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
    """Write a twin's file to `path`; `rig` is the name or the path of its rig."""
    path.write_text(calibration_text(calibration, rig), encoding="utf-8")


def parse_calibration(data: Mapping[str, Any], name: str) -> Calibration:
    """Read a twin's file.

    Parameters
    ----------
    data : Mapping
        Its TOML.
    name : str
        Of the file, for messages.

    Raises
    ------
    TwinError
        Something is missing, or no number.
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
