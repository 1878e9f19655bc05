"""Size, stack and calls of a linked firmware, read from its machine code and compared with their bounds.

Command line: ``python firmware/due/report.py ELF [--output FILE] [--cross PREFIX]``. Prints the report; ends
with 1 when a bound does not hold.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

# The program's bank holds 256 KiB. The shipped image takes 62 KiB, your own compiled controller about 4.
# Below 70 KiB such a controller would not build; a larger bound would hide a library linked by mistake.
FLASH_MAX_BYTES = 96 * 1024
RAM_MAX_BYTES = 28 * 1024
FLASH_START = 0x00080000
VECTORS = 16 + 45

# Eight words, and one that aligns the stack.
EXCEPTION_FRAME_BYTES = 36
ENTRY = "reset_handler"
# From the least to the most urgent: each may interrupt all before it.
INTERRUPTS = ("tick_interrupt", "encoder_interrupt")

HEAP = re.compile(
    r"^_?(malloc|calloc|realloc|free|sbrk)(_r)?$|^_Zn[wa]|^_Zd[la]|^__libc_(init|fini)_array$|^_exit$"
)
# Too slow for the tick: soft-float division, anything in double, integer division by a routine.
SLOW = re.compile(
    r"^__aeabi_(fdiv|d(add|sub|rsub|mul|div|cmp.*)|[uil]*div(mod)?|[fuil]+2d|d2.*)$|^(exp|log|pow|sqrt|sin|cos)f?$"
)

_FUNCTION = re.compile(r"^([0-9a-f]+) <(.+)>:$")
_INSTRUCTION = re.compile(r"^\s*([0-9a-f]+):\s+(\S+)(?:\s+(.*))?$")
_TARGET = re.compile(r"\b([0-9a-f]+) <([^>+]+)(?:\+0x[0-9a-f]+)?>")
_REGISTER = re.compile(r"\b(r\d+|sb|sl|fp|ip|lr)\b")
_LOAD = re.compile(r"^(\w+), \[(\w+)(?:, #(\d+))?\]$")
_VIRTUAL_TABLE = "_ZTV"
# In the mangled list of parameters; see firmware/core/control/controller.hpp.
_TAKES_IDLE_LOOP = re.compile("8IdleLoop")
# The first two words of a virtual table are not functions: an offset, and a pointer to type information.
_TABLE_HEAD_WORDS = 2
_BRANCH = re.compile(r"^(bl|b|cbn?z|b(eq|ne|cs|cc|mi|pl|vs|vc|hi|ls|ge|lt|gt|le|hs|lo))(\.[nw])?$")


class ReportError(Exception):
    """The firmware cannot be judged; the message says why."""


@dataclass(frozen=True)
class Function:
    """One function of the machine code."""

    name: str  # Linker symbol
    calls: frozenset[str]  # Functions that it calls or jumps to by name
    # Calls through a pointer: the byte offset of a virtual call's function in its table, None for a
    # pointer from elsewhere
    slots: frozenset[int | None]
    stack_bytes: int  # Upper bound of the stack that the function takes, without the functions that it calls


class CallChain(NamedTuple):
    """Functions that call each other, from the outermost on, and the stack that all take together."""

    stack_bytes: int
    functions: list[str]


@dataclass(frozen=True)
class Image:
    """Sizes, symbols, call graph and vectors of a linked firmware."""

    flash_bytes: int  # Sizes; `ram_bytes` includes the reserved stack
    ram_bytes: int  # Sizes; `ram_bytes` includes the reserved stack
    stack_reserved_bytes: int  # Stack that the linker script sets aside
    symbols: dict[str, int]  # Addresses of all symbols
    functions: dict[str, Function]  # The call graph
    # Functions whose address is stored outside the vectors and the virtual tables: any call through a
    # pointer may reach them
    pointed_at: frozenset[str]
    # Functions in the virtual tables, by their byte offset there: a virtual call may reach them too
    virtual: Mapping[int, frozenset[str]]
    vectors: tuple[int, ...]  # The vector table of the linked image

    def callees(self, name: str, idle_loop: bool = True) -> frozenset[str]:
        """Return the functions that one function may call.

        If no `idle_loop` runs the caller, no virtual call reaches a function that takes an `IdleLoop`: only
        the core's idle loop can construct one.
        """
        function = self.functions[name]
        called = function.calls
        for slot in function.slots:
            tables = self.virtual.values() if slot is None else [self.virtual.get(slot, frozenset())]
            virtual = frozenset[str]().union(*tables)
            if not idle_loop:
                virtual = frozenset(function for function in virtual if not _TAKES_IDLE_LOOP.search(function))
            called = called.union(self.pointed_at, virtual)
        return called

    def reachable(self, name: str, idle_loop: bool = True) -> frozenset[str]:
        """Return all functions that a function may call, directly or through others."""
        reached: set[str] = set()
        to_visit = [name]
        while to_visit:
            caller = to_visit.pop()
            if caller not in reached:
                reached.add(caller)
                to_visit.extend(self.callees(caller, idle_loop))
        return frozenset(reached)

    def deepest(self, name: str, idle_loop: bool = True) -> CallChain:
        """Return the call chain from a function that takes the most stack."""
        measured: dict[str, CallChain] = {}

        def measure(caller: str, above: tuple[str, ...]) -> CallChain:
            if caller in above:
                raise ReportError(f"the stack has no bound: {caller} may call itself by {' > '.join(above)}")
            if caller not in measured:
                below = [measure(callee, (*above, caller)) for callee in self.callees(caller, idle_loop)]
                deepest_below = max(below, default=CallChain(0, []), key=lambda chain: chain.stack_bytes)
                stack_bytes = self.functions[caller].stack_bytes + deepest_below.stack_bytes
                measured[caller] = CallChain(stack_bytes, [caller, *deepest_below.functions])
            return measured[caller]

        return measure(name, ())

    def stack_needed_bytes(self) -> int:
        """Return the most stack that the idle loop and all interrupts, nested, may take."""
        return self.deepest(ENTRY).stack_bytes + sum(
            EXCEPTION_FRAME_BYTES + self.deepest(name, idle_loop=False).stack_bytes for name in INTERRUPTS
        )


def _run(cross: str, tool: str, *arguments: str | Path) -> str:
    """Run a binary tool of the cross-compiler, and return its output."""
    try:
        process = subprocess.run([cross + tool, *arguments], capture_output=True, text=True, check=True)
    except FileNotFoundError:
        raise ReportError(
            f"{cross}{tool} is not installed: on Debian, apt-get install gcc-arm-none-eabi"
        ) from None
    except subprocess.CalledProcessError as error:
        raise ReportError(f"{cross}{tool}: {error.stderr.strip()}") from None
    return process.stdout


def _pushed_bytes(mnemonic: str, operands: str) -> int:
    """Return by how many bytes an instruction moves the stack pointer down."""
    if mnemonic == "push" or (mnemonic.startswith("stmdb") and operands.startswith("sp!")):
        registers = operands[operands.index("{") + 1 : operands.index("}")].split(",")
        total = 0
        for item in registers:
            first, _, last = item.strip().partition("-")
            total += 4 * (int(last[1:]) - int(first[1:]) + 1 if last else 1)
        return total
    if mnemonic.startswith("sub") and operands.startswith("sp, "):
        immediate = re.search(r"#(\d+)", operands)
        if immediate is None:
            raise ReportError(f"the stack has no bound: {mnemonic} {operands}")
        return int(immediate[1])
    pre_indexed = re.search(r"\[sp, #-(\d+)\]!", operands)
    return int(pre_indexed[1]) if pre_indexed else 0


def _goes_to_pointer(mnemonic: str, operands: str) -> bool:
    """Return whether an instruction jumps to an address in a register or in memory."""
    if mnemonic.startswith(("blx", "bx")):
        return mnemonic.startswith("blx") or operands != "lr"
    return mnemonic.startswith(("ldr", "mov")) and operands.startswith("pc,") and "[sp]" not in operands


class Instruction(NamedTuple):
    """A line of the disassembly."""

    address: int
    mnemonic: str
    operands: str


class _Symbol(NamedTuple):
    name: str
    kind: str  # A letter, as nm prints it
    address: int
    size: int  # 0 where nm gives none


def _slots(body: list[Instruction]) -> frozenset[int | None]:
    """Return how a function calls through pointers; see `Function.slots`.

    A virtual call loads the object's first word, then a word of the table that it points to. The content
    of a register is known only until something else may have changed it: up to a call, a label or any other
    use of the register.
    """
    targets = {
        int(target[1], 16)
        for _, mnemonic, operands in body
        if _BRANCH.match(mnemonic) and (target := _TARGET.search(operands))
    }
    # A table of branches jumps to labels that are not read here.
    hidden_labels = any(mnemonic.startswith(("tbb", "tbh")) for _, mnemonic, _ in body)
    slots: set[int | None] = set()
    # Registers that hold the address of a table, and those that hold a word of one, with its place.
    tables: set[str] = set()
    functions: dict[str, int] = {}
    for address, mnemonic, operands in body:
        if address in targets:
            tables, functions = set(), {}  # other paths reach this label with other content
        if _goes_to_pointer(mnemonic, operands):
            slots.add(None if hidden_labels else functions.get(operands))
        load = _LOAD.match(operands) if mnemonic in ("ldr", "ldr.w") else None
        slot = int(load[3] or 0) if load and load[2] in tables else None
        # A call, or an instruction with a list of registers.
        if mnemonic.startswith("bl") or "{" in operands:
            tables, functions = set(), {}
        for register in _REGISTER.findall(operands):
            tables.discard(register)
            functions.pop(register, None)
        if load and slot is not None:
            functions[load[1]] = slot
        if load and not int(load[3] or 0):
            tables.add(load[1])
    return frozenset(slots)


def _function(name: str, body: list[Instruction]) -> tuple[Function, set[int]]:
    """Return a function, and the constants in its code that may be addresses."""
    calls: set[str] = set()
    constants: set[int] = set()
    lower: dict[str, int] = {}
    stack_bytes = 0
    for _, mnemonic, operands in body:
        stack_bytes += _pushed_bytes(mnemonic, operands)
        if _BRANCH.match(mnemonic):
            target = _TARGET.search(operands)
            if target and target[2] != name:
                calls.add(target[2])
        elif mnemonic == ".word":
            constants.add(int(operands.split()[0], 16))
        elif mnemonic in ("movw", "movt"):
            register, _, value = operands.partition(", #")
            half = int(value.split()[0])
            if mnemonic == "movw":
                lower[register] = half
            else:
                constants.add(half << 16 | lower.get(register, 0))
    return Function(name, frozenset(calls), _slots(body), stack_bytes), constants


def _disassembled(text: str) -> Iterable[tuple[str, list[Instruction]]]:
    """Yield each function's name with its instructions."""
    name = ""
    body: list[Instruction] = []
    for line in text.splitlines():
        if head := _FUNCTION.match(line):
            yield name, body
            name, body = head[2], []
        elif instruction := _INSTRUCTION.match(line):
            operands = re.split(r"\s*[;@]\s", instruction[3] or "")[0].strip()
            body.append(Instruction(int(instruction[1], 16), instruction[2], operands))
    yield name, body


