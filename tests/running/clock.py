"""CPU time of a process and of its children."""

from __future__ import annotations

import resource
import time


def spent_s() -> float:
    """CPU time so far of this process and of the children it has waited for."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime
