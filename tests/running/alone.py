"""One thread per library, for processes that share the cores."""

from __future__ import annotations

import os
from typing import Final

NAMES: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread_each() -> None:
    """Limit numerical libraries to one thread, here and in child processes, unless the environment sets a
    number. Several processes share the cores; with more threads, which wait for each other, a run took 2.5
    times the CPU time.
    """
    for name in NAMES:
        os.environ.setdefault(name, "1")
