"""A rig from what its builder states, and the comparison of two rigs."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

from heli_sim.errors import RigError
from heli_sim.rig.rig import Number, Rig, counts_by_encoder
from heli_sim.rig.schema import (
    COMMON_COUNTS,
    ENCODER_COUNTS,
    ENCODER_DIRECTIONS,
    RIG_QUANTITIES,
    UNSTATED,
    Quantity,
    check_size,
)

ASKED: Final = (
    *("M_f", "M_b", "M_w", "M_h", "M_l"),
    *("L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x"),
    *("thrust_gain", "dead_zone", "supply", "elevation_min", "elevation_max"),
    *ENCODER_COUNTS,
)
"""Numbers that a builder can state: what a scale, a ruler and data sheets give, in the order of asking."""
COLUMNS: Final = ("name", "value", "unit", "tolerance", "source")

UNSTATED_SHARE: Final = 0.3
"""Tolerance of a number that was not stated, as a share of the other rig's, at least. By judgement: rigs
of this type differ by a third. Smaller: a fit trusts the parameters of another rig. Larger: short flights
cannot determine what is left open."""
_ALIKE: Final = ("g", "air_density", "table_damping", "driver_dead_band")
"""Numbers that are no machine's own."""
_SCALE_SHARE, _RULER_m, _OTHER_SHARE = 0.01, 0.005, 0.1
"""Tolerances where none is stated: a kitchen scale's, a ruler's between axes, of anything else."""

_FACTORS: Final[Mapping[str, Mapping[str, float]]] = {
    "kg": {"kg": 1.0, "g": 1e-3},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "deg": {"deg": 1.0, "\N{DEGREE SIGN}": 1.0, "rad": 180.0 / math.pi},
    "V": {"V": 1.0, "mV": 1e-3},
    "N/V": {"N/V": 1.0, "mN/V": 1e-3, "g/V": 9.81e-3},
    "N m": {"N m": 1.0, "mN m": 1e-3},
    "N m s/rad": {"N m s/rad": 1.0, "mN m s/rad": 1e-3},
    "1": {"1": 1.0, "%": 1e-2},
}
_WRITTEN: Final = re.compile(
    r"""^\s*(?P<value>[-+]?[\d.]+(?:[eE][-+]?\d+)?)
    (?:\s*(?:\+-|\+/-|\N{PLUS-MINUS SIGN})\s*(?P<tolerance>[\d.]+(?:[eE][-+]?\d+)?))?
    \s*(?P<unit>[^;]*?)\s*(?:;\s*(?P<source>.*?)\s*)?$""",
    re.VERBOSE,
)


def described(name: str, description: str, like: Rig, given: Mapping[str, Number]) -> Rig:
    """Make a rig of the parameters `given`; the others, with wider tolerances, come from the rig that it is
    `like`.
    """
    numbers = {}
    given = counts_by_encoder(name, given)
    for quantity, like_number in like.items():
        if quantity in given:
            numbers[quantity] = given[quantity]
            continue
        if quantity in ENCODER_DIRECTIONS:
            # Wiring is no property that rigs of one type share.
            numbers[quantity] = Number(0.0, like_number.unit, 0.0, UNSTATED[quantity].source)
            continue
        differs_between_rigs = bool(like_number.tolerance) and quantity not in _ALIKE
        tolerance = (
            max(like_number.tolerance, UNSTATED_SHARE * abs(like_number.value))
            if differs_between_rigs
            else like_number.tolerance
        )
        numbers[quantity] = replace(like_number, tolerance=tolerance, source=f"not stated: as {like.name}")
    return Rig(name, description, numbers)


def number_from(name: str, text: str, source: str = "stated by its builder") -> Number:
    """Read a number with unit, tolerance and source, such as ``355 g``, ``0.64 +- 0.005 m`` or ``12 V; data
    sheet``.
    """
    quantity = _quantity_named(name)
    match = _WRITTEN.match(text)
    if match is None:
        raise RigError(
            f"{name}: '{text.strip()}' is not a number", f"write it as 0.5 +- 0.01 {quantity.unit}"
        )
    tolerance = match["tolerance"]
    return _number_in_file_unit(quantity, match["value"], tolerance, match["unit"], match["source"] or source)


