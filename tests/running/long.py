"""How much of a claim about many samples runs in ``make test``, and how much in ``make long``."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

LONG: Final = os.environ.get("HELI_LONG") == "1"
"""Whether every claim runs at its full length."""

T = TypeVar("T")


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


def parallel_map(cases: Sequence[T], every: int, kind: Callable[[T], object] = lambda _: None) -> list[T]:
    """Which cases of a matrix to run: all in ``make long``, otherwise one in so many of each kind.

    Parameters
    ----------
    cases : sequence
        All, in an order that does not change.
    every : int
        Of each kind, one case in so many runs in ``make test``.
    kind : callable
        What a case stands for; each kind keeps a case at least.
    """
    if LONG:
        return list(cases)
    seen: Counter[object] = Counter()
    taken = []
    for case in cases:
        if seen[kind(case)] % every == 0:
            taken.append(case)
        seen[kind(case)] += 1
    return taken
