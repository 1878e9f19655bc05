"""Random ARMv7-M instructions, from a table of encodings that owes nothing to the emulator.

A field is a letter; its bits may be scattered over the two halfwords. `ok` names the values that the
architecture manual defines: everything else is UNPREDICTABLE and not generated.
"""

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pytest
from due_emulator import BareCore
from numpy.typing import NDArray

Fields = dict[str, int]


@dataclass(frozen=True)
class Encoding:
    """One encoding: its bits, its legal fields, and how it may be used in a random program."""

    # `name`: Mnemonic and encoding of the manual.
    # `bits`: 16 or 32 characters: 0, 1 or the letter of a field.
    # `ok`: True for fields that the manual defines.
    # `reads`: Letters of registers that address memory: `b` must hold the base, `x` a small index.
    # `writes`: Letters of registers that the instruction changes.
    # `in_it`: Whether it may stand in an IT block.
    # `fixed`: Fields that a random program needs at one value, such as branch offsets.

    name: str
    bits: str
    ok: Callable[[Fields], bool] = lambda f: True
    base: str = ""
    index: str = ""
    writes: str = ""
    in_it: bool = True
    fixed: Fields = field(default_factory=dict)
    filler: bool = False
    register_list: str = ""

    @cached_property
    def widths(self) -> dict[str, int]:
        """Bits of each field."""
        return {c: self.bits.count(c) for c in sorted(set(self.bits)) if c not in "01"}

    @cached_property
    def _layout(self) -> tuple[int, tuple[tuple[str, int, int], ...]]:
        """Constant bits, and for each bit of a field its place there and in the word."""
        remaining_bits = dict(self.widths)
        constant = 0
        places = []
        for position, bit in zip(range(len(self.bits) - 1, -1, -1), self.bits, strict=True):
            if bit in "01":
                constant |= int(bit) << position
            else:
                remaining_bits[bit] -= 1
                places.append((bit, remaining_bits[bit], position))
        return constant, tuple(places)

    def assemble(self, fields: Fields) -> bytes:
        """Halfwords of the instruction with these fields."""
        word, places = self._layout
        for name, source, position in places:
            word |= (fields[name] >> source & 1) << position
        if len(self.bits) == 16:
            return word.to_bytes(2, "little")
        return (word >> 16).to_bytes(2, "little") + (word & 0xFFFF).to_bytes(2, "little")


def _not_sp_or_pc(*letters: str) -> Callable[[Fields], bool]:
    """Whether the registers that these fields name are neither the stack pointer nor the program counter."""
    return lambda f: all(f[letter] not in (13, 15) for letter in letters)


def _not_base(f: Fields) -> bool:
    """Whether the list `l` names registers, but not the base, bit by bit."""
    return f["l"] != 0 and not f["l"] >> f["b"] & 1


def _several_not_base(f: Fields) -> bool:
    """Whether the list `l` names at least two registers, but neither the base nor the stack pointer."""
    return f["l"].bit_count() > 1 and not f["l"] >> f["b"] & 1 and f["l"] < 0x2000


def _several_stored_not_base(f: Fields) -> bool:
    """Whether the list `l` names at least two registers, and the base is not among r0 to r12 of it."""
    return f["l"].bit_count() > 1 and not (f["l"] & 0x1FFF) >> f["b"] & 1


def _two_stored(f: Fields) -> bool:
    """Whether `t` and `y` are neither stack pointer nor program counter, and the base is neither of them."""
    return _not_sp_or_pc("t", "y")(f) and f["b"] not in (f["t"], f["y"], 15)


def _two_loaded(f: Fields) -> bool:
    """Whether `t` and `y` may be loaded: as for storing, and not twice the same register."""
    return _two_stored(f) and f["t"] != f["y"]


def _encoding(
    name: str, bits: str, ok: Callable[[Fields], bool] = lambda f: True, **more: object
) -> Encoding:
    # `more` are fields of Encoding, whose types differ.
    return Encoding(name, bits.replace(" ", ""), ok, **more)  # type: ignore[arg-type]


