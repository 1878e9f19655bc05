"""Find the directions and zeros of the encoders from movements by hand, with the motors off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.board.heli import Heli
from heli_host.board.samples import Sample
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES

from heli_lab.errors import CalibrationError
from heli_lab.setup.calibrate.operator import HandAction, Operator

_MOVED_deg: Final = 5.0
"""Change of an angle that counts as a movement [deg]. Less: the play of an axis that a hand touches
counts too. More: travel of a rig with short cables cannot be turned so far."""
_RETURNED_deg: Final = 1.0
"""Largest error of the elevation after its return to rest [deg]. Less: an arm on a soft table is refused.
More: a slipping coupling is not noticed."""
_MAX_ATTEMPTS: Final = 3
_SETTLE_S: Final = 0.3
_MOVES: Final = (
    ("elevation", HandAction.LIFT),
    ("pitch", HandAction.FRONT_UP),
    ("travel", HandAction.BACK_LEADS),
)
"""Each axis, and the action that must increase its angle."""


@dataclass(frozen=True)
class EncoderResult:
    """Directions and zeros of the encoders, measured by movements by hand."""

    direction: Mapping[str, int]
    """By axis: 1 if the encoder counts up when the angle grows, -1 if it counts down. This is the direction
    of the encoder itself; the sign of the board's parameter is not included."""
    rest_deg: float  # Elevation at rest on the table, if the operator's level is 0 [deg]
    moved_deg: Mapping[str, float]  # Change of each axis in its movement, as the board showed it [deg]


def calibrate_encoders(heli: Heli, operator: Operator) -> EncoderResult:
    """Let the operator move each axis, and read its encoder."""
    operator.act(HandAction.REST)
    heli.zero()
    heli.wait(_SETTLE_S)
    start_deg = angles_deg(heli)
    direction: dict[str, int] = {}
    moved_deg: dict[str, float] = {}
    rest_deg = 0.0
    for axis, action in _MOVES:
        moved_deg[axis] = change_deg = _movement_deg(heli, operator, axis, action)
        direction[axis] = int(np.sign(change_deg) * np.sign(heli.params[f"{axis}_counts_per_rev"]))
        if action is HandAction.LIFT:
            # The operator lifts the arm from its rest to level.
            rest_deg = -abs(change_deg)
        up_or_down = "up" if direction[axis] > 0 else "down"
        operator.report(f"{axis}: {change_deg:+.1f} degrees, so the encoder counts {up_or_down}")
        operator.act(HandAction.REST)
        _check_return(heli, start_deg, axis)
    return EncoderResult(direction, rest_deg, moved_deg)


def angles_deg(heli: Heli) -> Floats:
    """Wait until a movement has settled, and return the angles of the newest sample [deg], shape (3,)."""
    heli.wait(_SETTLE_S)
    return sample_angles_deg(heli.latest)


def sample_angles_deg(sample: Sample) -> Floats:
    """Return the angles of a `sample` [deg], shape (3,)."""
    return np.array([sample.elevation_deg, sample.pitch_deg, sample.travel_deg])


def _movement_deg(heli: Heli, operator: Operator, axis: str, action: HandAction) -> float:
    """Let the operator move an axis, and return the change of its angle [deg].

    If no axis or another one moves, the operator tries again.
    """
    reason = remedy = ""
    for attempt in range(_MAX_ATTEMPTS):
        if attempt:
            operator.report(f"{reason}; {remedy}, then try again")
            operator.act(HandAction.REST)
        before_deg = angles_deg(heli)
        operator.act(action)
        change_deg = angles_deg(heli) - before_deg
        moved_axes = [
            name for name, change in zip(AXES, change_deg, strict=True) if abs(change) >= _MOVED_deg
        ]
        if moved_axes == [axis]:
            return float(change_deg[AXES.index(axis)])
        changes_text = ", ".join(
            f"{name} {change:+.1f}" for name, change in zip(AXES, change_deg, strict=True)
        )
        if not moved_axes:
            reason = f"no encoder counted {_MOVED_deg:g} degrees for {axis} ({changes_text})"
            remedy = f"move it further, and check the plug and the supply of the {axis} encoder"
        elif len(moved_axes) > 1:
            reason = f"{' and '.join(moved_axes)} moved together ({changes_text} degrees)"
            remedy = f"hold the other axes while you move {axis}"
        else:
            reason = f"the {moved_axes[0]} encoder counted when {axis} moved ({changes_text} degrees)"
            remedy = f"exchange the plugs of the {axis} and {moved_axes[0]} encoders"
    raise CalibrationError(reason, remedy)


def _check_return(heli: Heli, start_deg: Floats, axis: str) -> None:
    """Raise a CalibrationError if the elevation does not return to its first reading."""
    # Only the elevation has a table that stops it; pitch and travel may come to rest anywhere.
    elevation_error_deg, *_ = angles_deg(heli) - start_deg
    if abs(elevation_error_deg) > _RETURNED_deg:
        raise CalibrationError(
            f"elevation reads {elevation_error_deg:+.1f} degrees from its first rest after {axis} moved",
            "check the coupling, the cable and the pull-ups of the elevation encoder",
        )
