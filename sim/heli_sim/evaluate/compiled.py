"""CasADi functions compiled to shared libraries, which are kept in the user's cache.

The cache accepts only complete files that this user wrote. Each library ends with a digest of its bytes,
which loaders ignore. After a power cut, a file may be too short or full of zeros. Its digest then does not
match, and it is not loaded, because that could crash the process.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import platform
import shutil
import stat
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final

import casadi as ca

from heli_sim.errors import PlantError

_DIGEST_MARK: Final = b"\nheli_sim sha256 "
_DIGEST_BYTES: Final = 32


def cache_path() -> Path:
    """Return the folder of compiled functions: heli_sim in $XDG_CACHE_HOME or in ~/.cache."""
    root = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(root).expanduser() / "heli_sim"


def cache_folder() -> Path:
    """Create the folder of compiled functions."""
    folder = cache_path()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            danger = writable_by_others(folder)
            if danger:
                raise PlantError(danger, f"check who wrote there, then remove it with: rm -r {folder}")
            return folder
    except OSError:
        pass
    temporary = Path(tempfile.mkdtemp(prefix="heli_sim-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


def writable_by_others(path: Path) -> str:
    """Describe which other users could have written code there; empty for none."""
    if not hasattr(os, "geteuid"):
        return ""
    status = path.stat()
    if status.st_uid not in (os.geteuid(), 0):
        return f"the cache {path} belongs to another user, whose code would run"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to the cache {path}, and its code would run"
    return ""


def is_intact(library: Path) -> bool:
    """Return whether a library in the cache is complete and unchanged."""
    try:
        if writable_by_others(library):
            return False
        data = library.read_bytes()
    except OSError:
        return False
    content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    return content.endswith(_DIGEST_MARK) and hashlib.sha256(content).digest() == digest


def keep(built: Path, library: Path) -> None:
    """Store a library in the cache, completely or not at all, even if the power fails."""
    content = built.read_bytes() + _DIGEST_MARK
    built.chmod(0o700)
    with built.open("wb") as file:
        file.write(content + hashlib.sha256(content).digest())
        file.flush()
        # The content must be on the disk before the name; otherwise a power cut could leave an empty file.
        os.fsync(file.fileno())
    built.replace(library)


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
    """Compile a `function` to a shared library, whose symbol has the name of the function."""
    # Returns the library of an earlier call if there is one, and None without a C compiler. A PlantError is
    # raised if compilation fails.
    return compile_source(function.name(), c_source(function))


def c_source(function: ca.Function) -> str:
    """Write a `function` as C; its name is the symbol."""
    generator = ca.CodeGenerator(function.name(), {"with_header": False})
    generator.add(function)
    source: str = generator.dump()
    return source


def compile_source(name: str, source: str) -> Path | None:
    """Compile the text of a C file, `source`, to a shared library `name` in the cache."""
    # Returns the library of an earlier call if there is one, and None without a C compiler. A PlantError is
    # raised if compilation fails, or if other users can write to the cache.
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
