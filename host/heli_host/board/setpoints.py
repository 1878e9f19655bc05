"""Checks of setpoints and voltages against the board's parameters, before they are sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from numbers import Real

from heli_host.declaration import SETPOINT_MARGIN_DEG
from heli_host.errors import SetpointError


@dataclass(frozen=True)
class Bounds:
    """Bounds of one axis' setpoint, both included."""

    least_deg: float  # least_deg, most_deg: The bounds [deg]
    most_deg: float
    least_name: str  # least_name, most_name: The parameters that they come from, for messages
    most_name: str


def setpoint_bounds(parameters: Mapping[str, float]) -> dict[str, Bounds]:
    """Return what the board takes, by its `parameters`."""
    margin_deg = SETPOINT_MARGIN_DEG
    inside_deg = {name: parameters[name] - margin_deg[name] for name in margin_deg}
    inside_name = {name: f"{name} - {margin_deg[name]:g}" for name in margin_deg}
    pitch_deg = parameters["pitch_setpoint_max_deg"]
    travel_deg, travel_name = inside_deg["travel_max_deg"], inside_name["travel_max_deg"]
    return {
        "elevation": Bounds(
            inside_deg["elevation_rest_deg"],
            inside_deg["elevation_max_deg"],
            inside_name["elevation_rest_deg"],
            inside_name["elevation_max_deg"],
        ),
        "pitch": Bounds(-pitch_deg, pitch_deg, "-pitch_setpoint_max_deg", "pitch_setpoint_max_deg"),
        "travel": Bounds(-travel_deg, travel_deg, f"-({travel_name})", travel_name),
    }


def check_setpoint(targets_deg: Mapping[str, float], parameters: Mapping[str, float]) -> None:
    """Refuse targets that the board would refuse."""
    bounds = setpoint_bounds(parameters)
    for axis, value_deg in targets_deg.items():
        _check_number(f"{axis} setpoint", value_deg, "degrees")
        least_deg, most_deg = bounds[axis].least_deg, bounds[axis].most_deg
        if not least_deg <= value_deg <= most_deg:
            raise SetpointError(
                f"{axis} setpoint of {value_deg:g} degrees is outside the board's limits",
                f"give {least_deg:g} to {most_deg:g} degrees",
            )


def check_voltages(front_V: float, back_V: float, parameters: Mapping[str, float]) -> None:
    """Refuse `front_V` and `back_V` unless the board takes both by its `parameters`: SetpointError."""
    for motor, value_V in (("front", front_V), ("back", back_V)):
        _check_number(f"{motor} voltage", value_V, "volts")
    least_V, most_V = parameters["motor_min_V"], parameters["motor_max_V"]
    if not (least_V <= front_V <= most_V and least_V <= back_V <= most_V):
        raise SetpointError(
            f"voltages {front_V:g} and {back_V:g} V are outside the board's limits",
            f"give {least_V:g} to {most_V:g} V, or set motor_min_V and motor_max_V",
        )


def _check_number(name: str, value: object, unit: str) -> None:
    """Refuse a value that is not a number, such as a text: SetpointError."""
    if not isinstance(value, Real):
        raise SetpointError(f"the {name} is {value!r}, not a number", f"give a number of {unit}, such as 3.0")
