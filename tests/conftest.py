"""Settings that all tests share."""

from __future__ import annotations

import signal

from hypothesis import settings

# The same examples in every run: a failure seen once is seen again.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

# A shell that runs the tests in the background ignores Ctrl-C; processes started here would inherit
# that, were it not set back.
signal.signal(signal.SIGINT, signal.default_int_handler)
