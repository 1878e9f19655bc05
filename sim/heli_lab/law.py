"""Names for files of control laws: ``from heli_lab.law import Command, control_law``."""

from casadi import (
    atan2,
    cos,
    exp,
    fabs,
    floor,
    fmax,
    fmin,
    if_else,
    logic_and,
    logic_not,
    logic_or,
    sin,
    sqrt,
    tan,
    tanh,
)
from heli_host.board.law_program import LawProgram
from heli_host.errors import BadLaw

from heli_lab.control.law import (
    Command,
    Law,
    control_law,
    from_function,
    from_gain,
    from_state_space,
    motor_volts,
    saturated,
)
from heli_lab.control.law_files import law_rig

__all__ = [
    "BadLaw",
    "Command",
    "Law",
    "LawProgram",
    "atan2",
    "control_law",
    "cos",
    "exp",
    "fabs",
    "floor",
    "fmax",
    "fmin",
    "from_function",
    "from_gain",
    "from_state_space",
    "if_else",
    "law_rig",
    "logic_and",
    "logic_not",
    "logic_or",
    "motor_volts",
    "saturated",
    "sin",
    "sqrt",
    "tan",
    "tanh",
]
