"""GDB remote serial protocol over TCP: registers, memory, breakpoints, step and continue.

``arm-none-eabi-gdb program.elf -ex "target remote :3333"``. Board time and the watchdog stop while the
debugger holds the program.
"""

from __future__ import annotations

import select
import socket
from collections.abc import Callable
from typing import TYPE_CHECKING

from due_emulator.errors import GdbError
from due_emulator.image import Image

if TYPE_CHECKING:
    from due_emulator._due import Due

_SIGINT = "S02"
_SIGTRAP = "S05"
_SIGSEGV = "S0b"

_SLICE_US = 1000.0
_XPSR = 16
# What GDB calls the registers and their numbers in the packets.
_TARGET = (
    '<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd"><target version="1.0">'
    "<architecture>arm</architecture>"
    '<feature name="org.gnu.gdb.arm.m-profile">'
    + "".join(f'<reg name="r{i}" bitsize="32"/>' for i in range(13))
    + '<reg name="sp" bitsize="32" type="data_ptr"/><reg name="lr" bitsize="32"/>'
    '<reg name="pc" bitsize="32" type="code_ptr"/><reg name="xpsr" bitsize="32"/>'
    "</feature></target>"
)
_MEMORY = (
    '<?xml version="1.0"?><memory-map>'
    '<memory type="flash" start="0x80000" length="0x80000">'
    '<property name="blocksize">0x100</property></memory>'
    '<memory type="ram" start="0x20000000" length="0x100000"/>'
    '<memory type="ram" start="0x40000000" length="0x100000"/>'
    '<memory type="ram" start="0xe0000000" length="0x100000"/></memory-map>'
)


def packet(text: str) -> bytes:
    """Frame a reply, ``$text#checksum``, around `text` without ``$`` and ``#``."""
    return f"${text}#{sum(text.encode('latin-1')) & 0xFF:02x}".encode("latin-1")


