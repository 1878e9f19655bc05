"""Writes a firmware image into the Due: checks the image, erases the chip, and runs ``bossac``.

The verb ``heli-host flash`` runs the steps in order. No real board has been flashed with this code. It ran
with a replacement for ``bossac``; Debian's real one has written an emulated chip with the same options.

Before, the board's saved parameters are read, also if its firmware was built from another declaration of the
link. Framing, hello and welcome are the same in every version. The welcome states the hash of the board's
declaration, and a hello with that hash opens a session. Values carry no names. Therefore they are used only
if the board stored them under this host's schema of the parameters: only telemetry or messages may differ.
"""

from __future__ import annotations

import errno
import os
import re
import shutil
import struct
import subprocess
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import serial

from heli_host.board.parameters import shortest_decimal
from heli_host.declaration import (
    BAUD,
    LINK_HASH,
    PARAMS,
    PARAMS_HASH,
    HelloMessage,
    ParamsMessage,
    ParamsOriginMessage,
    ParamsOriginReadMessage,
    ParamsReadMessage,
    ParamsSource,
    WelcomeMessage,
)
from heli_host.errors import FlashError, HeliError, ImageError, UploaderError
from heli_host.link.engine import UNNUMBERED, Command, CommandSlot, RequestNumbers
from heli_host.link.frames import FrameParser, encode_frame

if TYPE_CHECKING:
    from heli_host.link.transport import Transport

# Memory of the SAM3X8E, as in firmware/due/due.ld.
FLASH_START = 0x0008_0000
_CODE_MAX_BYTES = 512 * 1024 - 512
RAM_START = 0x2007_0000
_RAM_END = 0x2008_8000
VECTORS = 16 + 45
ERASING_BAUD = 1200
# When a control line changes at this rate, the ATmega16U2 holds ERASE and then RESET for 180 rounds
# of 4.096 ms, 0.74 s (its published source). The loader in the chip needs a moment more.
ERASE_S = 1.2
# How long a lowered DTR is held, and how long a write to the chip's boot bit may take before the reset.
_PULSE_S = 0.05
_SETTLE_S = 0.1
# Reported to write and verify a Due that then does not start: BOSSA issue 125, platform-atmelsam issue 78.
# Not checked here, for want of a board.
_DOUBTFUL_FROM = (1, 8)
# 30 KiB at 115,200 baud take about 6 s, as 128-byte packets with an answer each perhaps three times that.
_WRITE_TIMEOUT_S = 180.0
GET_BOSSAC = (
    "get version 1.7.0 with pio pkg install -g -t 'platformio/tool-bossac@~1.10700.0', "
    "or an Arduino IDE with the Due's boards installed"
)

_BUILD = "build it with make firmware and give build/pio/due/firmware.bin"
_NO_CONTROL_LINES = (errno.ENOTTY, errno.EINVAL)
_READ_S: Final = 0.02
_NO_HASH: Final = 0
"""In the first hello: the board answers with its own hash, and opens no session."""
_STORED: Final = (ParamsSource.STORED, ParamsSource.FALLBACK, ParamsSource.MIGRATED)
_ASK_TIMEOUT_S = 10.0
_PACKAGES = (
    ".platformio/packages/tool-bossac*/bossac",
    ".arduino15/packages/arduino/tools/bossac/*/bossac",
    "Library/Arduino15/packages/arduino/tools/bossac/*/bossac",
    "AppData/Local/Arduino15/packages/arduino/tools/bossac/*/bossac.exe",
)


@dataclass(frozen=True)
class FirmwareImage:
    """A file at `path` that may be flashed; its `content` goes to the start of the flash."""

    path: Path
    content: bytes


