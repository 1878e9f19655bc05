"""Share of the samples of a claim that runs in ``make test``; ``make long`` runs all."""

import os
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Final, TypeVar

LONG: Final = os.environ.get("HELI_LONG") == "1"
"""Whether every claim runs at its full length."""

T = TypeVar("T")


def samples(full: int, share: int) -> int:
    """Return the number of samples to try: `full` in ``make long``, otherwise `share`."""
    return full if LONG else share


def select_cases(cases: Sequence[T], every: int, kind: Callable[[T], object] = lambda _: None) -> list[T]:
    """Return the cases of a matrix to run: all in ``make long``, otherwise a share of each kind."""
    if LONG:
        return list(cases)
    seen: Counter[object] = Counter()
    chosen = []
    for case in cases:
        if seen[kind(case)] % every == 0:
            chosen.append(case)
        seen[kind(case)] += 1
    return chosen