def _modified(f: Fields) -> bool:
    """ThumbExpandImm is defined: not a zero byte repeated."""
    return not (0x100 <= f["i"] < 0x400 and f["i"] & 0xFF == 0)


def _data_processing() -> list[Encoding]:
    """Return those of 32 bits. Fields: n, m, a: operands; d, l: results; i: immediate or lowest bit;
    w: width; s: sets the flags; t: kind of shift; r: rotation.
    """
    table = []
    for name, op in (
        ("AND", "0000"),
        ("BIC", "0001"),
        ("EOR", "0100"),
        ("ADC", "1010"),
        ("SBC", "1011"),
        ("RSB", "1110"),
        ("ADD", "1000"),
        ("SUB", "1101"),
        ("ORR", "0010"),
        ("ORN", "0011"),
    ):
        table.append(
            _encoding(
                f"{name} imm",
                f"11110i0{op}snnnn 0iiiddddiiiiiiii",
                lambda f: _not_sp_or_pc("n", "d")(f) and _modified(f),
                writes="d",
            )
        )
        table.append(
            _encoding(
                f"{name} reg", f"1110101{op}snnnn 0iiiddddiittmmmm", _not_sp_or_pc("n", "d", "m"), writes="d"
            )
        )
    for name, op in (("TST", "0000"), ("TEQ", "0100"), ("CMN", "1000"), ("CMP", "1101")):
        table.append(
            _encoding(
                f"{name} imm",
                f"11110i0{op}1nnnn 0iii1111iiiiiiii",
                lambda f: _not_sp_or_pc("n")(f) and _modified(f),
            )
        )
        table.append(_encoding(f"{name} reg", f"1110101{op}1nnnn 0iii1111iittmmmm", _not_sp_or_pc("n", "m")))
    for name, op in (("MOV", "0010"), ("MVN", "0011")):
        table.append(
            _encoding(
                f"{name} imm",
                f"11110i0{op}s1111 0iiiddddiiiiiiii",
                lambda f: _not_sp_or_pc("d")(f) and _modified(f),
                writes="d",
            )
        )
        table.append(
            _encoding(
                f"{name} reg", f"1110101{op}s1111 0iiiddddiittmmmm", _not_sp_or_pc("d", "m"), writes="d"
            )
        )
    table += [
        _encoding("ADDW", "11110i100000nnnn 0iiiddddiiiiiiii", _not_sp_or_pc("n", "d"), writes="d"),
        _encoding("SUBW", "11110i101010nnnn 0iiiddddiiiiiiii", _not_sp_or_pc("n", "d"), writes="d"),
        _encoding("ADR+", "11110i1000001111 0iiiddddiiiiiiii", _not_sp_or_pc("d"), writes="d"),
        _encoding("ADR-", "11110i1010101111 0iiiddddiiiiiiii", _not_sp_or_pc("d"), writes="d"),
        _encoding("MOVW", "11110i100100iiii 0iiiddddiiiiiiii", _not_sp_or_pc("d"), writes="d"),
        _encoding("MOVT", "11110i101100iiii 0iiiddddiiiiiiii", _not_sp_or_pc("d"), writes="d"),
        _encoding("SSAT lsl", "111100110000nnnn 0iiiddddii0wwwww", _not_sp_or_pc("n", "d"), writes="d"),
        _encoding(
            "SSAT asr",
            "111100110010nnnn 0iiiddddii0wwwww",
            lambda f: _not_sp_or_pc("n", "d")(f) and f["i"] != 0,
            writes="d",
        ),
        _encoding("USAT lsl", "111100111000nnnn 0iiiddddii0wwwww", _not_sp_or_pc("n", "d"), writes="d"),
        _encoding(
            "USAT asr",
            "111100111010nnnn 0iiiddddii0wwwww",
            lambda f: _not_sp_or_pc("n", "d")(f) and f["i"] != 0,
            writes="d",
        ),
        _encoding(
            "SBFX",
            "111100110100nnnn 0iiiddddii0wwwww",
            lambda f: _not_sp_or_pc("n", "d")(f) and f["i"] + f["w"] < 32,
            writes="d",
        ),
        _encoding(
            "UBFX",
            "111100111100nnnn 0iiiddddii0wwwww",
            lambda f: _not_sp_or_pc("n", "d")(f) and f["i"] + f["w"] < 32,
            writes="d",
        ),
        _encoding(
            "BFI",
            "111100110110nnnn 0iiiddddii0wwwww",
            lambda f: _not_sp_or_pc("n", "d")(f) and f["w"] >= f["i"],
            writes="d",
        ),
        _encoding(
            "BFC",
            "1111001101101111 0iiiddddii0wwwww",
            lambda f: _not_sp_or_pc("d")(f) and f["w"] >= f["i"],
            writes="d",
        ),
    ]
    for name, op in (("LSL", "00"), ("LSR", "01"), ("ASR", "10"), ("ROR", "11")):
        table.append(
            _encoding(
                f"{name} reg",
                f"111110100{op}snnnn 1111dddd0000mmmm",
                _not_sp_or_pc("n", "d", "m"),
                writes="d",
            )
        )
    for name, op in (("SXTH", "000"), ("UXTH", "001"), ("SXTB", "100"), ("UXTB", "101")):
        table.append(
            _encoding(f"{name}.W", f"111110100{op}1111 1111dddd10rrmmmm", _not_sp_or_pc("d", "m"), writes="d")
        )
    for name, op in (("REV", "00"), ("REV16", "01"), ("RBIT", "10"), ("REVSH", "11")):
        for m in range(16):
            if m in (13, 15):
                continue
            same = f"{m:04b}"
            table.append(
                _encoding(
                    f"{name}.W r{m}",
                    f"111110101001{same} 1111dddd10{op}{same}",
                    _not_sp_or_pc("d"),
                    writes="d",
                )
            )
    for m in range(13):
        table.append(
            _encoding(f"CLZ r{m}", f"111110101011{m:04b} 1111dddd1000{m:04b}", _not_sp_or_pc("d"), writes="d")
        )
    table += [
        _encoding("MUL.W", "111110110000nnnn 1111dddd0000mmmm", _not_sp_or_pc("n", "d", "m"), writes="d"),
        _encoding("MLA", "111110110000nnnn aaaadddd0000mmmm", _not_sp_or_pc("n", "d", "m", "a"), writes="d"),
        _encoding("MLS", "111110110000nnnn aaaadddd0001mmmm", _not_sp_or_pc("n", "d", "m", "a"), writes="d"),
        _encoding("SDIV", "111110111001nnnn 1111dddd1111mmmm", _not_sp_or_pc("n", "d", "m"), writes="d"),
        _encoding("UDIV", "111110111011nnnn 1111dddd1111mmmm", _not_sp_or_pc("n", "d", "m"), writes="d"),
    ]
    for name, op in (("SMULL", "000"), ("UMULL", "010"), ("SMLAL", "100"), ("UMLAL", "110")):
        table.append(
            _encoding(
                name,
                f"111110111{op}nnnn lllldddd0000mmmm",
                lambda f: _not_sp_or_pc("n", "d", "m", "l")(f) and f["l"] != f["d"],
                writes="dl",
            )
        )
    return table


