"""The loader in the Due's ROM (SAM-BA), over a pseudo-terminal, in front of an emulated chip.

Written after the datasheet's chapter on SAM-BA. Commands act on the emulated chip's registers and memory, so
that flash is programmed as its controller does it. The small programs that an uploader sends run on unicorn,
whose loads and stores of flash are the emulated chip's.
"""

from __future__ import annotations

import binascii
import os
import re
import select
import struct
import threading
import tty
from typing import Any, Final

import pytest
from due_emulator import Due

VERSION: Final = b"v1.1 Dec 15 2010 19:25:04\n\r"
RAM, RAM_SIZE = 0x2000_0000, 0x1_0000
FLASH, FLASH_SIZE = 0x0008_0000, 0x8_0000
RSTC_CR: Final = 0x400E_1A00
BLOCK: Final = 128
SOH, EOT, ACK, START = b"\x01", b"\x04", b"\x06", b"C"
# Where a program that was started returns to.
RETURN: Final = RAM + RAM_SIZE - 4
_COMMAND = re.compile(rb"([A-Za-z])([0-9A-Fa-f]*)(?:,([0-9A-Fa-f]*))?#")


# Addresses that an uploader reads to identify chips, and that the strict emulated chip does not have. They
# are the ROM's vector at 0, which is no branch as on an ARM7, and the places where other chips have their
# identity.
ELSEWHERE: Final = {0: 0x2000_1000, 0x400E_0740: 0}


class RomLoader:
    """Answers one uploader, in a thread of its own; a context manager."""

    def __init__(self, due: Due) -> None:
        self._due = due
        self._ours, self._theirs = os.openpty()
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)
        self._waiting = bytearray()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        unicorn: Any = pytest.importorskip("unicorn", reason="unicorn is missing: pip install unicorn")
        self._names: Any = pytest.importorskip("unicorn.arm_const")
        self._core = self._processor(unicorn)
        self.problem: Exception | None = None

    def __enter__(self) -> RomLoader:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()
        os.close(self._ours)
        os.close(self._theirs)
        if self.problem is not None:
            raise self.problem

    def _serve(self) -> None:
        try:
            # The last command of the uploader before it ended is still obeyed.
            while not self._ended.is_set() or self._receive():
                self._receive()
                while (command := _COMMAND.search(bytes(self._waiting))) is not None:
                    del self._waiting[: command.end()]
                    self._due.run_us(20.0)
                    self._obey(command[1], _hex(command[2]), _hex(command[3]))
        except Exception as problem:  # noqa: BLE001 - it is raised where the block ends
            self.problem = problem

    def _receive(self) -> bool:
        """Take what has come, waiting a moment for it; whether anything had."""
        if not select.select([self._ours], [], [], 0.01)[0]:
            return False
        self._waiting += os.read(self._ours, 4096)
        return True

    def _take(self, count: int) -> bytes:
        while len(self._waiting) < count and not self._ended.is_set():
            self._receive()
        data = bytes(self._waiting[:count])
        del self._waiting[:count]
        return data

    def _say(self, data: bytes) -> None:
        os.write(self._ours, data)

    def _obey(self, command: bytes, address: int, value: int) -> None:
        due = self._due
        if command == b"N":
            self._say(b"\n\r")
        elif command == b"V":
            self._say(VERSION)
        elif command == b"w":
            self._say(struct.pack("<I", self._word(address)))
        elif command == b"W":
            due.write_word(address, value)
        elif command == b"S":
            due.poke(address, self._xmodem_in(value))
        elif command == b"R":
            self._xmodem_out(due.peek(address, value))
        elif command == b"G":
            self._run(address)
        else:
            raise AssertionError(f"the loader knows no command {command!r}")

    def _word(self, address: int) -> int:
        return ELSEWHERE[address] if address in ELSEWHERE else self._due.read_word(address)

    def _xmodem_in(self, size: int) -> bytes:
        received = b""
        self._say(START)
        while (head := self._take(1)) == SOH:
            number, inverse, *_ = self._take(2)
            data, check = self._take(BLOCK), self._take(2)
            assert number ^ inverse == 0xFF
            assert binascii.crc_hqx(data, 0) == int.from_bytes(check, "big")
            received += data
            self._say(ACK)
        assert head == EOT, head
        self._say(ACK)
        return received[:size]

    def _xmodem_out(self, data: bytes) -> None:
        assert self._take(1) == START
        for at in range(0, len(data), BLOCK):
            block = data[at : at + BLOCK].ljust(BLOCK, b"\0")
            number = (at // BLOCK + 1) & 0xFF
            check = binascii.crc_hqx(block, 0).to_bytes(2, "big")
            self._say(SOH + bytes((number, 0xFF - number)) + block + check)
            assert self._take(1) == ACK
        self._say(EOT)
        assert self._take(1) == ACK

    def _run(self, address: int) -> None:
        """Start a program by its own vectors, as the ROM does, and wait until it returns."""
        stack, entry = struct.unpack("<II", self._due.peek(address, 8))
        core = self._core
        core.mem_write(RAM, self._due.peek(RAM, RAM_SIZE))
        core.reg_write(self._names.UC_ARM_REG_SP, stack)
        core.reg_write(self._names.UC_ARM_REG_LR, RETURN | 1)
        core.emu_start(entry | 1, RETURN, count=1_000_000)
        self._due.poke(RAM, bytes(core.mem_read(RAM, RAM_SIZE)))

    def _processor(self, uc: Any) -> Any:
        """A processor whose loads and stores of flash are the emulated chip's."""
        core: Any = uc.Uc(uc.UC_ARCH_ARM, uc.UC_MODE_THUMB | uc.UC_MODE_MCLASS)
        core.mem_map(RAM, RAM_SIZE)
        core.mem_map(FLASH, FLASH_SIZE)

        def load(_core: Any, _kind: int, at: int, size: int, _value: int, _data: Any) -> None:
            core.mem_write(at, self._due.peek(at, size))

        def store(_core: Any, _kind: int, at: int, size: int, value: int, _data: Any) -> None:
            assert size == 4
            self._due.write_word(at, value & 0xFFFF_FFFF)

        core.hook_add(uc.UC_HOOK_MEM_READ, load, begin=FLASH, end=FLASH + FLASH_SIZE - 1)
        core.hook_add(uc.UC_HOOK_MEM_WRITE, store, begin=FLASH, end=FLASH + FLASH_SIZE - 1)
        return core


def _hex(digits: bytes | None) -> int:
    return int(digits, 16) if digits else 0
