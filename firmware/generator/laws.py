"""Control laws that are uploaded over the link: limits, inputs and operations, as C++, Python and text."""

from __future__ import annotations

import json

from firmware.generator.declared import LAW_LIMITS, Table, camel


def cpp_laws(declaration: Table) -> list[str]:
    """Return the part of declaration.hpp about uploaded laws."""
    out = ["// Laws that come over the link."]
    out += [
        f"inline constexpr std::uint32_t kLaw{camel(name)} = {declaration['law'][name]};"
        for name in LAW_LIMITS
    ]
    out += ["enum class LawInput : std::uint8_t {"]
    out += [
        f"  {entry['name']} = {index},  // {entry['meaning']}"
        for index, entry in enumerate(declaration["law_input"])
    ]
    out += ["};", f"inline constexpr std::size_t kLawInputCount = {len(declaration['law_input'])};"]
    out += ["enum class Operation : std::uint8_t {"]
    out += [
        f"  {entry['name']} = {entry['code']},  // {entry['meaning']}" for entry in declaration["operation"]
    ]
    costs = ", ".join(str(entry["cost"]) for entry in declaration["operation"])
    binary = sum(1 << entry["code"] for entry in declaration["operation"] if entry["operands"] == 2)
    count = len(declaration["operation"])
    return [
        *out, "};", f"inline constexpr std::size_t kOperationCount = {count};",
        f"inline constexpr std::uint16_t kOperationCost[kOperationCount] = {{{costs}}};",
        "// A bit for each that has two operands.",
        f"inline constexpr std::uint32_t kBinaryOperations = 0x{binary:08x}U;", "",
    ]  # fmt: skip


def python_laws(declaration: Table) -> list[str]:
    """Return the part of declaration.py about uploaded laws."""
    out = [f"LAW_{name.upper()} = {declaration['law'][name]}" for name in LAW_LIMITS]
    inputs = [json.dumps(entry["name"]) for entry in declaration["law_input"]]
    out += ["LAW_INPUTS: tuple[str, ...] = (", *(f"    {name}," for name in inputs), ")"]
    out += ['"""Inputs of a law, in the order of its cells."""', "", ""]
    out += [
        "@dataclass(frozen=True, slots=True)",
        "class OperationSpec:",
        '    """One operation of a law: its number, its number of operands, and its worst-case instructions."""',
        "",
        "    name: str",
        "    code: int",
        "    operands: int",
        "    cost: int",
        "    meaning: str",
        "",
        "",
        "OPERATIONS: tuple[OperationSpec, ...] = (",
    ]
    for entry in declaration["operation"]:
        values = (entry["name"], entry["code"], entry["operands"], entry["cost"], entry["meaning"])
        out.append(
            f"    OperationSpec({', '.join(json.dumps(value, ensure_ascii=False) for value in values)}),"
        )
    return [*out, ")", ""]


DOCUMENT = """\
## Laws

A control law that comes over the link is data, not code. It is a *tape*: a list of instructions without loop, branch or pointer, over at most {cells}
cells of f32. An upload has at most {words} words of 32 bits:

| words | content |
|---|---|
| 1 | format u8 = {format}, divisor u8 (one call per so many ticks), signals u8 (at most {signals}), parameters u8 |
| 1 | constants u16, states u16 |
| 1 | instructions u16, zero u16 |
| one each | constants f32, parameters f32, initial states f32 |
| one each | cells of the outputs: front_V, back_V, three setpoints (elevation, pitch, travel), signals, new states |
| one each | instructions, see below |

| bits of an instruction | content |
|---|---|
| 31 to 27 | operation |
| 26 to 18 | cell that it writes |
| 17 to 9, 8 to 0 | operands; in a sum of products, 8 to 0 is the number of its terms (at most {max_terms}) |

In a sum of products, one word per term follows the instruction:

| bits of a term | content |
|---|---|
| 31 | 1 subtracts the product |
| 17 to 9, 8 to 0 | factors |

**Cells** contain the {inputs} inputs, then constants, parameters and states, then the results of instructions. An instruction writes one of these results,
and reads only cells before it. The output of a new state must not be the cell of a state, because that cell may have changed.

**Arithmetic** rounds to nearest, ties to even, like IEEE 754 single precision. A result that is too small for a normal number is 0. The products of
a sum are added with an error of at most 2^-30 of the largest product, and the sum is rounded once. Host and board use the same integer
arithmetic (`firmware/core/law`), so a tape gives the same bits everywhere.

**Cost** in instructions of the processor:

| part | instructions |
|---|---|
| each tick of a call | {fixed_cost} |
| each axis, if the law reads the rate or acceleration of its setpoint | {moving_cost} per tick |
| each operation | see the table below |
| each term of a sum of products | {term_cost} |
| each input | {input_cost}, in the first tick |
| outputs | {output_cost}, in the last tick |
| each state | {state_cost}, in the last tick |
| each signal | {signal_cost}, in the last tick |

A call that costs more than {tick_cost} takes several ticks: at most {max_ticks}, and at most its divisor. It reads its inputs in the first of these ticks. Its
outputs act from the last tick on.
"""


def document_laws(declaration: Table) -> list[str]:
    """Return the part of docs/reference/link.md about uploaded laws."""
    out = [DOCUMENT.format(inputs=len(declaration["law_input"]), **declaration["law"])]
    out += ["| cell | input | meaning |", "|---|---|---|"]
    out += [
        f"| {index} | `{entry['name']}` | {entry['meaning']} |"
        for index, entry in enumerate(declaration["law_input"])
    ]
    out += ["", "| code | operation | operands | cost | gives |", "|---|---|---|---|---|"]
    for entry in declaration["operation"]:
        meaning = entry["meaning"].replace("|", "\\|")
        out.append(
            f"| {entry['code']} | `{entry['name']}` | {entry['operands']} | {entry['cost']} | {meaning} |"
        )
    return [*out, ""]
