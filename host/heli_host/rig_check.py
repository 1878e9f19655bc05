"""Compares a rig's file with the parameters of the board that flies the rig.

A wrong number of counts per turn scales an axis: a board with 4096 counts on an encoder that has 2000 flies
twice the angle that its log shows. Nothing here reads a rig's file: a package that does offers a function in
the entry-point group ``heli_host.rig_parameters``, which returns the parameters that a rig determines.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import entry_points
from pathlib import Path
from typing import Final

from heli_host.errors import HeliError, RigMismatch
from heli_host.parameters import spec_of

ENTRY_POINT_GROUP: Final = "heli_host.rig_parameters"

RigReader = Callable[[str], Mapping[str, float]]

_SAME: Final = 1e-6
"""Relative difference of two equal numbers, one of them in single precision: rounding is 6e-8. Larger: an
error of a count in 65536, 1.5e-5, passes."""
_REST_deg: Final = 1.0
"""Difference of two rest angles that counts as none, deg: the tolerance of a rig's file, and half of what
arming tolerates. Larger: level is visibly wrong. Smaller: rigs within their tolerance give warnings."""
_SUPPLY_V: Final = 0.3
"""The same for a supply, V: the drift of a laboratory supply or a battery. Larger: 3 % of every voltage.
Smaller: a supply within the tolerance of a rig's file gives a warning."""


class Part(Enum):
    """Property of the board that a difference concerns."""

    SCALE = "scale"
    DIRECTION = "direction"
    REST = "rest angle"
    SUPPLY = "supply"
    LIMIT = "limit"


_PARTS: Final[Mapping[str, Part]] = {
    "elevation_counts_per_rev": Part.SCALE,
    "pitch_counts_per_rev": Part.SCALE,
    "travel_counts_per_rev": Part.SCALE,
    "elevation_rest_deg": Part.REST,
    "supply_V": Part.SUPPLY,
    "motor_max_V": Part.LIMIT,
    "elevation_max_deg": Part.LIMIT,
    "pitch_max_deg": Part.LIMIT,
    "pitch_setpoint_max_deg": Part.LIMIT,
    "travel_max_deg": Part.LIMIT,
}
_SIGNS: Final = ("motor_front_sign", "motor_back_sign")


@dataclass(frozen=True)
class RigDifference:
    """A parameter of the board that contradicts the rig.

    Parameters
    ----------
    parameter : str
        Name of the parameter.
    board, rig : float
        Its value on the board, and the value that the rig determines, in the parameter's unit.
    part : Part
        Property that the difference concerns.
    """

    parameter: str
    board: float
    rig: float
    part: Part

    @property
    def is_refused(self) -> bool:
        """Whether the difference forbids a flight, because the log and the limits would mean other angles."""
        return self.part in (Part.SCALE, Part.DIRECTION)

    def __str__(self) -> str:
        unit = spec_of(self.parameter).unit
        suffix = f" {unit}" if unit else ""
        return f"{self.parameter} is {self.board:g}{suffix}, but the rig has {self.rig:g}{suffix}"


def rig_parameters(rig: str) -> dict[str, float]:
    """Read the parameters that a rig determines; empty if no installed package reads rigs.

    Parameters
    ----------
    rig : str
        Name of a rig, or path of its file.

    Returns
    -------
    dict of str to float
        Values by parameter. Counts per turn are positive: a rig's file does not say how encoders are wired.

    Raises
    ------
    HeliError
        There is no such rig, or its file is not complete and valid.
    """
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        reader: RigReader = entry.load()
        return dict(reader(rig))
    return {}


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
    stated: Mapping[str, float], parameters: Mapping[str, float], *, simulated: bool
) -> list[RigDifference]:
    """Compare a board with a rig.

    Parameters
    ----------
    stated : Mapping of str to float
        Parameters that the rig determines, as `rig_parameters` returns them.
    parameters : Mapping of str to float
        Parameters of the board by name.
    simulated : bool
        Whether the board is simulated. Its encoders count up with their angles and its motors are not
        swapped, so a reversed sign is a contradiction. On hardware a sign says how a part is wired.

    Returns
    -------
    list of RigDifference
        In the order of the board's parameters.
    """
    differences: list[RigDifference] = []
    for name, part in _PARTS.items():
        if name not in stated or name not in parameters:
            continue
        board, rig = parameters[name], stated[name]
        if part is Part.SCALE:
            if abs(abs(board) - abs(rig)) > _SAME * abs(rig):
                differences.append(RigDifference(name, board, rig, part))
            elif simulated and board * rig < 0.0:
                differences.append(RigDifference(name, board, rig, Part.DIRECTION))
            continue
        apart = {Part.REST: abs(board - rig) > _REST_deg, Part.SUPPLY: abs(board - rig) > _SUPPLY_V}
        if apart.get(part, board > rig + _SAME * abs(rig)):
            differences.append(RigDifference(name, board, rig, part))
    if simulated and stated:
        differences += [
            RigDifference(name, parameters[name], 1.0, Part.DIRECTION)
            for name in _SIGNS
            if parameters.get(name, 1.0) < 0.0
        ]
    return differences


def check_rig(
    stated: Mapping[str, float], parameters: Mapping[str, float], *, simulated: bool
) -> list[RigDifference]:
    """Refuse a board whose scales or directions contradict a rig, and return the other differences.

    Parameters
    ----------
    stated, parameters, simulated
        As `rig_differences` takes them.

    Returns
    -------
    list of RigDifference
        Differences to warn about: rest angle, supply and limits.

    Raises
    ------
    RigMismatch
        A number of counts per turn, or a direction in simulation, is wrong.
    """
    differences = rig_differences(stated, parameters, simulated=simulated)
    refused = [difference for difference in differences if difference.is_refused]
    if not refused:
        return differences
    cause = "; ".join(map(str, refused))
    if simulated:
        names = ", ".join(difference.parameter for difference in refused)
        remedy = f"leave {names} out of the parameters, or correct the rig's file"
    else:
        # The sign on the board says how the encoder is wired, and stays.
        sets = (
            f"heli-host params set {row.parameter} {row.rig if row.board > 0 else -row.rig:g} --save"
            for row in refused
        )
        remedy = f"{' && '.join(sets)}, or correct the rig's file"
    raise RigMismatch(f"board and rig disagree: {cause}", remedy)
