"""How much of a claim about many samples runs in ``make test``, and how much in ``make long``."""

from __future__ import annotations

import os
from typing import Final

LONG: Final = os.environ.get("HELI_LONG") == "1"
"""Whether every claim runs at its full length."""


def samples(full: int, share: int) -> int:
    """How many samples of a seeded sequence to try: all in ``make long``, the first of them otherwise.

    Parameters
    ----------
    full : int
        In ``make long``.
    share : int
        In ``make test``: enough that a mistake which is not rare shows.
    """
    return full if LONG else share
