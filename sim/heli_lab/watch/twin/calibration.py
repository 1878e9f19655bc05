"""The calibration of a twin: disturbances and uncertainty of the rig, and the tail of the evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.files import toml_string, write_signed

from heli_lab.errors import TwinError
from heli_lab.fit.flight_model import DISTURBANCE_START
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.twin.parameter_uncertainty import EXACT, ParameterUncertainty
from heli_lab.watch.twin.tail import IDEAL, Tail

_AXES, _ROTORS = 3, 2
_DISTURBANCES: Final = ("fast_std_Nm", "correlation_time_s", "slow_std_Nm", "quantisation")
"""Entries of the table [disturbances] of a twin file."""


DEFAULT_DISTURBANCES: Final = replace(DISTURBANCE_START, quantisation=np.ones(3))
"""Disturbances of a rig without nominal flights: gusts of a quiet room, encoders that round."""


@dataclass(frozen=True)
class Calibration:
    """Calibration of a twin."""

    disturbances: DisturbanceModel  # Gusts and drift of the rig, and the quantisation of its encoders
    tail: Tail  # Tail of the evidence in nominal flights
    source: str = ""  # Flights from which both were estimated
    uncertainty: ParameterUncertainty = EXACT
    """Errors of the rig's parameters, as far as these flights leave them open."""

    def threshold_nats(self, false_alarm_interval_h: float) -> float:
        """Return the alarm threshold [nats] for one false alarm per `false_alarm_interval_h`.

        If the nominal flights support only a shorter interval, the threshold is that of the longest supported
        interval. The threshold is at least that of a twin with the true parameters.
        """
        return max(
            self.tail.threshold_nats(false_alarm_interval_h), IDEAL.threshold_nats(false_alarm_interval_h)
        )


def calibration_text(calibration: Calibration, rig: str) -> str:
    """Return the text of a twin file (TOML); `rig` is the name or the path of the rig."""
    disturbance_lines = "".join(
        f"{key} = {_toml_list(getattr(calibration.disturbances, key.removesuffix('_Nm')))}\n"
        for key in _DISTURBANCES
    )
    numbers = ("level_nats", "per_hour", "scale_nats", "excesses", "shape", "healthy_s")
    tail_lines = "".join(f"{name} = {getattr(calibration.tail, name):.6g}\n" for name in numbers)
    return (
        "# A twin: a rig, its disturbances, and the tail of the evidence without a change.\n"
        "# Written by heli-host twin; order of the axes: elevation, pitch, travel.\n"
        f"rig = {toml_string(rig)}\n"
        f"source = {toml_string(calibration.source)}\n\n"
        "[disturbances]\n"
        f"{disturbance_lines}\n"
        "[tail]\n"
        f"{tail_lines}"
    ) + _uncertainty_text(calibration.uncertainty)


def _uncertainty_text(uncertainty: ParameterUncertainty) -> str:
    """Return the table [parameters] of a twin file; empty for exact parameters."""
    if not uncertainty.names and not uncertainty.supply_std:
        return ""
    names = ", ".join(map(toml_string, uncertainty.names))
    rows = "".join(f"  {_toml_list(row, 9)},\n" for row in uncertainty.covariance)
    return (
        "\n[parameters]\n"
        f"names = [{names}]\n"
        f"supply_std = {uncertainty.supply_std:.6g}\n"
        f"low_V = {_toml_list(uncertainty.low_V)}\n"
        f"high_V = {_toml_list(uncertainty.high_V)}\n"
        f"covariance = [\n{rows}]\n"
    )


def write_calibration(path: Path, calibration: Calibration, rig: str) -> None:
    """Write a twin file to `path`; `rig` is the name or the path of the rig."""
    write_signed(path, calibration_text(calibration, rig))