def _narrow() -> list[Encoding]:
    table = [
        _encoding("LSL T1", "00000iiiiimmmddd", writes="d"),
        _encoding("LSR T1", "00001iiiiimmmddd", writes="d"),
        _encoding("ASR T1", "00010iiiiimmmddd", writes="d"),
        _encoding("ADD T1", "0001100mmmnnnddd", writes="d"),
        _encoding("SUB T1", "0001101mmmnnnddd", writes="d"),
        _encoding("ADD imm3", "0001110iiinnnddd", writes="d"),
        _encoding("SUB imm3", "0001111iiinnnddd", writes="d"),
        _encoding("MOV imm8", "00100dddiiiiiiii", writes="d"),
        _encoding("CMP imm8", "00101nnniiiiiiii"),
        _encoding("ADD imm8", "00110dddiiiiiiii", writes="d"),
        _encoding("SUB imm8", "00111dddiiiiiiii", writes="d"),
        _encoding(
            "ADD hi",
            "01000100dmmmmddd",
            lambda f: f["d"] != 15 and f["m"] not in (13, 15) and f["d"] != 13,
            writes="d",
        ),
        _encoding(
            "CMP hi", "01000101nmmmmnnn", lambda f: f["n"] < 15 and f["m"] < 15 and max(f["n"], f["m"]) > 7
        ),
        _encoding("MOV hi", "01000110dmmmmddd", lambda f: f["d"] not in (13, 15), writes="d"),
        _encoding("ADR T1", "10100dddiiiiiiii", writes="d"),
        _encoding("ADD SP T1", "10101dddiiiiiiii", writes="d"),
        _encoding("SXTH", "1011001000mmmddd", writes="d"),
        _encoding("SXTB", "1011001001mmmddd", writes="d"),
        _encoding("UXTH", "1011001010mmmddd", writes="d"),
        _encoding("UXTB", "1011001011mmmddd", writes="d"),
        _encoding("REV", "1011101000mmmddd", writes="d"),
        _encoding("REV16", "1011101001mmmddd", writes="d"),
        _encoding("REVSH", "1011101011mmmddd", writes="d"),
    ]
    names = [
        "AND",
        "EOR",
        "LSL",
        "LSR",
        "ASR",
        "ADC",
        "SBC",
        "ROR",
        "TST",
        "RSB",
        "CMP",
        "CMN",
        "ORR",
        "MUL",
        "BIC",
        "MVN",
    ]
    for op, name in enumerate(names):
        writes = "" if name in ("TST", "CMP", "CMN") else "d"
        table.append(_encoding(f"{name} T1", f"010000{op:04b}mmmddd", writes=writes))
    return table


