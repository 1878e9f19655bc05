"""Combine additions and multiplications of a program into sums of products, if the board computes those
faster.

What is added, taken away, and multiplied by constants on its way into one result becomes one operation with a
term for each product: most of a linear law is that.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

from heli_host.declaration import LAW_MAX_TERMS, LAW_TERM_COST, OPERATIONS

from heli_lab.law.program import CODE, Program, Value

SUM: Final = "sum_of_products"
_LINEAR: Final = frozenset(("add", "subtract", "negate", "multiply"))


@dataclass(frozen=True)
class _Part:
    """A term: `factor` times one value, or times the product of two."""

    factor: float
    first: int
    second: int | None = None


def with_sums(program: Program, outputs: list[int]) -> tuple[Program, list[int]]:
    """Return the program with sums of products where they cost less.

    Parameters
    ----------
    program : Program
        Values in the order of their computation.
    outputs : list of int
        Places of those that are wanted.

    Returns
    -------
    tuple of Program and list of int
        The same, and where its outputs are.
    """
    uses = Counter(operand for value in program.values for operand in value.operands)
    uses.update(outputs)
    needed = set(outputs)
    parts: dict[int, list[_Part]] = {}
    for place in range(len(program.values) - 1, -1, -1):
        if place not in needed:
            continue
        value = program.values[place]
        if value.kind in _LINEAR:
            parts[place] = _merged(program, _gathered(program, uses, place, 1.0, root=True))
            for part in parts[place]:
                needed.update(place_ for place_ in (part.first, part.second) if place_ is not None)
        else:
            needed.update(value.operands)
    kept = Program(program.name)
    moved: dict[int, int] = {}
    for place in sorted(needed):
        if place in parts:
            moved[place] = _put(kept, [_moved(part, moved) for part in parts[place]])
        else:
            kept.take(program, place, moved)
    return kept, [moved[output] for output in outputs]


def _moved(part: _Part, moved: dict[int, int]) -> _Part:
    return _Part(part.factor, moved[part.first], None if part.second is None else moved[part.second])


def _gathered(
    program: Program, uses: Counter[int], place: int, factor: float, root: bool = False
) -> list[_Part]:
    """Return the terms of a value. A value that another operation reads too stays a separate term."""
    value = program.values[place]
    if value.kind not in _LINEAR or (uses[place] > 1 and not root):
        return [_Part(factor, place)]
    if value.kind == "negate":
        return _gathered(program, uses, value.operands[0], -factor)
    first, second = value.operands
    if value.kind != "multiply":
        other = factor if value.kind == "add" else -factor
        return _gathered(program, uses, first, factor) + _gathered(program, uses, second, other)
    for known, unknown in ((first, second), (second, first)):
        number = program.number(known)
        if number is not None:
            return _gathered(program, uses, unknown, factor * number)
    if abs(factor) == 1.0:
        return [_Part(factor, first, second)]
    return [_Part(factor, place)]


def _merged(program: Program, parts: list[_Part]) -> list[_Part]:
    """Combine equal products into one term, and all constants into one."""
    factors: dict[tuple[int, int | None], float] = {}
    offset, first = 0.0, -1
    for part in parts:
        number = program.number(part.first)
        if number is not None and part.second is None:
            offset, first = offset + part.factor * number, part.first
            continue
        key = (part.first, part.second)
        factors[key] = factors.get(key, 0.0) + part.factor
    merged = [_Part(factor, *key) for key, factor in factors.items() if factor != 0.0]
    number = program.number(first) if offset != 0.0 else None
    return [*merged, _Part(offset / number, first)] if number else merged


def _cost(name: str) -> int:
    return OPERATIONS[CODE[name]].cost


def _put(program: Program, parts: list[_Part]) -> int:
    """Append one sum of products, or single operations, whichever costs less."""
    if not parts:
        return program.constant(0.0)
    parts = [_plain(program, part) for part in parts]
    products = sum(part.second is not None or abs(part.factor) != 1.0 for part in parts)
    one_by_one = products * _cost("multiply") + (len(parts) - 1) * _cost("add")
    if all(part.factor == -1.0 for part in parts):
        one_by_one += _cost("negate")
    if len(parts) == 1 or one_by_one <= _cost(SUM) + LAW_TERM_COST * len(parts):
        return _one_by_one(program, parts)
    while len(parts) > LAW_MAX_TERMS:
        parts = [_Part(1.0, _put_sum(program, parts[:LAW_MAX_TERMS])), *parts[LAW_MAX_TERMS:]]
    return _put_sum(program, parts)


def _plain(program: Program, part: _Part) -> _Part:
    """Simplify a term: a constant and its factor become one constant, and a product with a factor becomes one
    value with that factor.
    """
    number = program.number(part.first)
    if number is not None and part.second is None:
        return _Part(1.0, program.constant(part.factor * number))
    if part.second is not None and abs(part.factor) != 1.0:
        return _Part(part.factor, program.do("multiply", part.first, part.second))
    return part


def _put_sum(program: Program, parts: list[_Part]) -> int:
    operands: list[int] = []
    negative = 0
    for k, part in enumerate(parts):
        negative |= (part.factor < 0.0) << k
        second = program.constant(abs(part.factor)) if part.second is None else part.second
        operands += [part.first, second]
    return program.put(Value(SUM, negative, tuple(operands)))


def _one_by_one(program: Program, parts: list[_Part]) -> int:
    total: int | None = None
    # What is added first, so that there is something to take the rest from.
    for part in sorted(parts, key=lambda part_: part_.factor == -1.0):
        negative = part.factor == -1.0
        if part.second is not None:
            value = program.do("multiply", part.first, part.second)
        elif negative:
            value = part.first
        else:
            value = program.do("multiply", part.first, program.constant(part.factor))
        if total is None:
            total = program.do("negate", value) if negative else value
        else:
            total = program.do("subtract" if negative else "add", total, value)
    assert total is not None
    return total