def read_image(path: Path) -> FirmwareImage:
    """Read an image and check that the Due would start it and this host could talk to it."""
    content = path.read_bytes()
    if content.startswith(b"\x7fELF"):
        raise ImageError(
            f"{path} is an ELF file", f"give the .bin file next to it ({path.with_suffix('.bin')})"
        )
    if content.startswith(b":") and content[1:9].isalnum():
        raise ImageError(f"{path} is an Intel HEX file", _BUILD)
    if not VECTORS * 4 <= len(content) <= _CODE_MAX_BYTES:
        raise ImageError(
            f"{path} has {len(content)} bytes; an image for the Due has {VECTORS * 4} to {_CODE_MAX_BYTES}",
            _BUILD,
        )
    _check_vector_table(path, content)
    if struct.pack("<I", LINK_HASH) not in content:
        raise ImageError(
            f"{path} does not hold the hash of this host's link ({LINK_HASH:08x}): "
            "it is other firmware, or firmware of another release",
            f"{_BUILD}, or use the heli_host that belongs to it",
        )
    return FirmwareImage(path, content)


def _check_vector_table(path: Path, content: bytes) -> None:
    """Refuse what the processor could not start: its first two words are stack and entry."""
    stack, *handlers = struct.unpack_from(f"<{VECTORS}I", content)
    code = range(FLASH_START, FLASH_START + len(content))
    if not (RAM_START < stack <= _RAM_END and stack % 4 == 0):
        raise ImageError(f"{path} is not firmware for the Due: its stack is at {stack:#010x}", _BUILD)
    # Bit 0 of a vector says Thumb, which is all that this processor runs; 0 is a vector that is not used.
    if not (handlers[0] & 1 and handlers[0] - 1 in code):
        raise ImageError(
            f"{path} is not firmware for the Due: its entry point is at {handlers[0]:#010x}", _BUILD
        )
    for number, handler in enumerate(handlers[1:], 2):
        if handler and not (handler & 1 and handler - 1 in code):
            raise ImageError(
                f"{path} is damaged: interrupt vector {number} points to {handler:#010x}", _BUILD
            )


def erase_chip(port: str, wait_s: float = ERASE_S) -> None:
    """Erase all flash of the Due behind its programming port; the chip's own loader (SAM-BA) then answers."""
    try:
        with serial.Serial(port, ERASING_BAUD) as touched:
            _set_dtr(touched, high=False)
            time.sleep(wait_s)
            # The next program to open the port raises DTR before it sets its rate, so that a rate of 1200
            # baud, left from here, would erase the flash again.
            touched.baudrate = BAUD
    except (serial.SerialException, OSError, ValueError) as error:
        raise FlashError(
            f"{port} cannot be opened at {ERASING_BAUD} baud to erase the board: {error}",
            "close other programs that use it (heli-host doctor names ModemManager), then try again",
        ) from error


def restart_chip(port: str) -> None:
    """Reset the Due behind its programming `port`, by the rising edge of DTR that its USB bridge waits for; a
    FlashError when it cannot be opened.
    """
    time.sleep(_SETTLE_S)
    try:
        with serial.Serial(port, BAUD) as touched:
            _set_dtr(touched, high=False)
            time.sleep(_PULSE_S)
            _set_dtr(touched, high=True)
    except (serial.SerialException, OSError, ValueError) as error:
        raise FlashError(
            f"the flash was written, but {port} cannot be opened to restart the board: {error}",
            "press RESET on the board",
        ) from error


def _set_dtr(port: serial.Serial, high: bool) -> None:
    """Set the line DTR, if the port has one."""
    try:
        port.dtr = high
    except OSError as error:
        # A pseudo-terminal has no such line; the simulated board reads the rate instead.
        if error.errno not in _NO_CONTROL_LINES:
            raise


