"""Design gains of the board's control law for a rig."""

from heli_lab.control.tune.design import Design, find_gains
from heli_lab.control.tune.loops import (
    LOOPS,
    CascadeGains,
    LinearPlant,
    LoopEffects,
    Margin,
    Pid,
    Spread,
    cascade_gains_of,
    is_stable,
    linear_plant,
    loop_effects_of,
    margins,
)

__all__ = [
    "LOOPS",
    "CascadeGains",
    "Design",
    "LinearPlant",
    "LoopEffects",
    "Margin",
    "Pid",
    "Spread",
    "cascade_gains_of",
    "find_gains",
    "is_stable",
    "linear_plant",
    "loop_effects_of",
    "margins",
]