def _memory() -> list[Encoding]:
    table = []
    for name, op, load in (
        ("STR", "000", 0),
        ("STRH", "001", 0),
        ("STRB", "010", 0),
        ("LDRSB", "011", 1),
        ("LDR", "100", 1),
        ("LDRH", "101", 1),
        ("LDRB", "110", 1),
        ("LDRSH", "111", 1),
    ):
        table.append(
            _encoding(f"{name} reg T1", f"0101{op}xxxbbbttt", base="b", index="x", writes="t" if load else "")
        )
    for name, op, load in (
        ("STR", "01100", 0),
        ("LDR", "01101", 1),
        ("STRB", "01110", 0),
        ("LDRB", "01111", 1),
        ("STRH", "10000", 0),
        ("LDRH", "10001", 1),
    ):
        table.append(_encoding(f"{name} imm T1", f"{op}iiiiibbbttt", base="b", writes="t" if load else ""))
    table += [
        _encoding("STR SP", "10010tttiiiiiiii"),
        _encoding("LDR SP", "10011tttiiiiiiii", writes="t"),
        _encoding("LDR lit T1", "01001tttiiiiiiii", writes="t"),
        _encoding("STM T1", "11000bbbllllllll", _not_base, base="b"),
        _encoding("LDM T1", "11001bbbllllllll", _not_base, base="b", register_list="l"),
        _encoding(
            "LDM.W IA", "1110100010w1bbbb 00llllllllllllll", _several_not_base, base="b", register_list="l"
        ),
        _encoding(
            "LDM.W DB", "1110100100w1bbbb 00llllllllllllll", _several_not_base, base="b", register_list="l"
        ),
        _encoding("STM.W IA", "1110100010w0bbbb 0l0lllllllllllll", _several_stored_not_base, base="b"),
        _encoding("STM.W DB", "1110100100w0bbbb 0l0lllllllllllll", _several_stored_not_base, base="b"),
        _encoding("LDRD imm", "11101001u1w1bbbb ttttyyyyiiiiiiii", _two_loaded, base="b", writes="ty"),
        _encoding("LDRD post", "11101000u111bbbb ttttyyyyiiiiiiii", _two_loaded, base="b", writes="ty"),
        _encoding("STRD imm", "11101001u1w0bbbb ttttyyyyiiiiiiii", _two_stored, base="b"),
        _encoding("STRD post", "11101000u110bbbb ttttyyyyiiiiiiii", _two_stored, base="b"),
        _encoding("LDR.W lit", "11111000u1011111 ttttiiiiiiiiiiii", _not_sp_or_pc("t"), writes="t"),
        _encoding("LDRB lit", "11111000u0011111 ttttiiiiiiiiiiii", _not_sp_or_pc("t"), writes="t"),
        _encoding("LDRSH lit", "11111001u0111111 ttttiiiiiiiiiiii", _not_sp_or_pc("t"), writes="t"),
    ]
    for name, sign, size, load in (
        ("STRB", 0, "00", 0),
        ("STRH", 0, "01", 0),
        ("STR", 0, "10", 0),
        ("LDRB", 0, "00", 1),
        ("LDRH", 0, "01", 1),
        ("LDR", 0, "10", 1),
        ("LDRSB", 1, "00", 1),
        ("LDRSH", 1, "01", 1),
    ):
        head = f"1111100{sign}"
        writes = "t" if load else ""
        table += [
            _encoding(
                f"{name}.W imm12",
                f"{head}1{size}{load}bbbb ttttiiiiiiiiiiii",
                _not_sp_or_pc("t", "b"),
                base="b",
                writes=writes,
            ),
            _encoding(
                f"{name}.W neg",
                f"{head}0{size}{load}bbbb tttt1100iiiiiiii",
                _not_sp_or_pc("t", "b"),
                base="b",
                writes=writes,
            ),
            _encoding(
                f"{name}.W pre",
                f"{head}0{size}{load}bbbb tttt11u1iiiiiiii",
                lambda f: _not_sp_or_pc("t", "b")(f) and f["t"] != f["b"] and f["i"] % 4 == 0,
                base="b",
                writes=writes,
            ),
            _encoding(
                f"{name}.W post",
                f"{head}0{size}{load}bbbb tttt10u1iiiiiiii",
                lambda f: _not_sp_or_pc("t", "b")(f) and f["t"] != f["b"] and f["i"] % 4 == 0,
                base="b",
                writes=writes,
            ),
            _encoding(
                f"{name}.W reg",
                f"{head}0{size}{load}bbbb tttt000000iixxxx",
                _not_sp_or_pc("t", "b", "x"),
                base="b",
                index="x",
                writes=writes,
            ),
            _encoding(
                f"{name}T",
                f"{head}0{size}{load}bbbb tttt1110iiiiiiii",
                _not_sp_or_pc("t", "b"),
                base="b",
                writes=writes,
            ),
        ]
    return table


