"""Flights and fits that many tests use, kept on disk for all workers and for the next run.

The folder is ``build/kept``. The name of a file has a digest of everything that made it: all source and data
files of the packages involved, extensions, helpers of the tests, and versions of libraries. That is coarse
on purpose. Any edit in those packages makes the result again, and nobody has to decide which edit matters.
"""

import fcntl
import hashlib
import importlib.metadata
import os
import pickle
import platform
import re
import sys
import sysconfig
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Final, TypeVar

ROOT: Final = Path(__file__).resolve().parents[2]
FLOWN: Final = ("firmware", "host", "sim/native", "sim/due", "sim/due_board", "sim/heli_sim")
"""Folders whose sources determine a flight: flight code, host, simulation."""
FITTED: Final = (*FLOWN, "sim/heli_lab")
"""Folders whose sources determine what is computed from flights."""
LIBRARIES: Final = ("numpy", "scipy", "casadi", "mujoco")
"""Libraries whose versions determine a result."""
NOT_SOURCES: Final = {".md", ".pyc"}

T = TypeVar("T")


class Kept:
    """A folder of results that tests share, which sources in `root` and installed extensions determine."""

    def __init__(self, folder: Path, root: Path, extensions: Path) -> None:
        self.folder = folder
        self._root = root
        self._extensions = extensions
        self._digests: dict[Path, bytes] = {}

    def __call__(
        self,
        name: str,
        make: Callable[[], T],
        *,
        made_by: Iterable[str | Path],
        rooms: Iterable[str] = FITTED,
    ) -> T:
        """Return a kept result, or make it."""
        stem = re.sub(r"[^\w.=-]+", "_", name)[:60] + "-" + hashlib.sha256(name.encode()).hexdigest()[:8]
        path = self.folder / f"{stem}-{self._digest(rooms, made_by)[:16]}.kept"
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / f"{stem}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                self._write(path, make)
                for other in self.folder.glob(f"{stem}-*.kept"):
                    if other != path:
                        other.unlink()
            kept: T = pickle.loads(path.read_bytes())
        return kept

    def extensions(self) -> list[Path]:
        """Return the installed extensions. They may be older than their sources, and they are what flies."""
        paths = self._extensions.glob("heli_*/**/*")
        return [path for path in paths if path.suffix in (".so", ".elf")]

    def _write(self, path: Path, make: Callable[[], object]) -> None:
        # Renamed when complete, so that an interrupted run leaves no incomplete result.
        unfinished = path.with_suffix(f".{os.getpid()}")
        unfinished.write_bytes(pickle.dumps(make()))
        unfinished.rename(path)

    def _digest(self, rooms: Iterable[str], made_by: Iterable[str | Path]) -> str:
        digest = hashlib.sha256(f"{sys.version} {platform.machine()}".encode())
        digest.update(" ".join(_version(name) for name in LIBRARIES).encode())
        for place in (self._extensions, *(self._root / room for room in rooms), *map(Path, made_by)):
            if place not in self._digests:
                self._digests[place] = self._content(place)
            digest.update(self._digests[place])
        return digest.hexdigest()

    def _content(self, place: Path) -> bytes:
        """Return a digest of names and contents: a file, the sources of a folder, or all extensions."""
        paths = [place]
        if place == self._extensions:
            paths = self.extensions()
        elif place.is_dir():
            paths = [path for path in place.rglob("*") if path.suffix not in NOT_SOURCES and path.is_file()]
        digest = hashlib.sha256()
        for path in sorted(paths):
            digest.update(f"{path.relative_to(place.parent)} ".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
        return digest.digest()


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


KEPT: Final = Kept(ROOT / "build" / "kept", ROOT, Path(sysconfig.get_path("platlib")))
