"""Units as products of powers of base units."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Final

BASE: Final = ("N", "m", "s", "V", "rad")
"""Base units. The radian counts as 1 in the argument of a function, and is kept in units of parameters: N
m/rad is a stiffness."""
_FACTOR: Final = re.compile(r"([A-Za-z]+)(-?\d+)?")


@dataclass(frozen=True)
class Unit:
    """A unit as a product of powers."""

    exponents: tuple[int, ...] = (0,) * len(BASE)  # Exponent of each unit of `BASE`

    @classmethod
    def parse(cls, text: str) -> Unit:
        """Parse a `text` in the spelling of rig files, such as ``N m s2/rad2`` or ``1``."""
        exponents = dict.fromkeys(BASE, 0)
        for sign, part in zip((1, -1), text.partition("/")[::2], strict=True):
            for name, power in _FACTOR.findall(part):
                if name not in exponents:
                    raise ValueError(f"unknown unit '{name}' in '{text}'; use {', '.join(BASE)}")
                exponents[name] += sign * int(power or 1)
        return cls(tuple(exponents.values()))

    def __mul__(self, other: Unit) -> Unit:
        return Unit(tuple(a + b for a, b in zip(self.exponents, other.exponents, strict=True)))

    def __truediv__(self, other: Unit) -> Unit:
        return Unit(tuple(a - b for a, b in zip(self.exponents, other.exponents, strict=True)))

    def __pow__(self, power: int) -> Unit:
        return Unit(tuple(power * exponent for exponent in self.exponents))

    @property
    def is_number(self) -> bool:
        """Whether it is a pure number or an angle, and so may be the argument of a sine."""
        return not any(self.exponents[:-1])

    def __str__(self) -> str:
        def spelled(sign: int) -> str:
            """Write the units with exponents of a sign, such as ``m2 N``."""
            return " ".join(
                f"{name}{abs(power) if abs(power) > 1 else ''}"
                for name, power in zip(BASE, self.exponents, strict=True)
                if sign * power > 0
            )

        above, below = spelled(1), spelled(-1)
        return f"{above or '1'}/{below}" if below else above or "1"


NONE: Final = Unit()
"""Unit of a pure number."""
