"""Names for files of control laws: ``from heli_lab.law import Command, control_law``."""

from heli_lab.control.law import *  # noqa: F403
from heli_lab.control.law import __all__ as __all__  # noqa: PLC0414
