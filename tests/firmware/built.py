"""The linked firmware, built once for all workers and runs; make builds again only what is out of date."""

import fcntl
import functools
import os
import shutil
import subprocess
from pathlib import Path
from typing import Final

import pytest

ROOT: Final = Path(__file__).resolve().parents[2]
BUILD: Final = ROOT / "build" / "firmware-of-tests"
DRIVERS: Path = ROOT / "firmware" / "due"
"""Sources of the drivers, for tests that read their text; changed drivers are elsewhere."""


@functools.cache
def built_elf() -> Path:
    """The ELF of the sources as they are; skips without the cross-compiler."""
    for tool in ("arm-none-eabi-g++", "make"):
        if shutil.which(tool) is None:
            pytest.skip(
                f"{tool} is not installed; on Debian: apt-get install gcc-arm-none-eabi "
                "libnewlib-arm-none-eabi libstdc++-arm-none-eabi-dev make"
            )
    BUILD.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        process = subprocess.run(
            ["make", "-s", "-C", ROOT / "firmware" / "due", f"BUILD={BUILD}", BUILD / "heli.elf"],
            capture_output=True,
            text=True,
            check=False,
        )
    assert process.returncode == 0, process.stderr
    return BUILD / "heli.elf"


def compile_here(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Run this computer's C++ compiler; skips without one."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("no C++ compiler is installed")
    return subprocess.run([compiler, *arguments], capture_output=True, text=True, check=False)


def take_over_objects(build: Path, firmware: Path) -> None:
    """Copy the objects of the tests' firmware into a new folder `build`, so that make compiles only what
    differs in `firmware`, a copy of its sources, and what includes that.
    """
    built_elf()
    shutil.copytree(BUILD, build, ignore=shutil.ignore_patterns("lock", "heli.*"))
    for rules in build.rglob("*.d"):
        text = rules.read_text().replace(str(BUILD), str(build))
        rules.write_text(text.replace(str(ROOT / "firmware"), str(firmware)))
    # Make compares times: what is as the objects were compiled from is older than they are.
    for path in build.rglob("*.o"):
        os.utime(path, (1, 1))
    for path in firmware.rglob("*"):
        original = ROOT / "firmware" / path.relative_to(firmware)
        if path.is_file() and original.is_file() and path.read_bytes() == original.read_bytes():
            os.utime(path, (0, 0))
