"""The flight that would tell more: plans for `heli-host fly`, put together from what has to be seen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from heli_sim.model.effects import EffectKind

_PARTS: Final[Mapping[str, tuple[str, str]]] = {
    "motors": (
        "both motors shaken hard and fast, which shows how thrust follows voltage",
        """
[[segment]]
kind = "waypoints"
path = "straight"
points = [
  { at_s = 10, elevation_deg = 6, travel_deg = 30 },
  { at_s = 20, elevation_deg = -6, travel_deg = -30 },
  { at_s = 30, elevation_deg = 0, travel_deg = 0 },
]
duration_s = 30
excite = { signal = "prbs", front_V = 0.5, back_V = 0.5, stop_Hz = 8, seed = 3 }
""",
    ),
    "travel": (
        "travel far, fast and slow both ways, which tells springs, tilt, drag and dry friction apart",
        """
[[segment]]
kind = "sine"
travel_amplitude_deg = 110
travel_period_s = 36
duration_s = 36
excite = { signal = "multisine", front_V = 0.15, back_V = 0.15, start_Hz = 0.1, stop_Hz = 2 }

[[segment]]
kind = "sine"
travel_amplitude_deg = 36
travel_period_s = 12
duration_s = 36
""",
    ),
    "elevation": (
        "elevation high and low, fast and slow, which tells height, speed and friction apart",
        """
[[segment]]
kind = "sine"
elevation_amplitude_deg = 13
elevation_period_s = 20
duration_s = 40
excite = { signal = "multisine", front_V = 0.2, back_V = 0.2, start_Hz = 0.1, stop_Hz = 2 }

[[segment]]
kind = "sine"
elevation_amplitude_deg = 5
elevation_period_s = 7
duration_s = 28
""",
    ),
    "time": (
        "the same motion for two minutes, which tells what changes with time from what changes with motion",
        """
[[segment]]
kind = "sine"
travel_amplitude_deg = 30
travel_period_s = 20
elevation_amplitude_deg = 5
elevation_period_s = 10
duration_s = 120
excite = { signal = "multisine", front_V = 0.25, back_V = 0.25, start_Hz = 0.1, stop_Hz = 4 }
""",
    ),
}
"""Parts of a plan: what each shows, and its segments."""

_HEAD: Final = """title = "The flight that would tell more"

[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 2
"""
_BACK: Final = """
[[segment]]
kind = "ramp"
elevation_deg = 0
travel_deg = 0
rate_deg_s = 8
"""


@dataclass(frozen=True)
class NextFlight:
    """A flight that would tell more.

    Parameters
    ----------
    why : str
        What it would tell.
    plan : str
        The plan, TOML, for `heli-host fly`.
    """

    why: str
    plan: str


def part_for(kind: EffectKind) -> str:
    """Which part of a plan shows an effect best.

    Parameters
    ----------
    kind : EffectKind
        The effect.

    Returns
    -------
    str
        Key of a part.
    """
    if any(q.name.endswith("_at_s") for q in kind.parameters) or "fade" in kind.id:
        return "time"
    axis = kind.acts_on.rpartition(".")[2]
    if axis in ("travel", "elevation"):
        return axis
    return "elevation" if kind.id == "ground_effect" else "motors"


def next_flight(reason: str, parts: Iterable[str]) -> NextFlight:
    """Put a plan together.

    Parameters
    ----------
    reason : str
        Why another flight is needed, a sentence.
    parts : iterable of str
        Keys of the parts that it needs; all of them where there are none.

    Returns
    -------
    NextFlight
        The flight.
    """
    chosen = [key for key in _PARTS if key in set(parts)] or ["motors", "travel", "elevation"]
    shows = "; ".join(_PARTS[key][0] for key in chosen)
    return NextFlight(f"{reason} Fly {shows}.", _HEAD + _BACK.join(_PARTS[key][1] for key in chosen))
