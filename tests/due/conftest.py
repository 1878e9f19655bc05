"""Skips this folder where the emulator is not built, and builds programs for it."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
collect_ignore_glob: list[str] = []
if importlib.util.find_spec("due_emulator._due") is None:
    collect_ignore_glob = ["test_*.py"]

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
            "-T", str(HERE / "programs" / "due.ld"), *options, "-o", str(output),
            str(HERE / "programs" / "start.S"), str(HERE / "programs" / name), "-lm", "-lc", "-lgcc",
        ]  # fmt: skip
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        return output

    return compile_program
