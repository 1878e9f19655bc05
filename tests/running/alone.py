"""Threads and CPU time of a process that shares the cores with others."""

import os
import resource
import time
from typing import Final

NAMES: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")

_charged_s = 0.0


def one_thread_each() -> None:
    """Limit numerical libraries to one thread, here and in child processes, unless the environment sets a
    number.
    """
    # Several processes share the cores; with more threads, which wait for each other, a run took 2.5 times
    # the CPU time.
    for name in NAMES:
        os.environ.setdefault(name, "1")


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
