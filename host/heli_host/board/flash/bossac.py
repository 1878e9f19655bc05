"""The uploader bossac: its path, the options of its version, and the reasons for a failure."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from heli_host.errors import FlashError, UploaderError

# Reported to write and verify a Due that then does not start: BOSSA issue 125, platform-atmelsam issue 78.
# Not checked here, for want of a board.
DOUBTFUL_FROM = (1, 8)

# 30 KiB at 115,200 baud take about 6 s, as 128-byte packets with an answer each perhaps three times that.
WRITE_TIMEOUT_S = 180.0

GET_BOSSAC = (
    "get version 1.7.0 with pio pkg install -g -t 'platformio/tool-bossac@~1.10700.0', "
    "or an Arduino IDE with the Due's boards installed"
)

_ASK_TIMEOUT_S = 10.0
_PACKAGES = (
    ".platformio/packages/tool-bossac*/bossac",
    ".arduino15/packages/arduino/tools/bossac/*/bossac",
    "Library/Arduino15/packages/arduino/tools/bossac/*/bossac",
    "AppData/Local/Arduino15/packages/arduino/tools/bossac/*/bossac.exe",
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
    def doubtful(self) -> bool:
        """Whether this version is reported to leave a Due that does not start."""
        numbers = tuple(int(number) for number in re.findall(r"\d+", self.version)[:2])
        return numbers >= DOUBTFUL_FROM

    def arguments(self, port: str, image: Path) -> list[str]:
        """Command line that writes an `image` through the programming `port` and has the chip start from it;
        without ``--info``, which is reported to crash 1.6.1.
        """
        options = ("--erase", "--write", "--verify", "--boot=1")
        # 1.9.1 resets the chip right after the command that sets its boot bit, without waiting for the flash
        # (seen on an emulated chip). The reset comes from the USB bridge then, a moment later.
        reset = () if self.doubtful else ("--reset",)
        return [self.path, f"--port={_port_name(port)}", *self.usb_option, *options, *reset, str(image)]


def find_bossac(named: Path | None = None) -> Bossac:
    """Find the program bossac, which writes a Due's flash.

    It is searched on the path, then in the folders of PlatformIO and the Arduino IDE. The first version that
    suits a Due is taken; otherwise the first one, which is `Bossac.doubtful`.
    """
    if named is not None:
        return _version_and_options(str(named))
    doubtful = []
    for path in _candidate_paths():
        try:
            bossac = _version_and_options(path)
        except UploaderError:
            continue
        if not bossac.doubtful:
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


def write_image(bossac: Bossac, port: str, image: Path, timeout_s: float = WRITE_TIMEOUT_S) -> None:
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
    if "-h' or" in output or "extra arguments" in output or "Usage:" in output:
        return FlashError(
            f"bossac {bossac.version} does not know the options that heli-host gave it", GET_BOSSAC
        )
    if code < 0:
        return FlashError(f"bossac {bossac.version} crashed (signal {-code})", GET_BOSSAC)
    return FlashError(
        f"bossac {bossac.version} failed with code {code}: {last_line}",
        "check cable and power, press RESET, then flash again",
    )
