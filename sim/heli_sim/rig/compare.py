"""Two rigs side by side: where they differ, measured in what is known of each number."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from heli_sim.rig.rig import Number, Rig

# A rig file holds seven digits.
_SAME = 1e-6


@dataclass(frozen=True)
class Difference:
    """A number of two rigs: its `name`, or ``effect.name`` for an effect's; None in `left` or `right` where
    that rig does not have it.
    """

    name: str
    left: Number | None
    right: Number | None

    @property
    def same(self) -> bool:
        """Whether both rigs have the same value."""
        if self.left is None or self.right is None:
            return False
        return math.isclose(self.left.value, self.right.value, rel_tol=_SAME)

    @property
    def tolerances(self) -> float:
        """Right less left, in the two tolerances together (their root sum of squares).

        Within 1 the two can be the same rig. Infinite where neither allows any difference, and where one rig
        does not have the number.
        """
        if self.same:
            return 0.0
        if self.left is None or self.right is None:
            return math.inf
        difference = self.right.value - self.left.value
        together = math.hypot(self.left.tolerance, self.right.tolerance)
        return difference / together if together > 0.0 else math.copysign(math.inf, difference)


def compare_rigs(left: Rig, right: Rig) -> list[Difference]:
    """Compare two rigs by every number of either, the largest difference in tolerances first, then in the
    rigs' order.
    """
    sides = dict(_numbers(left)), dict(_numbers(right))
    names = dict.fromkeys([*sides[0], *sides[1]])
    compared = [Difference(name, sides[0].get(name), sides[1].get(name)) for name in names]
    return sorted(compared, key=lambda difference: -abs(difference.tolerances))


def _numbers(rig: Rig) -> Iterator[tuple[str, Number]]:
    yield from rig.items()
    for effect, numbers in rig.effects.items():
        for name, number in numbers.items():
            yield f"{effect}.{name}", number