def _branches() -> list[Encoding]:
    return [
        _encoding(
            "B cond", "1101cccciiiiiiii", lambda f: f["c"] < 14, fixed={"i": 0}, in_it=False, filler=True
        ),
        _encoding("B", "11100iiiiiiiiiii", fixed={"i": 0}, in_it=False, filler=True),
        _encoding("CBZ", "101100i1iiiiinnn", fixed={"i": 0}, in_it=False, filler=True),
        _encoding("CBNZ", "101110i1iiiiinnn", fixed={"i": 0}, in_it=False, filler=True),
        _encoding(
            "B.W cond",
            "111100cccciiiiii 10000iiiiiiiiiii",
            lambda f: f["c"] < 14,
            fixed={"i": 1},
            in_it=False,
            filler=True,
        ),
        _encoding("BL", "11110iiiiiiiiiii 11111iiiiiiiiiii", fixed={"i": 1}, in_it=False, filler=True),
        _encoding("MRS APSR", "1111001111101111 1000dddd00000000", _not_sp_or_pc("d"), writes="d"),
        _encoding("MSR APSR", "111100111000nnnn 1000100000000000", _not_sp_or_pc("n")),
        _encoding("NOP", "1011111100000000"),
        _encoding("NOP.W", "1111001110101111 1000000000000000"),
        _encoding("DSB", "1111001110111111 1000111101001111"),
        _encoding("PLD", "111110001001bbbb 1111iiiiiiiiiiii", _not_sp_or_pc("b"), base="b"),
    ]


