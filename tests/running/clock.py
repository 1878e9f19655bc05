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
    """Add the CPU time of a child that has not ended yet. Subtract it again when the child has ended, because
    `spent_s` then includes it.
    """
    global _charged_s  # noqa: PLW0603  -- the CPU time of this process is global, too
    _charged_s += cpu_s
