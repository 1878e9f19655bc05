"""Parameters of the board that a rig determines; the entry point ``heli_host.rig_parameters``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from heli_host.board.rig_check import RigParameters
from heli_host.declaration import AXES, PARAMS

from heli_sim.errors import RigError
from heli_sim.rig.rig import Number, Rig, counts_per_turn, direction_is_known, directions, load_rig
from heli_sim.rig.schema import ENCODER_COUNTS, ENCODER_DIRECTIONS, UNSTATED

_SPECS: Final = {spec.name: spec for spec in PARAMS}
_INSIDE_STOP_deg: Final = {"elevation_max": 1.0, "pitch_max": 5.0, "travel_max": 5.0}
"""How far inside a stop the board cuts the motors, deg: the distance of the declared limits from the stops of
the paper's rig. Less: the arm hits the stop before the motors are off. More: it cannot fly where it could."""
_SETPOINT_INSIDE_deg: Final = 10.0
"""The same for the setpoint of pitch, which has to be below its limit or the board does not arm."""
_UPPER: Final = frozenset(
    {"motor_max_V", "pitch_setpoint_max_deg", *(f"{name}_deg" for name in _INSIDE_STOP_deg)}
)
"""Upper limits: a rig's are the most that a board should have."""
_OF_BOARD: Final = {"elevation_rest_deg": "elevation_min", "supply_V": "supply", "dead_zone_V": "dead_zone"}
"""Numbers of a rig that a board knows besides its encoders, by the board's parameter."""


def parameters_of(rig: Rig) -> dict[str, float]:
    """Return the board parameters that a rig determines: counts per turn with their direction, rest angle,
    supply, and upper limits. If the direction of an encoder is not known, it counts up.
    """
    supply_V = rig["supply"].value
    exact_values = encoder_parameters(rig) | {
        "elevation_rest_deg": rig["elevation_min"].value,
        "supply_V": supply_V,
    }
    for name, value in exact_values.items():
        spec = _SPECS[name]
        if not spec.min <= value <= spec.max:
            raise RigError(
                f"rig '{rig.name}' needs {name} = {value:g}, "
                f"and the board takes {spec.min:g} to {spec.max:g}",
                "correct the rig's file",
            )
    upper_limits = {f"{name}_deg": rig[name].value - inside for name, inside in _INSIDE_STOP_deg.items()}
    upper_limits |= {
        "motor_max_V": supply_V,
        "pitch_setpoint_max_deg": rig["pitch_max"].value - _SETPOINT_INSIDE_deg,
    }
    return exact_values | {
        name: min(max(value, _SPECS[name].min), _SPECS[name].max) for name, value in upper_limits.items()
    }


def encoder_parameters(rig: Rig) -> dict[str, float]:
    """Return counts per turn by the board's parameter, negative for an encoder that counts down."""
    signed = directions(rig) * counts_per_turn(rig)
    return {f"{axis}_counts_per_rev": float(count) for axis, count in zip(AXES, signed, strict=True)}


def in_simulation(rig: Rig) -> dict[str, float]:
    """Return the parameters of a simulated board that differ from the declared defaults: counts, rest angle
    and supply are the rig's, and limits beyond its stops are brought inside.
    """
    stated = parameters_of(rig)
    in_simulation_values = {
        name: min(value, _SPECS[name].default) if name in _UPPER else value for name, value in stated.items()
    }
    return {name: value for name, value in in_simulation_values.items() if value != _SPECS[name].default}


def board_settings(rig: Rig, board: Mapping[str, float] | None = None) -> dict[str, float]:
    """Return the parameters that fit a board to a rig, for `rig to-board`."""
    # Counts per turn of an encoder whose direction the rig does not state get the sign that the board has;
    # they are left out without a board. Limits that are beyond the rig's are brought within, others stay.
    settings = parameters_of(rig) | {"dead_zone_V": rig["dead_zone"].value}
    board_values = {name: spec.default for name, spec in _SPECS.items()} | dict(board or {})
    for (name, count), is_known in zip(encoder_parameters(rig).items(), direction_is_known(rig), strict=True):
        if not is_known:
            del settings[name]
            if board is not None:
                settings[name] = math.copysign(count, board_values[name])
    return {
        name: min(value, board_values[name]) if name in _UPPER else value for name, value in settings.items()
    }


def rig_of_board(board: Mapping[str, float], like: Rig, name: str) -> Rig:
    """Return a rig with the encoders, rest angle, supply and dead zone of a board, for `rig from-board`."""
    quantities = zip(ENCODER_COUNTS, ENCODER_DIRECTIONS, strict=True)
    encoders = dict(zip(encoder_parameters(like), quantities, strict=True))
    if not {*encoders, *_OF_BOARD} & set(board):
        raise RigError(
            f"the board's parameters have none of {', '.join((*encoders, *_OF_BOARD))}",
            "give a file that params dump wrote",
        )
    source = "parameters of the board"
    numbers = dict(like)
    for parameter, (counts, direction) in encoders.items():
        # The direction of another rig's encoder says nothing about this one.
        numbers[direction] = Number(0.0, "1", 0.0, UNSTATED[direction].source)
        if parameter in board:
            numbers[counts] = Number(abs(board[parameter]), "count", 0.0, source)
            numbers[direction] = Number(math.copysign(1.0, board[parameter]), "1", 0.0, source)
    for parameter, quantity in _OF_BOARD.items():
        if parameter in board:
            numbers[quantity] = replace(like[quantity], value=board[parameter], source=source)
    return replace(
        like, name=name, description=f"parameters of a board, the rest as {like.name}", numbers=numbers
    )


def rig_parameters(name_or_path: str) -> RigParameters:
    """Return the parameters that a rig determines, by its name or file; see `parameters_of`."""
    rig = load_rig(name_or_path)
    known = zip(encoder_parameters(rig), direction_is_known(rig), strict=True)
    return RigParameters(parameters_of(rig), frozenset(name for name, is_known in known if is_known))


def set_from_rig_text(rig: str, values: Mapping[str, float]) -> str:
    """State in one line which parameters, `values` by name, a simulated board took from the `rig` of this
    name; return an empty text for none.
    """
    if not values:
        return ""
    listed = ", ".join(
        f"{name} {value:g}{' ' + _SPECS[name].unit if _SPECS[name].unit else ''}"
        for name, value in values.items()
    )
    return f"parameters set from rig {rig}: {listed}"
