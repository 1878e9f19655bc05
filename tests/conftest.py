"""Settings that all tests share."""

from __future__ import annotations

import os
import signal

from hypothesis import settings

pytest_plugins = ["tests.running.cost", "tests.running.order"]

# One worker a core is what shares the work out: a pool within a test would take a core from another.
for _threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_threads] = "1"

# The same examples in every run: a failure seen once is seen again.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# A shell that runs the tests in the background ignores Ctrl-C; processes started here would inherit
# that, were it not set back.
signal.signal(signal.SIGINT, signal.default_int_handler)
