"""Digest the code that computes results, so that a stored result is not used after a change of the code."""

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
"""Packages of this project on which results depend."""
_SUFFIXES: Final = (".py", ".toml", ".so", ".pyd", ".hpp", ".cpp", ".c", ".h")
"""Endings of the files that can change a result: sources, rigs, plans, and compiled modules."""


def code_digest(works: Iterable[str] = (), folder: str = "", packages: Iterable[str] = PACKAGES) -> str:
    """Digest all files that can change a result, together with the version of Python; return 16 letters."""
    # Compiled modules count, and so do their sources, which may be newer.
    packages = tuple(packages)
    modules = [work.partition(":")[0] for work in works]
    # The package of a module, or the module itself if it is in no package.
    names = {module.rpartition(".")[0] or module for module in modules}
    others = sorted(name for name in names if name.partition(".")[0] not in PACKAGES)
    digest = hashlib.sha256(f"{sys.version_info[:2]}".encode())
    for package in (*packages, *others):
        digest.update(package_digest(package) if _is_installed(package) else _folder_digest(package, folder))
    return digest.hexdigest()[:16]


def _is_installed(package: str) -> bool:
    """Whether a package can be imported without the folder of a campaign file."""
    try:
        return importlib.util.find_spec(package) is not None
    except (ModuleNotFoundError, ValueError):  # the parent package is missing, or the module has no spec
        return False


def _folder_digest(package: str, folder: str) -> bytes:
    """Digest a module or package that is not installed, and all modules in its `folder`, which it may
    import.
    """
    top = package.partition(".")[0]
    spec = PathFinder.find_spec(top, [folder]) if folder else None
    if spec is None:
        where = f" or in {folder}" if folder else ""
        raise ImportError(f"there is no module {top} installed{where}")
    paths = list(Path(folder).glob("*.py"))
    for package_folder in spec.submodule_search_locations or ():
        paths += [
            path for path in Path(package_folder).rglob("*") if path.suffix in _SUFFIXES and path.is_file()
        ]
    digest = hashlib.sha256(package.encode())
    for path in sorted(set(paths)):
        digest.update(path.relative_to(folder).as_posix().encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


@cache
def package_digest(package: str) -> bytes:
    """Digest an installed package; its files are read once per process."""
    digest = hashlib.sha256(package.encode())
    for name, path in sorted(_files_of_package(package)):
        digest.update(name.encode())
        digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


def _files_of_package(package: str) -> Iterator[tuple[str, Path]]:
    """List the files of an installed package, or of a single module, with their names within the package."""
    spec = importlib.util.find_spec(package)
    if spec is None:
        raise ImportError(f"there is no package {package}")
    if spec.submodule_search_locations is None:
        # A built-in module has no file; the version of Python, which is digested too, stands for it.
        if spec.has_location:
            path = Path(str(spec.origin))
            yield path.name, path
        return
    # An editable installation has sources in one folder, and compiled modules in another.
    for folder in map(Path, spec.submodule_search_locations):
        for path in folder.rglob("*"):
            if path.suffix in _SUFFIXES and path.is_file():
                yield path.relative_to(folder).as_posix(), path