ENCODINGS: tuple[Encoding, ...] = tuple(_data_processing() + _narrow() + _memory() + _branches())


@dataclass(frozen=True)
class Block:
    """A straight piece of random code."""

    # `code`: Machine code.
    # `count`: Instructions in it, those that a branch skips included.
    # `base`, `index`: Registers that must hold a RAM address and a small number when it starts.
    # `names`: Encoding of each instruction, for the message of a failed comparison.

    code: bytes
    count: int
    base: int
    index: int
    names: tuple[str, ...]


def _choose(rng: random.Random, base: int, index: int, in_it: bool) -> tuple[Encoding, bytes]:
    while True:
        encoding = rng.choice(ENCODINGS)
        if in_it and not encoding.in_it:
            continue
        fields = {c: rng.getrandbits(w) for c, w in encoding.widths.items()}
        fields |= encoding.fixed
        if encoding.base:
            fields[encoding.base] = base
        if encoding.index:
            fields[encoding.index] = index
        if any(fields[c] >> w for c, w in encoding.widths.items()):
            continue
        if not encoding.ok(fields):
            continue
        kept = (base, index, 13)
        if any(fields[c] in kept for c in encoding.writes):
            continue
        if encoding.register_list and any(fields[encoding.register_list] >> r & 1 for r in kept):
            continue
        return encoding, encoding.assemble(fields)


def random_block(rng: random.Random, length: int = 60) -> Block:
    """A block of about `length` random instructions."""
    base, index = rng.sample(
        [0, 1, 2, 3, 4, 5, 6, 7] if rng.random() < 0.6 else [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12], 2
    )
    code = bytearray()
    names: list[str] = []
    while len(names) < length:
        if rng.random() < 0.12:
            condition = rng.randrange(14)
            count = rng.randint(1, 4)
            pattern = [condition & 1] + [rng.getrandbits(1) for _ in range(count - 1)]
            mask = 0
            for position, bit in enumerate(pattern[1:]):
                mask |= bit << (3 - position)
            mask |= 1 << (4 - count)
            code += (0xBF00 | condition << 4 | mask).to_bytes(2, "little")
            names.append("IT")
            for _ in range(count):
                encoding, data = _choose(rng, base, index, in_it=True)
                code += data
                names.append(encoding.name)
            continue
        encoding, data = _choose(rng, base, index, in_it=False)
        code += data
        names.append(encoding.name)
        if encoding.filler:
            code += (0x3000 | rng.getrandbits(8)).to_bytes(2, "little") if base and index else b"\x00\xbf"
            names.append("filler")
    return Block(bytes(code), len(names), base, index, tuple(names))


FLASH, FLASH_SIZE = 0x0008_0000, 0x8_0000
RAM, RAM_SIZE = 0x2007_0000, 0x1_8000
FLAGS = 0xF800_0000
_CHUNK = 5000
_NAMES = [*(f"r{i}" for i in range(13)), "sp", "lr", "pc", "xpsr"]


