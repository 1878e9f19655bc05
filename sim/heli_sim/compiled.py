"""Compile CasADi functions to shared libraries, which are kept in the user's cache."""

from __future__ import annotations

import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import casadi as ca

from heli_sim.cache import cache_folder, is_intact, keep
from heli_sim.errors import PlantError

# Without contraction into fused multiply-adds, every machine computes the same numbers. -O2 would take 1.6
# times as long to compile and run no faster.
# Clang for Windows always makes position-independent code, and needs no separate library of mathematics.
_WINDOWS: Final = sys.platform == "win32"
FLAGS: Final = ("-O1", *(() if _WINDOWS else ("-fPIC",)), "-shared", "-ffp-contract=off")
LIBRARIES: Final = () if _WINDOWS else ("-lm",)


def compiler() -> str | None:
    """Path of the first compiler that exists: $CC, cc, gcc or clang; None without a C compiler."""
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        path = shutil.which(name) if name else None
        if path:
            return path
    return None


def compile_function(function: ca.Function) -> Path | None:
    """Compile a `function` to a shared library, whose symbol has the name of the function.

    Returns the library of an earlier call if there is one, and None without a C compiler. A PlantError is
    raised if compilation fails.
    """
    return compile_source(function.name(), c_source(function))


def c_source(function: ca.Function) -> str:
    """Write a `function` as C; its name is the symbol."""
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)
    source: str = generator.dump()
    return source


def compile_source(name: str, source: str) -> Path | None:
    """Compile the text of a C file, `source`, to a shared library `name` in the cache.

    Returns the library of an earlier call if there is one, and None without a C compiler. A PlantError is
    raised if compilation fails, or if other users can write to the cache.
    """
    key = hashlib.sha256("\n".join([source, *FLAGS, platform.machine(), platform.system()]).encode())
    folder = cache_folder()
    library = folder / f"{name}-{key.hexdigest()[:24]}.so"
    if is_intact(library):
        return library
    cc = compiler()
    if cc is None:
        return None
    # Built in the same folder and renamed, because two processes may compile the same function.
    with tempfile.TemporaryDirectory(dir=folder) as work:
        c_file, so_file = Path(work) / "f.c", Path(work) / "f.so"
        c_file.write_text(source, encoding="utf-8")
        command = [cc, *FLAGS, "-o", str(so_file), str(c_file), *LIBRARIES]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            reason = (result.stderr.strip().splitlines() or ["no message"])[0]
            raise PlantError(f"{cc} cannot compile the plant: {reason}", "set CC to a working C compiler")
        keep(so_file, library)
    return library