def saved_parameters(transport: Transport, timeout_s: float) -> dict[str, float]:
    """Read the saved parameters of a board that speaks another version of the link."""
    board = _Asker(transport, timeout_s)
    # The first hello asks for the hash of the board's link; a second one with that hash opens the session.
    welcome = WelcomeMessage.unpack(
        board.ask(HelloMessage(request=UNNUMBERED, link_hash=_NO_HASH, session=0))
    )
    if welcome.params_source not in _STORED:
        return {}  # the board runs on its defaults
    board.ask(HelloMessage(request=UNNUMBERED, link_hash=welcome.link_hash, session=0))
    origin = ParamsOriginMessage.unpack(
        board.ask(ParamsOriginReadMessage(UNNUMBERED), min_bytes=ParamsOriginMessage.STRUCT.size)
    )
    if origin.schema != PARAMS_HASH:
        raise _unreadable_error(
            f"it saved them under the schema {origin.schema:08x}, this host's is {PARAMS_HASH:08x}"
        )
    # Its firmware may have another list of parameters, whose order this host does not know.
    if origin.source == ParamsSource.MIGRATED:
        raise _unreadable_error(
            f"it saved them under this host's schema {PARAMS_HASH:08x}, but its firmware cannot use them all"
        )
    # Under the same schema, the parameters have the names and the order of this host's declaration.
    values: list[float] = []
    while len(values) < len(PARAMS):
        first = len(values)
        payload = board.ask(ParamsReadMessage(UNNUMBERED, first))
        head, values_at = ParamsMessage.unpack(payload), ParamsMessage.STRUCT.size
        singles = struct.Struct(f"<{head.count}f")
        if head.first != first or head.count == 0 or len(payload) != values_at + singles.size:
            raise _unreadable_error("its list of parameters has another layout")
        values += singles.unpack_from(payload, values_at)
    return {spec.name: shortest_decimal(value) for spec, value in zip(PARAMS, values, strict=True)}


class _Asker:
    """Sends requests to a board without a session, and waits for their answers; ignores other messages."""

    def __init__(self, transport: Transport, timeout_s: float) -> None:
        self._transport = transport
        self._timeout_s = timeout_s
        self._parser = FrameParser()
        self._slot = CommandSlot(RequestNumbers(0))

    def ask(self, command: Command, min_bytes: int = 0) -> bytes:
        """Send a request until it is answered; return the answer's payload, of at least `min_bytes`."""
        request = self._slot.ask(command, self._transport.now_s(), self._timeout_s)
        while not request.done:
            now_s = self._transport.now_s()
            if (due := self._slot.due(now_s)) is not None:
                self._transport.write(encode_frame(due.ID, due.request, due.pack()))
            for frame in self._parser.feed(self._transport.read(_READ_S)):
                self._slot.match(frame)
            self._slot.expire(now_s)
        try:
            payload = request.answer().payload
        except HeliError as error:
            raise _unreadable_error("it does not answer the request for them") from error
        if len(payload) < min_bytes:
            raise _unreadable_error("it answers the request for them in another layout")
        return payload


def _unreadable_error(reason: str) -> FlashError:
    """Return the error for saved parameters that this host cannot read."""
    return FlashError(
        f"the board has saved parameters that this host cannot read: {reason}",
        "save them with the board's own heli_host (params dump), or add --discard-parameters",
    )


@dataclass(frozen=True)
class Bossac:
    """An installed uploader."""

    path: str  # Path of the program
    version: str  # Version that the program reports, such as ``1.9.1``
    usb_option: tuple[str, ...]
    """Option by which this version accepts a port that is not a native USB port. Version 1.8 renamed the
    option and made its value optional; the value must then follow without a space."""

    @property
    def is_doubtful(self) -> bool:
        """Whether this version is reported to leave a Due that does not start."""
        numbers = tuple(int(number) for number in re.findall(r"\d+", self.version)[:2])
        return numbers >= _DOUBTFUL_FROM

    def arguments(self, port: str, image: Path) -> list[str]:
        """Command line that writes an `image` through the programming `port` and has the chip start from it;
        without ``--info``, which is reported to crash 1.6.1.
        """
        options = ("--erase", "--write", "--verify", "--boot=1")
        # 1.9.1 resets the chip right after the command that sets its boot bit, without waiting for the flash
        # (seen on an emulated chip). The reset comes from the USB bridge then, a moment later.
        reset = () if self.is_doubtful else ("--reset",)
        return [self.path, f"--port={_port_name(port)}", *self.usb_option, *options, *reset, str(image)]