class Oracle:
    """Both processors, with the same memory."""

    def __init__(self) -> None:
        unicorn = pytest.importorskip("unicorn", reason="unicorn is missing: pip install unicorn")
        self._arm: Any = pytest.importorskip("unicorn.arm_const")
        self.core = BareCore()
        self._uc: Any = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self._uc.ctl_set_cpu_model(self._arm.UC_CPU_ARM_CORTEX_M3)
        self._uc.mem_map(FLASH, FLASH_SIZE)
        self._uc.mem_map(RAM, RAM_SIZE)
        self._registers = [self._arm.UC_ARM_REG_R0 + i for i in range(13)]
        self._registers += [self._arm.UC_ARM_REG_SP, self._arm.UC_ARM_REG_LR]
        self._registers += [self._arm.UC_ARM_REG_PC, self._arm.UC_ARM_REG_CPSR]
        self._rows: list[tuple[int, ...]] = []
        self._most = 0
        self.compared = 0
        self._uc.hook_add(unicorn.UC_HOOK_CODE, self._before)

    def write(self, address: int, data: bytes) -> None:
        """Put the same bytes into both."""
        self._uc.mem_write(address, data)
        self.core.write(address, data)

    def forget_code(self) -> None:
        """Code that unicorn has translated was overwritten."""
        self._uc.ctl_flush_tb()

    def set_registers(self, values: list[int], flags: int) -> None:
        """r0 to r12, SP, LR and the flags of APSR."""
        for index, value in enumerate(values):
            self._uc.reg_write(self._registers[index], value)
            self.core.set_reg(index, value)
        self._uc.reg_write(self._registers[16], flags | 1 << 24)
        self.core.set_apsr(flags)

    def run(self, start: int, stop: int, most: int = 10**9) -> None:
        """Run both from ``start`` until PC is ``stop``, or until ``most`` instructions were compared."""
        self.core.set_reg(15, start)
        self._rows.clear()
        self._most = self.compared + most
        self._uc.emu_start(start | 1, stop)
        if self.compared < self._most:
            self._rows.append(self._uc.reg_read_batch(self._registers))
            self._compare(stop)

    def memory_is_equal(self) -> bool:
        """SRAM, byte by byte."""
        return self.core.read(RAM, RAM_SIZE) == bytes(self._uc.mem_read(RAM, RAM_SIZE))

    def _before(self, uc: Any, _address: int, _size: int, _data: Any) -> None:
        self._rows.append(uc.reg_read_batch(self._registers))
        if len(self._rows) > _CHUNK:
            self._compare(0xFFFF_FFFE)
            if self.compared >= self._most:
                uc.emu_stop()

    def _compare(self, stop: int) -> None:
        # unicorn has no row for an instruction that an IT block skips, and neither has the trace.
        wanted = np.array(self._rows, dtype=np.uint64).astype(np.uint32)
        traced: NDArray[np.uint32] = self.core.trace(stop, len(wanted) - 1)
        traced = traced[: len(wanted)].copy()
        assert len(traced) == len(wanted), "the two took different ways"
        wanted[:, 16] &= FLAGS
        traced[:, 16] &= FLAGS
        different = np.nonzero((wanted != traced).any(axis=1))[0]
        if len(different):
            self._explain(int(different[0]), wanted, traced)
        self.compared += len(wanted) - 1
        self._rows = self._rows[-1:]

    def _explain(self, row: int, wanted: NDArray[np.uint32], traced: NDArray[np.uint32]) -> None:
        at = int(wanted[max(row - 1, 0), 15])
        code = bytes(self._uc.mem_read(at, 4)).hex()
        lines = [
            f"{name}: {int(traced[row, i]):#010x}, unicorn has {int(wanted[row, i]):#010x}"
            for i, name in enumerate(_NAMES)
            if traced[row, i] != wanted[row, i]
        ]
        pytest.fail(f"after {self.compared + row} instructions, behind {code} at {at:#x}: {'; '.join(lines)}")
