"""CasADi functions as shared libraries, kept in the user's cache."""

from __future__ import annotations

import atexit
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import Final

import casadi as ca

from heli_sim.errors import PlantError

# No contraction into fused multiply-adds: the same numbers on every machine. -O2 takes 1.6 times as long to
# compile and runs no faster.
_FLAGS: Final = ("-O1", "-fPIC", "-shared", "-ffp-contract=off")


def compiler() -> str | None:
    """Find a C compiler.

    Returns
    -------
    str or None
        Path of $CC, cc, gcc or clang, whichever exists first.
    """
    for name in (os.environ.get("CC", ""), "cc", "gcc", "clang"):
        path = shutil.which(name) if name else None
        if path:
            return path
    return None


def cache_folder() -> Path:
    """Folder of compiled functions: heli_sim under $XDG_CACHE_HOME, or under ~/.cache.

    Returns
    -------
    Path
        The folder, made if it was missing; one that lives as long as this process when it cannot be made.
    """
    root = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(root).expanduser() / "heli_sim"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    temporary = Path(tempfile.mkdtemp(prefix="heli_sim-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


def compile_function(function: ca.Function) -> Path | None:
    """Compile a function, or find the library that an earlier call compiled.

    Parameters
    ----------
    function : casadi.Function
        Function to compile; its name is the symbol in the library.

    Returns
    -------
    Path or None
        The shared library; None when there is no C compiler.

    Raises
    ------
    PlantError
        When the compiler fails.
    """
    return compile_source(function.name(), c_source(function))


def c_source(*functions: ca.Function) -> str:
    """Write functions as C.

    Parameters
    ----------
    *functions : casadi.Function
        Functions; their names are the symbols.
    """
    generator = ca.CodeGenerator(functions[0].name(), {"with_header": False})
    for function in functions:
        generator.add(function)
    source: str = generator.dump()
    return source


def compile_source(name: str, source: str) -> Path | None:
    """Compile a C file, or find the library that an earlier call compiled.

    Parameters
    ----------
    name : str
        Name of the library in the cache.
    source : str
        The C file.

    Returns
    -------
    Path or None
        The shared library; None when there is no C compiler.

    Raises
    ------
    PlantError
        When the compiler fails.
    """
    key = hashlib.sha256("\n".join([source, *_FLAGS, platform.machine(), platform.system()]).encode())
    folder = cache_folder()
    library = folder / f"{name}-{key.hexdigest()[:24]}.so"
    if library.exists():
        return library
    cc = compiler()
    if cc is None:
        return None
    # Built beside its final place and renamed: two processes may do this at the same time.
    with tempfile.TemporaryDirectory(dir=folder) as work:
        c_file, so_file = Path(work) / "f.c", Path(work) / "f.so"
        c_file.write_text(source, encoding="utf-8")
        command = [cc, *_FLAGS, "-o", str(so_file), str(c_file), "-lm"]
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        if result.returncode != 0:
            reason = (result.stderr.strip().splitlines() or ["no message"])[0]
            raise PlantError(f"{cc} cannot compile the plant: {reason}", "set CC to a working C compiler")
        so_file.replace(library)
    return library
