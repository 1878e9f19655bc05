"""What is flown or fitted once for tests, kept on disk for all workers and for the next run.

It lies in ``build/kept`` under a digest of all that made it: every source and data file of the rooms that
take part, the compiled extensions, the helpers that are named, the libraries' versions. That is coarse on
purpose: an edit anywhere in those rooms makes it again, and nobody has to think about which edit matters.
"""

from __future__ import annotations

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

from tests.running.clock import spent_s

ROOT: Final = Path(__file__).resolve().parents[2]
FLOWN: Final = ("firmware", "host", "sim/native", "sim/due", "sim/due_board", "sim/heli_sim")
"""What a flight is made by: flight code, host, simulation."""
FITTED: Final = (*FLOWN, "sim/heli_lab")
"""What is made of flights besides."""
LIBRARIES: Final = ("numpy", "scipy", "casadi", "mujoco")
"""Libraries whose numbers go into what is kept."""
NOT_SOURCES: Final = {".md", ".pyc"}

T = TypeVar("T")


class Kept:
    """A folder of things that tests share.

    Parameters
    ----------
    folder : Path
        Where they are kept.
    root : Path
        What the names of rooms are relative to.
    extensions : Path
        Where the compiled extensions are installed.
    """

    def __init__(self, folder: Path, root: Path, extensions: Path) -> None:
        self.saved_s = 0.0
        """CPU time that what was taken so far took to make, less what this process spent on that."""
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
        """Take what is kept, or make it.

        Parameters
        ----------
        name : str
            What it is, with every argument that it is made from.
        make : callable
            Makes it; what it returns is pickled. Never runs twice at once, in whatever processes.
        made_by : iterable of str or Path
            Files of the tests that take part in making it.
        rooms : iterable of str
            Folders of the project that do.
        """
        stem = re.sub(r"[^\w.=-]+", "_", name)[:60] + "-" + hashlib.sha256(name.encode()).hexdigest()[:8]
        path = self.folder / f"{stem}-{self._digest(rooms, made_by)[:16]}.pickle"
        self.folder.mkdir(parents=True, exist_ok=True)
        start_s = self.charged_s()
        with (self.folder / f"{stem}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not path.exists():
                self._write(path, make)
                for other in self.folder.glob(f"{stem}-*.pickle"):
                    if other != path:
                        other.unlink()
            cost_s, value = pickle.loads(path.read_bytes())
        self.saved_s += max(0.0, cost_s - (self.charged_s() - start_s))
        kept: T = value
        return kept

    def charged_s(self) -> float:
        """CPU time as if this process had made everything itself that it took."""
        return spent_s() + self.saved_s

    def extensions(self) -> list[Path]:
        """What is compiled, as it is installed: it may lag behind its sources, and it is what flies."""
        found = self._extensions.glob("heli_*/**/*")
        return [path for path in found if path.suffix in (".so", ".elf")]

    def _write(self, path: Path, make: Callable[[], object]) -> None:
        start_s = self.charged_s()
        value = make()
        # Written whole and then named, so that an interrupted run leaves no half of it.
        unfinished = path.with_suffix(f".{os.getpid()}")
        unfinished.write_bytes(pickle.dumps((self.charged_s() - start_s, value)))
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
        """Digest of names and contents of a file, of a room's sources, or of all compiled extensions."""
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