def parse_calibration(data: Mapping[str, Any], name: str) -> Calibration:
    """Read the calibration in a twin file."""
    return Calibration(
        _parse_disturbances(_table_of(data, "disturbances", name), name),
        _parse_tail(_table_of(data, "tail", name), name),
        str(data.get("source", "")),
        _parse_uncertainty(_table_of(data, "parameters", name), name) if "parameters" in data else EXACT,
    )


def _parse_disturbances(table: Mapping[str, Any], name: str) -> DisturbanceModel:
    """Read the table [disturbances] of a twin file."""
    arrays: dict[str, Any] = {}
    for key in _DISTURBANCES:
        values = table.get(key)
        if not isinstance(values, list) or len(values) != _AXES or not all(map(_is_positive, values)):
            raise TwinError(f"{name}: disturbances.{key} is not three positive numbers", _REMEDY)
        arrays[key.removesuffix("_Nm")] = np.array(values, float)
    return DisturbanceModel(**arrays)


def _parse_tail(table: Mapping[str, Any], name: str) -> Tail:
    """Read the table [tail] of a twin file."""
    excesses = table.get("excesses")
    if not isinstance(excesses, int) or isinstance(excesses, bool) or excesses < 1:
        raise TwinError(f"{name}: tail.excesses is not a count", _REMEDY)
    tail_numbers: dict[str, float] = {}
    for key, default in _TAIL_DEFAULTS.items():
        value = table.get(key, default)
        if not _is_number(value) and value != math.inf:
            raise TwinError(f"{name}: tail.{key} is not a number", _REMEDY)
        tail_numbers[key] = float(value)
    return Tail(**tail_numbers, excesses=excesses)


def _parse_uncertainty(table: Mapping[str, Any], name: str) -> ParameterUncertainty:
    """Read the table [parameters] of a twin file."""
    names = table.get("names")
    if not isinstance(names, list) or not all(isinstance(entry, str) for entry in names):
        raise TwinError(f"{name}: parameters.names is not a list of names", _REMEDY)
    count = len(names)
    rows = table.get("covariance")
    if not isinstance(rows, list) or len(rows) != count:
        raise TwinError(f"{name}: parameters.covariance does not have {count} rows", _REMEDY)
    covariance = [_number_array(row, count, f"{name}: a row of parameters.covariance") for row in rows]
    (supply_std,) = _number_array([table.get("supply_std")], 1, f"{name}: parameters.supply_std")
    return ParameterUncertainty(
        tuple(names),
        np.array(covariance, float).reshape(count, count),
        float(supply_std),
        _number_array(table.get("low_V"), _ROTORS, f"{name}: parameters.low_V"),
        _number_array(table.get("high_V"), _ROTORS, f"{name}: parameters.high_V"),
    )


def _number_array(values: Any, count: int, what: str) -> Floats:
    """Return `values` as an array, (count,); a TwinError about `what` is raised for other values."""
    if not isinstance(values, list) or len(values) != count or not all(map(_is_number, values)):
        raise TwinError(f"{what} is not {count} numbers", _REMEDY)
    return np.array(values, float)


_TAIL_DEFAULTS: Final[Mapping[str, float | None]] = {
    "level_nats": None,
    "per_hour": None,
    "scale_nats": None,
    "shape": 0.0,
    "healthy_s": math.inf,
}
"""Numbers in the table [tail], each with its default; None if a file must have it."""


_REMEDY: Final = "write it again with heli-host twin --learn"


def _table_of(data: Mapping[str, Any], key: str, name: str) -> Mapping[str, Any]:
    """Return a table of a twin file; a TwinError is raised if it is missing."""
    table = data.get(key)
    if not isinstance(table, dict):
        raise TwinError(f"{name} has no [{key}]", _REMEDY)
    return table


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_positive(value: Any) -> bool:
    return _is_number(value) and value > 0


def _toml_list(values: Floats, digits: int = 6) -> str:
    """Return values, (n,), as a list of TOML with this number of significant digits."""
    return "[" + ", ".join(f"{value:.{digits}g}" for value in values) + "]"
