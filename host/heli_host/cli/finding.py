"""What a look at this computer found: one line, and its remedy.

A package that needs something of its own offers a function without arguments that yields findings, in the
entry-point group ``heli_host.checks``; ``heli-host doctor`` calls it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

ENTRY_POINT_GROUP: Final = "heli_host.checks"


class Verdict(Enum):
    """How a finding counts."""

    GOOD = "good"
    NOTE = "note"  # only matters for something that may not be wanted, such as hardware
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """One line of the report.

    Parameters
    ----------
    what : str
        What was looked at and found.
    remedy : str
        What to do about it; empty when it is all right.
    """

    verdict: Verdict
    what: str
    remedy: str = ""