class GdbServer:
    """Answers one debugger of a board, `due`, that is powered on."""

    def __init__(self, due: Due, image: Image) -> None:
        self._due = due
        self._image = image
        self._interrupted: Callable[[], bool] = lambda: False
        self._last_stop = _SIGTRAP

    def serve(self, port: int) -> None:
        """Wait for a debugger on a TCP `port` of localhost and answer it until it leaves; a GdbError when it
        cannot be opened.
        """
        try:
            listener = socket.create_server(("127.0.0.1", port))
        except OSError as error:
            raise GdbError(
                f"cannot listen on 127.0.0.1:{port}: {error.strerror}", "give --gdb another port above 1023"
            ) from error
        with listener:
            print(
                f"waiting: arm-none-eabi-gdb {self._image.path} "
                f"-ex 'target remote :{listener.getsockname()[1]}'",
                flush=True,
            )
            connection, _ = listener.accept()
            with connection:
                self._talk(connection)

    def _talk(self, connection: socket.socket) -> None:
        """Answer the packets of a debugger, each `$text#` and two digits of a checksum, until it leaves."""
        buffer = b""
        # While the program runs, any byte of the debugger interrupts it.
        self._interrupted = lambda: bool(select.select([connection], [], [], 0)[0])
        while True:
            start = buffer.find(b"$")
            end = buffer.find(b"#", start)
            is_complete = start >= 0 and end >= 0 and len(buffer) >= end + 3
            if not is_complete:
                # Ctrl-C comes as a single byte between packets.
                if b"\x03" in buffer[: start if start >= 0 else None]:
                    buffer = buffer.replace(b"\x03", b"", 1)
                    connection.sendall(packet(_SIGINT))
                    continue
                data = connection.recv(4096)
                if not data:
                    return
                buffer += data
                continue
            text = buffer[start + 1 : end].decode("latin-1")
            buffer = buffer[end + 3 :]
            connection.sendall(b"+")
            if text.startswith(("k", "D")):  # kill, which has no reply, or detach
                if text.startswith("D"):
                    connection.sendall(packet("OK"))
                return
            connection.sendall(packet(self.answer(text)))

    def answer(self, text: str) -> str:
        """The reply to the `text` of one packet; empty for one that is not supported."""
        kind, arguments = text[:1], text[1:]
        simple: dict[str, Callable[[str], str]] = {
            "?": lambda _: self._last_stop,
            "g": lambda _: self._read_registers(),
            "G": self._write_registers,
            "p": lambda r: self._read_register(int(r, 16)),
            "P": self._write_register,
            "m": self._read_memory,
            "M": self._write_memory,
            "Z": lambda r: self._breakpoint(r, insert=True),
            "z": lambda r: self._breakpoint(r, insert=False),
            "s": lambda _: self._step(),
            "c": lambda _: self._continue(),
            "H": lambda _: "OK",
            "T": lambda _: "OK",
        }
        if kind == "q":
            return self._query(arguments)
        if kind in simple:
            try:
                return simple[kind](arguments)
            except (ValueError, IndexError):
                return "E01"
        return ""

    def _query(self, arguments: str) -> str:
        if arguments.startswith("Supported"):
            return "PacketSize=4000;qXfer:features:read+;qXfer:memory-map:read+"
        if arguments.startswith("Xfer:features:read:target.xml:"):
            return self._part(_TARGET, arguments)
        if arguments.startswith("Xfer:memory-map:read::"):
            return self._part(_MEMORY, arguments)
        return {"Attached": "1", "fThreadInfo": "m1", "sThreadInfo": "l", "C": "QC1"}.get(arguments, "")

    @staticmethod
    def _part(text: str, arguments: str) -> str:
        offset, length = (int(value, 16) for value in arguments.rsplit(":", 1)[1].split(","))
        piece = text[offset : offset + length]
        return ("l" if offset + length >= len(text) else "m") + piece

    def _read_register(self, index: int) -> str:
        if index > _XPSR:
            return "E00"
        value = self._due.xpsr if index == _XPSR else self._due.reg(index)
        return value.to_bytes(4, "little").hex()

    def _read_registers(self) -> str:
        return "".join(self._read_register(i) for i in range(_XPSR + 1))

    def _set(self, index: int, value: int) -> None:
        if index == _XPSR:
            self._due.xpsr = value
        elif index < _XPSR:
            self._due.set_reg(index, value)
        else:
            raise IndexError(index)

    def _write_register(self, arguments: str) -> str:
        index, value = arguments.split("=")
        self._set(int(index, 16), int.from_bytes(bytes.fromhex(value), "little"))
        return "OK"

    def _write_registers(self, arguments: str) -> str:
        data = bytes.fromhex(arguments)
        for index in range(min(len(data) // 4, _XPSR + 1)):
            self._set(index, int.from_bytes(data[4 * index : 4 * index + 4], "little"))
        return "OK"

    def _read_memory(self, arguments: str) -> str:
        address, size = (int(value, 16) for value in arguments.split(","))
        return self._due.peek(address, size).hex()

    def _write_memory(self, arguments: str) -> str:
        where, data = arguments.split(":")
        self._due.poke(int(where.split(",")[0], 16), bytes.fromhex(data))
        return "OK"

    def _breakpoint(self, arguments: str, *, insert: bool) -> str:
        kind, address = arguments.split(",")[:2]
        if kind not in ("0", "1"):
            return ""
        if insert:
            self._due.add_breakpoint(int(address, 16))
        else:
            self._due.remove_breakpoint(int(address, 16))
        return "OK"

    def _stopped(self, signal: str) -> str:
        self._last_stop = signal
        return signal

    def _step(self) -> str:
        from due_emulator._due import Stop

        self._due.resume()
        try:
            self._due.step()
        except Stop as stop:
            return self._tell(stop)
        return self._stopped(_SIGSEGV if self._due.halt in ("hardfault", "lockup") else _SIGTRAP)

    def _continue(self) -> str:
        from due_emulator._due import Stop

        self._due.resume()
        try:
            while not self._due.halt:
                self._due.run_us(_SLICE_US)
                if self._interrupted():
                    return self._stopped(_SIGINT)
        except Stop as stop:
            return self._tell(stop)
        return self._stopped(_SIGTRAP if self._due.halt == "breakpoint" else _SIGSEGV)

    def _tell(self, stop: Exception) -> str:
        print(f"stopped: {stop}", flush=True)
        return self._stopped(_SIGSEGV)
