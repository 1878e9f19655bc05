"""Comparison of two rigs: the differences of their parameters, in units of their tolerances."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from heli_sim.rig.rig import Number, Rig

# A rig file holds seven digits.
_SAME = 1e-6


@dataclass(frozen=True)
class Difference:
    """A parameter of two rigs: its `name`, or ``effect.name`` for an effect's parameter. `left` or `right` is
    None if that rig does not have it.
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
        """Right minus left, divided by the root sum of squares of the two tolerances.

        Within 1 the two can be the same rig. Infinite where neither allows any difference, and where one rig
        does not have the number.
        """
        if self.same:
            return 0.0
        if self.left is None or self.right is None:
            return math.inf
        difference = self.right.value - self.left.value
        joint_tolerance = math.hypot(self.left.tolerance, self.right.tolerance)
        return difference / joint_tolerance if joint_tolerance > 0.0 else math.copysign(math.inf, difference)


def compare_rigs(left: Rig, right: Rig) -> list[Difference]:
    """Compare all parameters of two rigs. The largest difference in tolerances comes first; equal ones are in
    the order of the rigs.
    """
    sides = dict(_all_numbers(left)), dict(_all_numbers(right))
    names = dict.fromkeys([*sides[0], *sides[1]])
    compared = [Difference(name, sides[0].get(name), sides[1].get(name)) for name in names]
    return sorted(compared, key=lambda difference: -abs(difference.tolerances))


def _all_numbers(rig: Rig) -> Iterator[tuple[str, Number]]:
    """Yield all numbers of a rig with their names, including those of its effects."""
    yield from rig.items()
    for effect, numbers in rig.effects.items():
        for name, number in numbers.items():
            yield f"{effect}.{name}", number
