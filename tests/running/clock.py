"""CPU time of a process and of its children."""

from __future__ import annotations

import resource
import time

_charged_s = 0.0


def spent_s() -> float:
    """CPU time so far of this process and of the children it has waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime + _charged_s


def charge(cpu_s: float) -> None:
    """Add what a process took that is not waited for yet; what was added is taken back when it is."""
    global _charged_s  # noqa: PLW0603  -- as of a process, whose CPU time this is
    _charged_s += cpu_s