def _symbols(elf: Path, cross: str) -> Iterable[_Symbol]:
    for line in _run(cross, "nm", "-S", elf).splitlines():
        words = line.split()
        if len(words) in (3, 4) and not words[-1].startswith("$"):
            yield _Symbol(
                name=words[-1],
                kind=words[-2],
                address=int(words[0], 16),
                size=int(words[1], 16) if len(words) == 4 else 0,
            )


def _section_sizes(elf: Path, cross: str) -> dict[str, int]:
    """Read the size in bytes of each section."""
    return {
        fields[1]: int(fields[2], 16)
        for line in _run(cross, "objdump", "-h", "-w", elf).splitlines()
        if len(fields := line.split()) > 6 and fields[0].isdigit()
    }


def _flash_content(elf: Path, cross: str) -> bytes:
    """Return the bytes that are written to flash."""
    with tempfile.TemporaryDirectory() as folder:
        flat = Path(folder) / "image.bin"
        _run(cross, "objcopy", "-O", "binary", elf, flat)
        return flat.read_bytes()


def read_image(elf: Path, cross: str = "arm-none-eabi-") -> Image:
    """Read sizes, call graph and vectors from a linked firmware."""
    section_sizes = _section_sizes(elf, cross)
    symbols = {}
    code_at: dict[int, str] = {}
    table_words: dict[str, range] = {}
    for name, kind, address, size in _symbols(elf, cross):
        symbols[name] = address
        if kind in "tTwW":  # functions, of which weak ones have the letter w; a Thumb address is odd
            code_at.setdefault(address & ~1, name)
        if name.startswith(_VIRTUAL_TABLE) and size:
            first = (address - FLASH_START) // 4
            table_words[name] = range(first + _TABLE_HEAD_WORDS, first + size // 4)

    functions = {}
    constants: set[int] = set()
    for name, body in _disassembled(_run(cross, "objdump", "-d", "--no-show-raw-insn", elf)):
        if name:
            functions[name], new_constants = _function(name, body)
            constants |= new_constants
    # One function may have several names; the disassembly shows one, calls may use another.
    by_address = {symbols[name]: name for name in functions if name in symbols}
    functions = {
        name: replace(
            function,
            calls=frozenset(by_address.get(symbols.get(callee, -1), callee) for callee in function.calls)
            - {name},
        )
        for name, function in functions.items()
    }

    flash = _flash_content(elf, cross)
    words = [int.from_bytes(flash[at : at + 4], "little") for at in range(0, len(flash) - 3, 4)]
    in_tables = {index for indices in table_words.values() for index in indices}
    constants |= {word for index, word in enumerate(words) if index >= VECTORS and index not in in_tables}
    # The address of a function in a constant has its lowest bit set, which marks Thumb code.
    pointed_at = frozenset(
        name
        for name, address in symbols.items()
        if address | 1 in constants and name in functions and address & ~1 in code_at
    )
    virtual: dict[int, set[str]] = {}
    for indices in table_words.values():
        for slot, index in enumerate(indices):
            virtual.setdefault(4 * slot, set()).add(by_address[words[index] & ~1])
    return Image(
        flash_bytes=len(flash),
        ram_bytes=sum(section_sizes.get(section, 0) for section in (".stack", ".data", ".bss")),
        stack_reserved_bytes=section_sizes.get(".stack", 0),
        symbols=symbols,
        functions=functions,
        pointed_at=pointed_at,
        virtual={slot: frozenset(names) for slot, names in virtual.items()},
        vectors=tuple(words[:VECTORS]),
    )


def findings(image: Image) -> list[str]:
    """List the bounds that a firmware exceeds."""
    problems = []
    if image.flash_bytes > FLASH_MAX_BYTES:
        problems.append(f"flash: {image.flash_bytes} bytes are more than {FLASH_MAX_BYTES}")
    if image.ram_bytes > RAM_MAX_BYTES:
        problems.append(f"RAM: {image.ram_bytes} bytes are more than {RAM_MAX_BYTES}")
    needed = image.stack_needed_bytes()
    if needed > image.stack_reserved_bytes:
        problems.append(f"stack: {needed} bytes may be needed, due.ld reserves {image.stack_reserved_bytes}")
    problems += [f"heap: {name} is linked" for name in sorted(image.symbols) if HEAP.match(name)]
    for interrupt in INTERRUPTS:
        slow = sorted(name for name in image.reachable(interrupt, idle_loop=False) if SLOW.match(name))
        problems += [f"time: {interrupt} may reach {name}" for name in slow]
    return problems


def report(image: Image, cross: str = "arm-none-eabi-") -> str:
    """Write the sizes and the deepest call chains as text."""
    lines = [
        f"flash {image.flash_bytes:6d} of {FLASH_MAX_BYTES} bytes",
        f"RAM   {image.ram_bytes:6d} of {RAM_MAX_BYTES} bytes, with the stack",
        f"stack {image.stack_needed_bytes():6d} of {image.stack_reserved_bytes} bytes, with all interrupts",
    ]
    for name in (ENTRY, *INTERRUPTS):
        stack_bytes, chain = image.deepest(name, idle_loop=name not in INTERRUPTS)
        readable = _run(cross, "c++filt", "-p", *chain).replace("(anonymous namespace)::", "").split("\n")
        lines.append(f"  {stack_bytes:4d} {' > '.join(readable[:-1])}")
    return "\n".join(lines) + "\n"


def main() -> int:
    """Judge one firmware from the command line."""
    parser = argparse.ArgumentParser(description="Size, stack and calls of a firmware, against their bounds.")
    parser.add_argument("elf", type=Path)
    parser.add_argument("--output", type=Path, help="file to write the report to as well")
    parser.add_argument("--cross", default="arm-none-eabi-", help="prefix of the binary tools")
    options = parser.parse_args()
    try:
        image = read_image(options.elf, options.cross)
        text = report(image, options.cross)
        exceeded = findings(image)
    except ReportError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    print(text, end="")
    for line in exceeded:
        print(f"error: {line}", file=sys.stderr)
    if options.output and not exceeded:
        options.output.write_text(text)
    return 1 if exceeded else 0


if __name__ == "__main__":
    sys.exit(main())
