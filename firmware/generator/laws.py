"""Laws that come over the link: their limits, inputs and operations, for both ends and for people."""

from __future__ import annotations

import json

from firmware.generator.declared import LAW_LIMITS, Table, camel


def cpp_laws(d: Table) -> list[str]:
    """Lines of C++."""
    out = ["// Laws that come over the link."]
    out += [f"inline constexpr std::uint32_t kLaw{camel(name)} = {d['law'][name]};" for name in LAW_LIMITS]
    out += ["enum class LawInput : std::uint8_t {"]
    out += [f"  {one['name']} = {place},  // {one['meaning']}" for place, one in enumerate(d["law_input"])]
    out += ["};", f"inline constexpr std::size_t kLawInputCount = {len(d['law_input'])};"]
    out += ["enum class Operation : std::uint8_t {"]
    out += [f"  {one['name']} = {one['code']},  // {one['meaning']}" for one in d["operation"]]
    costs = ", ".join(str(one["cost"]) for one in d["operation"])
    binary = sum(1 << one["code"] for one in d["operation"] if one["operands"] == 2)
    count = len(d["operation"])
    return [
        *out, "};", f"inline constexpr std::size_t kOperationCount = {count};",
        f"inline constexpr std::uint16_t kOperationCost[kOperationCount] = {{{costs}}};",
        "// A bit for each that has two operands.",
        f"inline constexpr std::uint32_t kBinaryOperations = 0x{binary:08x}U;", "",
    ]  # fmt: skip


def python_laws(d: Table) -> list[str]:
    """Lines of Python."""
    out = [f"LAW_{name.upper()} = {d['law'][name]}" for name in LAW_LIMITS]
    inputs = [json.dumps(one["name"]) for one in d["law_input"]]
    out += ["LAW_INPUTS: tuple[str, ...] = (", *(f"    {name}," for name in inputs), ")"]
    out += ['"""What a law is given, in the order of its cells."""', "", ""]
    out += [
        "@dataclass(frozen=True, slots=True)",
        "class OperationSpec:",
        '    """One operation of a law: its number, how many operands it takes, its worst case in instructions."""',
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
    for one in d["operation"]:
        values = (one["name"], one["code"], one["operands"], one["cost"], one["meaning"])
        out.append(f"    OperationSpec({', '.join(json.dumps(v, ensure_ascii=False) for v in values)}),")
    return [*out, ")", ""]


DOCUMENT = """\
## Laws

A law that comes over the link is data, never code: a *tape* of instructions without loop, branch or pointer over at most {cells} cells of f32.
The words of an upload, 32 bits each and at most {words}:

| words | hold |
|---|---|
| 1 | format u8 = {format}, divisor u8 (a call each so many ticks), signals u8 (at most {signals}), parameters u8 |
| 1 | constants u16, states u16 |
| 1 | instructions u16, zero u16 |
| one each | constants f32, parameters f32, states f32 as they are at the start |
| one each | cells of the outputs: front_V, back_V, three setpoints (elevation, pitch, travel), signals, new states |
| one each | instructions: operation in bits 31 to 27, cell written in 26 to 18, operands in 17 to 9 and 8 to 0; a sum of products has the number of its terms (at most {max_terms}) in 8 to 0, and behind it one word each: bit 31 takes the product away, factors in 17 to 9 and 8 to 0 |

Cells hold the {inputs} inputs, then constants, parameters and states, then what the instructions write. An instruction may write those last ones
only, and read what stands before it. A new state may not come from a state's own cell: that one may have changed by then. The operations round to
nearest, ties to even, like IEEE 754 single precision; a result below its normal numbers is 0. A sum of products is rounded once, at its end; what
comes before is exact to 2^-30 of its largest product. Every end computes by the same integer arithmetic (`firmware/core/law`), so that a tape gives
the same bits everywhere.

Each tick of a call costs at most {fixed_cost} instructions of the processor, {moving_cost} for an axis whose setpoint's rate or acceleration it
reads, and the costs of its operations, with {term_cost} for each term of a sum; the first tick {input_cost} more for each input, the last {output_cost}
more, {state_cost} a state and {signal_cost} a signal. When that is more than {tick_cost}, the call is spread over as many ticks as it needs, at most
{max_ticks} and at most its divisor: the inputs are those of the first of them, the outputs act from the last on.
"""


def document_laws(d: Table) -> list[str]:
    """Lines of docs/reference/link.md."""
    out = [DOCUMENT.format(inputs=len(d["law_input"]), **d["law"])]
    out += ["| cell | input | meaning |", "|---|---|---|"]
    out += [f"| {k} | `{one['name']}` | {one['meaning']} |" for k, one in enumerate(d["law_input"])]
    out += ["", "| code | operation | operands | cost | gives |", "|---|---|---|---|---|"]
    for one in d["operation"]:
        meaning = one["meaning"].replace("|", "\\|")
        out.append(f"| {one['code']} | `{one['name']}` | {one['operands']} | {one['cost']} | {meaning} |")
    return [*out, ""]
