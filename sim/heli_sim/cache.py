"""The user's cache of compiled functions. It accepts only complete files that this user wrote.

Each library ends with a digest of its bytes, which loaders ignore. After a power cut, a file may be too short
or full of zeros. Its digest then does not match, and it is not loaded, because that could crash the process.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import shutil
import stat
import tempfile
from pathlib import Path
from typing import Final

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