def find_bossac(named: Path | None = None) -> Bossac:
    """Find the program bossac, which writes a Due's flash."""
    # It is searched on the path, then in the folders of PlatformIO and the Arduino IDE. The first version
    # that suits a Due is taken; otherwise the first one, which is `Bossac.is_doubtful`.
    if named is not None:
        return _version_and_options(str(named))
    doubtful = []
    for path in _candidate_paths():
        try:
            bossac = _version_and_options(path)
        except UploaderError:
            continue
        if not bossac.is_doubtful:
            return bossac
        doubtful.append(bossac)
    if not doubtful:
        raise UploaderError("bossac, which writes the Due's flash, is not installed", GET_BOSSAC)
    return doubtful[0]


def _candidate_paths() -> Iterable[str]:
    """Yield the paths at which bossac may be, the one on the search path first."""
    on_path = shutil.which("bossac")
    if on_path is not None:
        yield on_path
    for pattern in _PACKAGES:
        yield from (str(path) for path in sorted(Path.home().glob(pattern)))


def _version_and_options(path: str) -> Bossac:
    """Run a bossac with --help, and return it with its version and its USB option. An UploaderError reports a
    program that does not run, or is not bossac.
    """
    try:
        # Its --help ends with 1.
        process = subprocess.run(
            [path, "--help"], capture_output=True, text=True, timeout=_ASK_TIMEOUT_S, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        reason = error.strerror if isinstance(error, OSError) else "it does not answer"
        raise UploaderError(f"{path} does not run: {reason}", GET_BOSSAC) from error
    text = process.stdout + process.stderr
    version = re.search(r"\(BOSSA\) Version (\S+)", text)
    if version is None:
        raise UploaderError(f"{path} is not bossac, because it prints no version", GET_BOSSAC)
    usb_option: tuple[str, ...] = ()
    if "--usb-port" in text:
        usb_option = ("--usb-port=0",)
    elif "--force_usb_port" in text:
        usb_option = ("--force_usb_port=false",)
    return Bossac(path, version[1], usb_option)


def _port_name(port: str) -> str:
    """Name as every version takes it: the real device, on Unix without /dev/, which versions to 1.7 add."""
    return os.path.realpath(port).removeprefix("/dev/") if os.name == "posix" else port


def write_image(bossac: Bossac, port: str, image: Path, timeout_s: float = _WRITE_TIMEOUT_S) -> None:
    """Write an image into an erased chip, verify it, and have the chip start from flash from now on."""
    try:
        process = subprocess.run(
            bossac.arguments(port, image),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise FlashError(
            f"bossac {bossac.version} did not end within {timeout_s:g} s",
            "press RESET on the board, then flash again",
        ) from None
    except OSError as error:
        raise FlashError(f"{bossac.path} does not run: {error.strerror}", GET_BOSSAC) from error
    if process.returncode != 0:
        raise _error_from_output(bossac, port, process.returncode, process.stdout)


def _error_from_output(bossac: Bossac, port: str, code: int, output: str) -> FlashError:
    """Why bossac failed, from its output."""
    lines = [line.strip() for line in re.split(r"[\r\n]+", output) if line.strip()]
    last_line = lines[-1] if lines else "nothing"
    if "No device found" in output:
        return FlashError(
            f"the chip's loader does not answer on {port}: the chip is not erased, or another program uses "
            "the port",
            "press the board's ERASE button for a second, then RESET, and flash again; "
            "heli-host doctor checks whether ModemManager occupies the port",
        )
    if "Verify failed" in output:
        errors = re.search(r"Byte errors: *(\d+)", output)
        count = f"{errors[1]} bytes differ" if errors else "it differs"
        return FlashError(
            f"the flash does not hold what was written: {count}",
            "flash again over a short cable without a hub; if it fails again, the flash is worn: use another "
            "board",
        )
    # The versions of bossac reject an unknown option in different words.
    if "-h' or" in output or "extra arguments" in output or "Usage:" in output:
        return FlashError(
            f"bossac {bossac.version} does not know the options that heli-host gave it", GET_BOSSAC
        )
    if code < 0:  # as subprocess states a process that a signal ended
        return FlashError(f"bossac {bossac.version} crashed (signal {-code})", GET_BOSSAC)
    return FlashError(
        f"bossac {bossac.version} failed with code {code}: {last_line}",
        "check cable and power, press RESET, then flash again",
    )
