"""What a process that shares the cores with others says to its libraries."""

from __future__ import annotations

import os
from typing import Final

NAMES: Final = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def one_thread_each() -> None:
    """Have libraries use one thread here and in processes that are started, unless the environment says
    otherwise: several cases at once share out the cores, and threads that wait for each other took 2.5 times
    the CPU time.
    """
    for name in NAMES:
        os.environ.setdefault(name, "1")
