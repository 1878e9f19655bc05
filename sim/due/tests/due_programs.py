"""Programs for the Due, compiled from `programs/`."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

PROGRAMS = Path(__file__).resolve().parent / "programs"
Build = Callable[..., Path]


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Compiles programs of ``programs/`` to ELF files; skips without the cross-compiler."""
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("arm-none-eabi-gcc is missing: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi")
    folder = tmp_path_factory.mktemp("programs")

    def compile_program(name: str, *options: str) -> Path:
        output = folder / ("-".join([Path(name).stem, *(o.strip("-") for o in options)]) + ".elf")
        command = [
            compiler, "-mcpu=cortex-m3", "-mthumb", "-g", "-nostartfiles", "-ffreestanding",
            "-T", str(PROGRAMS / "due.ld"), *options, "-o", str(output),
            str(PROGRAMS / "start.S"), str(PROGRAMS / name), "-lm", "-lc", "-lgcc",
        ]  # fmt: skip
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        return output

    return compile_program
