"""The user's cache of compiled functions. It holds complete files of this user only.

A library is kept with a digest of its own bytes behind it, which loaders ignore. If a power cut left the file
short or full of zeros, the digest does not match: loading such a file could end the process by SIGBUS.
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

_MARK: Final = b"\nheli_sim sha256 "
_DIGEST_BYTES: Final = 32


def place() -> Path:
    """Folder of compiled functions: heli_sim under $XDG_CACHE_HOME, or under ~/.cache."""
    root = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(root).expanduser() / "heli_sim"


def cache_folder() -> Path:
    """Create the folder of compiled functions.

    Returns
    -------
    Path
        The folder, which only its user can write; one that lives as long as this process when there cannot be
        one.

    Raises
    ------
    PlantError
        When others can write to the folder that is there: its code would run as this user.
    """
    folder = place()
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            danger = open_to_others(folder)
            if danger:
                raise PlantError(danger, f"check who wrote there, then remove it with: rm -r {folder}")
            return folder
    except OSError:
        pass
    temporary = Path(tempfile.mkdtemp(prefix="heli_sim-"))
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return temporary


def open_to_others(path: Path) -> str:
    """Describe the other users who could have put code there; empty for none.

    Parameters
    ----------
    path : Path
        Folder or file.

    Returns
    -------
    str
        Empty if only this user and the system's administrator could.
    """
    if not hasattr(os, "geteuid"):
        return ""
    status = path.stat()
    if status.st_uid not in (os.geteuid(), 0):
        return f"the cache {path} belongs to another user, whose code would run"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"others can write to the cache {path}, and its code would run"
    return ""


def is_whole(library: Path) -> bool:
    """Whether a library in the cache is byte for byte the one that this user stored.

    Parameters
    ----------
    library : Path
        Its place in the cache.
    """
    try:
        if open_to_others(library):
            return False
        data = library.read_bytes()
    except OSError:
        return False
    content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
    return content.endswith(_MARK) and hashlib.sha256(content).digest() == digest


def keep(built: Path, library: Path) -> None:
    """Store a library in the cache, completely or not at all, even if the power fails.

    Parameters
    ----------
    built : Path
        The library, in a folder of the same file system; it is moved away.
    library : Path
        Its place in the cache; one that is there is replaced, and lives on in processes that loaded it.
    """
    content = built.read_bytes() + _MARK
    built.chmod(0o700)
    with built.open("wb") as file:
        file.write(content + hashlib.sha256(content).digest())
        file.flush()
        # A name on the disk before its content is what a power cut turns into an empty file.
        os.fsync(file.fileno())
    built.replace(library)
