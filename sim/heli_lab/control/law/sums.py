"""Combine additions and multiplications of a program into sums of products, if the board computes those
faster.

A value that is made of additions, subtractions and multiplications, such as a x + b y - c z, becomes a single
operation with one term per product. A linear law consists mostly of such values.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Final

from heli_host.declaration import LAW_MAX_TERMS, LAW_TERM_COST, OPERATIONS

from heli_lab.control.law.program import CODE, Program, Value

SUM: Final = "sum_of_products"
_LINEAR: Final = frozenset(("add", "subtract", "negate", "multiply"))


@dataclass(frozen=True)
class _Product:
    """A term of a sum."""

    factor: float  # Constant factor
    first: int  # Index of the value that the factor multiplies
    second: int | None = None  # Index of a second value that is multiplied; None if there is none


def with_sums(program: Program, outputs: list[int]) -> tuple[Program, list[int]]:
    """Replace additions and multiplications by sums of products where these cost less. Returns `program`,
    `outputs`.
    """
    readers = Counter(operand for value in program.values for operand in value.operands)
    readers.update(outputs)
    read_values = set(outputs)
    sums: dict[int, list[_Product]] = {}
    for index in range(len(program.values) - 1, -1, -1):
        if index not in read_values:
            continue
        value = program.values[index]
        if value.kind in _LINEAR:
            sums[index] = _merge_equal_products(
                program, _expand_to_products(program, readers, index, 1.0, is_root=True)
            )
            for product in sums[index]:
                read_values.add(product.first)
                if product.second is not None:
                    read_values.add(product.second)
        else:
            read_values.update(value.operands)
    result = Program(program.name)
    new_index: dict[int, int] = {}
    for index in sorted(read_values):
        if index in sums:
            products = [_reindexed(product, new_index) for product in sums[index]]
            new_index[index] = _append_cheapest_sum(result, products)
        else:
            result.copy_value(program, index, new_index)
    return result, [new_index[output] for output in outputs]


def _reindexed(product: _Product, new_index: dict[int, int]) -> _Product:
    """Return the same product for another program, whose indices `new_index` gives."""
    second = None if product.second is None else new_index[product.second]
    return _Product(product.factor, new_index[product.first], second)


def _expand_to_products(
    program: Program, readers: Counter[int], index: int, factor: float, is_root: bool = False
) -> list[_Product]:
    """Expand a value of the program, times a factor, into products.

    A value that several operations read is not expanded, because it is computed once anyway.
    """
    value = program.values[index]
    if value.kind not in _LINEAR or (readers[index] > 1 and not is_root):
        return [_Product(factor, index)]
    if value.kind == "negate":
        return _expand_to_products(program, readers, value.operands[0], -factor)
    first, second = value.operands
    if value.kind != "multiply":
        second_factor = factor if value.kind == "add" else -factor
        return [
            *_expand_to_products(program, readers, first, factor),
            *_expand_to_products(program, readers, second, second_factor),
        ]
    for constant, other in ((first, second), (second, first)):
        number = program.constant_number(constant)
        if number is not None:
            return _expand_to_products(program, readers, other, factor * number)
    if abs(factor) == 1.0:
        return [_Product(factor, first, second)]
    return [_Product(factor, index)]


def _merge_equal_products(program: Program, products: list[_Product]) -> list[_Product]:
    """Combine products of the same values into one, and all constant terms into one."""
    factors: dict[tuple[int, int | None], float] = {}
    offset, constant = 0.0, -1
    for product in products:
        number = program.constant_number(product.first)
        if number is not None and product.second is None:
            offset, constant = offset + product.factor * number, product.first
            continue
        key = (product.first, product.second)
        factors[key] = factors.get(key, 0.0) + product.factor
    merged = [_Product(factor, *key) for key, factor in factors.items() if factor != 0.0]
    number = program.constant_number(constant) if offset != 0.0 else None
    return [*merged, _Product(offset / number, constant)] if number else merged


def _cost_on_board(name: str) -> int:
    """Cost of an operation on the board, in the unit of the declaration."""
    return OPERATIONS[CODE[name]].cost


def _append_cheapest_sum(program: Program, products: list[_Product]) -> int:
    """Append the sum of some products to a program; return the index of the result.

    The sum becomes one operation, or single additions and multiplications if they cost less.
    """
    if not products:
        return program.constant(0.0)
    products = [_with_two_operands(program, product) for product in products]
    multiplications = sum(product.second is not None or abs(product.factor) != 1.0 for product in products)
    separate_cost = multiplications * _cost_on_board("multiply") + (len(products) - 1) * _cost_on_board("add")
    if all(product.factor == -1.0 for product in products):
        separate_cost += _cost_on_board("negate")
    if len(products) == 1 or separate_cost <= _cost_on_board(SUM) + LAW_TERM_COST * len(products):
        return _append_single_operations(program, products)
    while len(products) > LAW_MAX_TERMS:
        first_terms = _Product(1.0, _append_sum(program, products[:LAW_MAX_TERMS]))
        products = [first_terms, *products[LAW_MAX_TERMS:]]
    return _append_sum(program, products)


def _with_two_operands(program: Program, product: _Product) -> _Product:
    """Simplify a product so that a sum of products can hold it, which has two operands and a sign per term.

    A constant with a factor becomes another constant. The product of two values with a factor becomes one
    value with that factor.
    """
    number = program.constant_number(product.first)
    if number is not None and product.second is None:
        return _Product(1.0, program.constant(product.factor * number))
    if product.second is not None and abs(product.factor) != 1.0:
        return _Product(product.factor, program.append("multiply", product.first, product.second))
    return product


def _append_sum(program: Program, products: list[_Product]) -> int:
    """Append one sum of products to a program; return its index."""
    operands: list[int] = []
    subtracted_bits = 0
    for k, product in enumerate(products):
        subtracted_bits |= (product.factor < 0.0) << k
        second = program.constant(abs(product.factor)) if product.second is None else product.second
        operands += [product.first, second]
    return program.put(Value(SUM, subtracted_bits, tuple(operands)))


def _append_single_operations(program: Program, products: list[_Product]) -> int:
    """Append a multiplication per product and additions between them; return the index of the result."""
    total: int | None = None
    # Added products first, so that the others can be subtracted from them.
    for product in sorted(products, key=lambda each: each.factor == -1.0):
        is_subtracted = product.factor == -1.0
        if product.second is not None:
            value = program.append("multiply", product.first, product.second)
        elif is_subtracted:
            value = product.first
        else:
            value = program.append("multiply", product.first, program.constant(product.factor))
        if total is None:
            total = program.append("negate", value) if is_subtracted else value
        else:
            total = program.append("subtract" if is_subtracted else "add", total, value)
    assert total is not None
    return total
