"""A finding of ``heli-host doctor``: one line about this computer, and how to fix the problem.

A package that checks its own requirements offers a function without arguments that yields findings, in the
entry-point group ``heli_host.checks``; ``heli-host doctor`` calls this function.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Final

ENTRY_POINT_GROUP: Final = "heli_host.checks"


class Verdict(Enum):
    """Severity of a finding."""

    GOOD = "good"
    NOTE = "note"  # matters only for an optional part, such as hardware
    BAD = "bad"


@dataclass(frozen=True)
class Finding:
    """One line of the report."""

    verdict: Verdict
    what: str  # Subject of the check, and its result
    remedy: str = ""  # Instruction that fixes the problem; empty if there is no problem
