"""Compares a rig's file with the parameters of the board that flies the rig.

A wrong number of counts per turn scales an axis: a board with 4096 counts on an encoder that has 2000 flies
twice the angle that its log shows. Nothing here reads a rig's file: a package that does offers a function in
the entry-point group ``heli_host.rig_parameters``, which returns the parameters that a rig determines.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final

from heli_host.board.parameters import spec_of
from heli_host.errors import HeliError, RigMismatch
from heli_host.link.installation import plugins

ENTRY_POINT_GROUP: Final = "heli_host.rig_parameters"
GAINS_RIG: Final = "makki2024"
"""Rig for which the declared gains were designed."""


@dataclass(frozen=True)
class RigParameters:
    """Parameters of the board that a rig determines."""

    values: Mapping[str, float] = field(default_factory=dict)
    """Values by parameter. Counts per turn are negative for an encoder that counts down."""
    directed: frozenset[str] = frozenset()
    """Counts per turn whose sign the rig states; the sign of the others depends on the wiring."""


RigReader = Callable[[str], RigParameters]

_SAME: Final = 1e-6
"""Relative difference of two equal numbers, one of them in single precision: rounding is 6e-8. Larger: an
error of a count in 65536, 1.5e-5, passes."""
_REST_deg: Final = 1.0
"""Largest difference of two rest angles without a warning, deg: the tolerance of a rig file, and half of the
tolerance of arming. With a larger value, level would be visibly wrong; with a smaller one, rigs within their
tolerance would give warnings."""
_SUPPLY_V: Final = 0.3
"""The same for a supply, V: the drift of a laboratory supply or a battery. Larger: 3 % of every voltage.
Smaller: a supply within the tolerance of a rig's file gives a warning."""


class BoardProperty(Enum):
    """Property of the board that a difference concerns."""

    SCALE = "scale"
    DIRECTION = "direction"
    REST = "rest angle"
    SUPPLY = "supply"
    LIMIT = "limit"


_PROPERTIES: Final[Mapping[str, BoardProperty]] = {
    "elevation_counts_per_rev": BoardProperty.SCALE,
    "pitch_counts_per_rev": BoardProperty.SCALE,
    "travel_counts_per_rev": BoardProperty.SCALE,
    "elevation_rest_deg": BoardProperty.REST,
    "supply_V": BoardProperty.SUPPLY,
    "motor_max_V": BoardProperty.LIMIT,
    "elevation_max_deg": BoardProperty.LIMIT,
    "pitch_max_deg": BoardProperty.LIMIT,
    "pitch_setpoint_max_deg": BoardProperty.LIMIT,
    "travel_max_deg": BoardProperty.LIMIT,
}
_SIGNS: Final = ("motor_front_sign", "motor_back_sign")


@dataclass(frozen=True)
class RigDifference:
    """A parameter of the board that contradicts the rig."""

    parameter: str  # Name of the parameter
    board: float
    """board, rig: Its value on the board, and the value that the rig determines, in the parameter's unit."""
    rig: float
    part: BoardProperty  # Property that the difference concerns

    @property
    def is_refused(self) -> bool:
        """Whether the difference forbids a flight, because the log and the limits would mean other angles."""
        return self.part in (BoardProperty.SCALE, BoardProperty.DIRECTION)

    def __str__(self) -> str:
        unit = spec_of(self.parameter).unit
        suffix = f" {unit}" if unit else ""
        return f"{self.parameter} is {self.board:g}{suffix}, but the rig has {self.rig:g}{suffix}"


def rig_parameters(rig: str) -> RigParameters:
    """Read the parameters that a rig determines; empty if no installed package reads rigs."""
    for entry in plugins(ENTRY_POINT_GROUP):
        reader: RigReader = entry.load()
        return reader(rig)
    return RigParameters()


def is_known_rig(rig: str) -> bool:
    """Return whether `rig` is a rig's name or meant as the path of a file; otherwise it is a label only."""
    if Path(rig).suffix or Path(rig).exists() or Path(rig).name != rig:
        return True
    try:
        rig_parameters(rig)
    except HeliError:
        return False
    return True


def rig_differences(
    expected: Mapping[str, float],
    parameters: Mapping[str, float],
    *,
    simulated: bool,
    directed: Collection[str] = (),
) -> list[RigDifference]:
    """Compare a board with a rig."""
    differences: list[RigDifference] = []
    for name, board_property in _PROPERTIES.items():
        if name not in expected or name not in parameters:
            continue
        board, rig = parameters[name], expected[name]
        concerned = _contradiction(board_property, board, rig, is_directed=simulated or name in directed)
        if concerned is not None:
            differences.append(RigDifference(name, board, rig, concerned))
    if simulated and expected:
        differences += [
            RigDifference(name, parameters[name], 1.0, BoardProperty.DIRECTION)
            for name in _SIGNS
            if parameters.get(name, 1.0) * expected.get(name, 1.0) < 0.0
        ]
    return differences


def _contradiction(
    board_property: BoardProperty, board: float, rig: float, *, is_directed: bool
) -> BoardProperty | None:
    """Return the property in which the board's value of a parameter contradicts the rig's; None for none."""
    match board_property:
        case BoardProperty.SCALE:
            if abs(abs(board) - abs(rig)) > _SAME * abs(rig):
                return BoardProperty.SCALE
            return BoardProperty.DIRECTION if is_directed and board * rig < 0.0 else None
        case BoardProperty.REST:
            is_different = abs(board - rig) > _REST_deg
        case BoardProperty.SUPPLY:
            is_different = abs(board - rig) > _SUPPLY_V
        case _:
            is_different = board > rig + _SAME * abs(rig)
    return board_property if is_different else None


def check_rig(
    expected: Mapping[str, float],
    parameters: Mapping[str, float],
    *,
    simulated: bool,
    directed: Collection[str] = (),
) -> list[RigDifference]:
    """Refuse a board whose scales or directions contradict a rig, and return the other differences."""
    differences = rig_differences(expected, parameters, simulated=simulated, directed=directed)
    refused = [difference for difference in differences if difference.is_refused]
    if not refused:
        return differences
    cause = "; ".join(map(str, refused))
    if simulated:
        names = ", ".join(difference.parameter for difference in refused)
        remedy = f"leave {names} out of the parameters, or correct the rig's file"
    else:
        sets = (
            f"heli-host params set {row.parameter} {_with_direction(row, directed):g} --save"
            for row in refused
        )
        remedy = f"{' && '.join(sets)}, or correct the rig's file"
    raise RigMismatch(f"board and rig disagree: {cause}", remedy)


def _with_direction(difference: RigDifference, directed: Collection[str]) -> float:
    """Return the counts of the rig; if it states no direction, with the sign of the board, for its wiring."""
    if difference.parameter in directed:
        return difference.rig
    return math.copysign(difference.rig, difference.board)