def numbers_from_table(text: str, where: str) -> dict[str, Number]:
    """Read a CSV table with the columns name, value, unit, tolerance and source, the last three of which may
    be empty.
    """
    rows = csv.DictReader(io.StringIO(text, newline=""), skipinitialspace=True)
    heads = [head.strip() for head in rows.fieldnames or ()]
    if not {"name", "value"} <= set(heads) or set(heads) - set(COLUMNS):
        raise RigError(
            f"{where} must have the columns {', '.join(COLUMNS)}",
            "give at least name and value, and no other column",
        )
    rows.fieldnames = heads
    numbers: dict[str, Number] = {}
    for row in rows:
        cells = {head: (row.get(head) or "").strip() for head in COLUMNS}
        if not any(cells.values()):
            continue  # an empty row of a spreadsheet
        quantity = _quantity_named(cells["name"])
        if quantity.name in numbers:
            raise RigError(f"{where} has {quantity.name} twice", "leave one out")
        source = cells["source"] or "stated by its builder"
        numbers[quantity.name] = _number_in_file_unit(
            quantity, cells["value"], cells["tolerance"] or None, cells["unit"], source
        )
    return numbers


def numbers_from_words(words: Iterable[str]) -> dict[str, Number]:
    """Read `words`, each written as ``NAME=VALUE [+- TOLERANCE] [UNIT] [; SOURCE]``, see `number_from`."""
    numbers = {}
    for word in words:
        name, equals, text = word.partition("=")
        if not equals:
            raise RigError(f"'{word}' does not set a parameter", "write it as M_f=355+-4 g")
        numbers[name.strip()] = number_from(name.strip(), text)
    return numbers


def _quantity_named(name: str) -> Quantity:
    """Return a quantity of rigs by its name."""
    for quantity in (*RIG_QUANTITIES, COMMON_COUNTS):
        if quantity.name == name:
            return quantity
    raise RigError(
        f"unknown rig parameter '{name}'", f"choose from: {', '.join(q.name for q in RIG_QUANTITIES)}"
    )


def _number_in_file_unit(
    quantity: Quantity, value: str, tolerance: str | None, unit: str, source: str
) -> Number:
    """Return a stated number in the unit of rig files; without a tolerance it gets that of a ruler or a
    kitchen scale.
    """
    units = _FACTORS.get(quantity.unit, {quantity.unit: 1.0})
    factor = units.get(unit or quantity.unit)
    if factor is None and unit.startswith(","):
        raise RigError(
            f"{quantity.name}: '{value}{unit}' is not a number", "write it with a decimal point, not a comma"
        )
    if factor is None:
        raise RigError(f"{quantity.name} is in {unit}", f"give it in {' or '.join(units)}")
    try:
        size = factor * float(value)
        half_width = factor * float(tolerance) if tolerance is not None else _common_tolerance(quantity, size)
    except ValueError:
        raise RigError(
            f"{quantity.name}: '{value}' is not a number", "write it with a decimal point"
        ) from None
    origin = source if tolerance is not None else f"{source}; {_tolerance_reason(quantity)}"
    number = Number(size, quantity.unit, half_width, origin)
    check_size("stated", quantity.name, number.value, number.tolerance, number.unit)
    return number


def _common_tolerance(quantity: Quantity, value: float) -> float:
    """Return the tolerance that a value measured with common tools has."""
    if quantity.unit == "count" or quantity.name in ENCODER_DIRECTIONS:
        return 0.0
    if quantity.unit == "m":
        return _RULER_m
    return abs(value) * (_SCALE_SHARE if quantity.unit == "kg" else _OTHER_SHARE)


def _tolerance_reason(quantity: Quantity) -> str:
    """Return the reason for the tolerance of `_common_tolerance`."""
    if quantity.name in ENCODER_DIRECTIONS:
        return "exact"
    assumed = {"m": "a ruler's tolerance", "kg": "a kitchen scale's tolerance", "count": "exact"}
    return assumed.get(quantity.unit, "tolerance assumed, 10 %")


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
        """Right minus left, divided by the root sum of squares of the two tolerances."""
        # Within 1 the two can be the same rig. Infinite where neither allows any difference, and where one
        # rig does not have the number.
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
