"""The digest of the code that computes a result: results of other code are other results."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Final

PACKAGES: Final = ("due_emulator", "heli_host", "heli_sim", "heli_lab")
_ENDS: Final = (".py", ".toml", ".so", ".pyd", ".hpp", ".cpp", ".c", ".h")
"""Sources, rigs and plans, and what is compiled. Pages and documents compute nothing."""


def code_digest(works: Iterable[str] = (), folder: str = "", packages: Iterable[str] = PACKAGES) -> str:
    """Digest all files of `packages`, and of the packages of the functions `works` (as
    ``package.module:function``), that can change a number, with Python's version: 16 letters.

    Compiled modules count, and their sources too, which may be newer.

    Parameters
    ----------
    works : iterable of str
        Functions that do the cases.
    folder : str
        Folder of modules that are not installed, such as the campaign file's.
    packages : iterable of str
        Installed packages that the result depends on.

    Raises
    ------
    ImportError
        When a package of `works` is neither installed here nor in the folder.
    """
    packages = tuple(packages)
    names = {work.partition(":")[0].rpartition(".")[0] or work.partition(":")[0] for work in works}
    others = sorted(name for name in names if name.partition(".")[0] not in PACKAGES)
    digest = hashlib.sha256(f"{sys.version_info[:2]}".encode())
    for package in (*packages, *others):
        digest.update(package_digest(package) if _installed(package) else _loose_digest(package, folder))
    return digest.hexdigest()[:16]


def _installed(package: str) -> bool:
    """Whether a package can be imported without the folder of a campaign file."""
    try:
        return importlib.util.find_spec(package) is not None
    except (ModuleNotFoundError, ValueError):
        return False


def _loose_digest(package: str, folder: str) -> bytes:
    """Digest a module or package in a folder, and the modules next to it, which it may import."""
    top = package.partition(".")[0]
    spec = PathFinder.find_spec(top, [folder]) if folder else None
    if spec is None:
        where = f" or in {folder}" if folder else ""
        raise ImportError(f"there is no module {top} installed{where}")
    paths = list(Path(folder).glob("*.py"))
    for inside in spec.submodule_search_locations or ():
        paths += [path for path in Path(inside).rglob("*") if path.suffix in _ENDS and path.is_file()]
    digest = hashlib.sha256(package.encode())
    for path in sorted(set(paths)):
        digest.update(path.relative_to(folder).as_posix().encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


@cache
def package_digest(package: str) -> bytes:
    """Digest an installed `package`; its files are read once."""
    digest = hashlib.sha256(package.encode())
    for name, path in sorted(_files(package)):
        digest.update(name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


def _files(package: str) -> Iterator[tuple[str, Path]]:
    """Files of a package, with their names within it; one that is a single module has one."""
    spec = importlib.util.find_spec(package)
    if spec is None:
        raise ImportError(f"there is no package {package}")
    if spec.submodule_search_locations is None:
        # Python's version stands for its built-in modules.
        if spec.has_location:
            path = Path(str(spec.origin))
            yield path.name, path
        return
    # An editable installation has sources in one folder and what is compiled in another.
    for folder in map(Path, spec.submodule_search_locations):
        for path in folder.rglob("*"):
            if path.suffix in _ENDS and path.is_file():
                yield path.relative_to(folder).as_posix(), path
