"""Run PlatformIO without a network: ``python firmware/pio/build.py [--pins FILE] [ARGUMENTS]``.

The arguments go to ``pio``; without any, it gets ``run -e due``. With ``--pins`` the firmware is built for
the wiring in that file, into ``build/pio-pins`` instead of ``build/pio``: a simulation that takes the newest
firmware must not find one for another wiring. PlatformIO's core directory is made in ``build/platformio``
from the replacement platform in this folder and SCons as installed with PlatformIO.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT))

from firmware.generator.declared import DeclarationError  # noqa: E402 - found by the line above
from firmware.generator.wiring import generate_header, generate_table, read_pins  # noqa: E402 - the same

WIRING = ROOT / "build" / "pio-wiring"
CORE = ROOT / "build" / "platformio"

# Files of the stand-in platform, and where PlatformIO looks for them.
STAND_IN = {"platform.json": "platform.json", "due.json": "boards/due.json", "builder.py": "builder/main.py"}

# What PlatformIO would fetch, by the versions that it asks for.
SCONS_VERSION = "4.41101.0"
TOOLCHAIN_VERSION = "1.90301.200702"
UPLOADER_VERSION = "1.10700.190624"
RUN_SCONS = "from SCons.Script import main\n\nmain()\n"


def _package(folder: Path, kind: str, name: str, version: str) -> None:
    """Make `folder` look to PlatformIO like a package that it has fetched."""
    folder.mkdir(parents=True, exist_ok=True)
    if kind == "tool":
        manifest = {"name": name, "version": version, "description": "from this system"}
        (folder / "package.json").write_text(json.dumps(manifest))
    spec = {"owner": "platformio", "id": None, "name": name, "requirements": None, "uri": None}
    (folder / ".piopm").write_text(json.dumps({"type": kind, "name": name, "version": version, "spec": spec}))


def _needs() -> str | None:
    """What is missing on this system, as one line; None when nothing is."""
    if find_spec("platformio") is None or find_spec("SCons") is None:
        return f"PlatformIO is missing; type: {sys.executable} -m pip install platformio scons"
    if shutil.which("arm-none-eabi-g++") is None:
        return (
            "the cross-compiler is missing; on Debian type: "
            "sudo apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi libstdc++-arm-none-eabi-dev"
        )
    return None


def _prepare() -> None:
    """Fill PlatformIO's core directory; the real one of the user is left alone."""
    platform = CORE / "platforms" / "atmelsam"
    for name, place in STAND_IN.items():
        (platform / place).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(HERE / name, platform / place)
    version = json.loads((HERE / "platform.json").read_text())["version"]
    _package(platform, "platform", "atmelsam", version)
    scons = CORE / "packages" / "tool-scons"
    _package(scons, "tool", "tool-scons", SCONS_VERSION)
    (scons / "scons.py").write_text(RUN_SCONS)
    _package(
        CORE / "packages" / "toolchain-gccarmnoneeabi", "tool", "toolchain-gccarmnoneeabi", TOOLCHAIN_VERSION
    )
    # Empty, as the compiler's: heli-host flash finds a real one.
    _package(CORE / "packages" / "tool-bossac", "tool", "tool-bossac", UPLOADER_VERSION)


def _write_wiring(path: Path) -> None:
    """Write the header and the table of a wiring into `WIRING`."""
    wiring = read_pins(path)
    WIRING.mkdir(parents=True, exist_ok=True)
    for name, text in (("wiring.hpp", generate_header(wiring)), ("wiring.md", generate_table(wiring))):
        (WIRING / name).write_text(text)


def main() -> int:
    """Run PlatformIO in the prepared directory."""
    arguments = sys.argv[1:]
    pins: Path | None = None
    if arguments[:1] == ["--pins"] and len(arguments) > 1:
        pins, arguments = Path(arguments[1]), arguments[2:]
    arguments = arguments or ["run", "-e", "due"]  # otherwise all arguments are PlatformIO's
    if pins is not None:
        try:
            _write_wiring(pins)
        except DeclarationError as error:
            print(f"error: {pins}: {error}", file=sys.stderr)
            return 2
    missing = _needs()
    if missing is not None:
        print(f"error: {missing}", file=sys.stderr)
        return 1
    _prepare()
    environment = {
        **os.environ,
        "PLATFORMIO_CORE_DIR": str(CORE),
        "PLATFORMIO_BUILD_DIR": str(ROOT / "build" / ("pio-pins" if pins else "pio")),
        "HELI_WIRING": str(WIRING) if pins else "",
        "PLATFORMIO_SETTING_ENABLE_TELEMETRY": "no",
        "PLATFORMIO_SETTING_CHECK_PLATFORMIO_INTERVAL": "3650",
    }
    command = [sys.executable, "-m", "platformio", *arguments]
    status = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    if pins is not None and status == 0:
        print(
            f"wires: {WIRING / 'wiring.md'}; firmware: {ROOT / 'build' / 'pio-pins' / 'due' / 'firmware.bin'}"
        )
    return status


if __name__ == "__main__":
    sys.exit(main())
