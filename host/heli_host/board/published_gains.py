"""Published gains: Table 6 of the paper, as parameter sets of the board."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from heli_host.errors import ParameterError

if TYPE_CHECKING:
    from heli_host.board.parameters import Parameters

PAPER_SETS: Final = ("printed", "corrected")
SETS: Final = {"paper": "corrected", "paper-printed": "printed"}
"""Table 6 of the paper under the names that ``--gains`` takes."""

# (34) is three bare PIDs on the error, in degrees and volts. What the board adds to them is set aside: no
# feed-forward but the setpoint's rate (which makes the derivative one of the error), no dead zone, and limits
# that only the supply sets. (34) does not filter its derivative; 20 Hz is the least that 4096 counts allow.
_BARE: Final[Mapping[str, float]] = {
    "dead_zone_V": 0.0,
    "hover_V": 0.0,
    "hover_slope": 0.0,
    "elevation_rate_ff": 1.0,
    "elevation_acceleration_ff": 0.0,
    "pitch_hold_ff": 0.0,
    "travel_rate_ff": 1.0,
    "travel_acceleration_ff": 0.0,
    "elevation_integral_max_V": 20.0,
    "pitch_integral_max_V": 20.0,
    "travel_integral_max_deg": 45.0,
    "elevation_filter_Hz": 20.0,
    "pitch_filter_Hz": 20.0,
    "travel_filter_Hz": 20.0,
    "pitch_setpoint_max_deg": 30.0,
    "differential_max_V": 12.0,
    "pitch_slew_deg_s": 1000.0,
    # Without hover_V and dead zone the integrators wind up to 16 V before the arm lifts, and the printed
    # row of travel swings by 60 degrees: those are no faults of these sets.
    "elevation_motion_V": 40.0,
    "travel_following_max_deg": 90.0,
}
_PITCH: Final = {"pitch_kp": 0.66, "pitch_ki": 3.0, "pitch_kd": 0.1}
_ELEVATION: Final = {"elevation_kp": 0.5, "elevation_ki": 1.0, "elevation_kd": 0.1}
_TRAVEL: Final[Mapping[str, Mapping[str, float]]] = {
    "printed": {"travel_kp": 0.13, "travel_ki": 0.7, "travel_kd": 1.462},
    "corrected": {"travel_kp": 0.7, "travel_ki": 0.13, "travel_kd": 1.462},
}


def paper_gains(which: str) -> dict[str, float]:
    """Return the gains in Table 6 of the paper as parameters of the board, in declared units.

    The gains convert errors in degrees to volts; those of travel convert to the pitch setpoint in degrees.
    """
    if which not in _TRAVEL:
        raise ParameterError(f"Table 6 has no set '{which}'", f"give {' or '.join(PAPER_SETS)}")
    return {**_BARE, **_ELEVATION, **_PITCH, **_TRAVEL[which]}


def load_gains(parameters: Parameters, gains: str | None) -> None:
    """Set published `gains`, a name of `SETS`, in the memory of an idle board by its `parameters`; None
    leaves the board's own, and nothing is saved.
    """
    if gains is None:
        return
    for name, value in paper_gains(SETS[gains]).items():
        parameters[name] = value
