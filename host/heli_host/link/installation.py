"""The installed packages: this package's version, and the entry points of packages that build on it."""

from __future__ import annotations

from functools import cache
from importlib.metadata import EntryPoints, PackageNotFoundError, entry_points, version
from typing import cast


def plugins(group: str) -> EntryPoints:
    """Return the entry points of a group."""
    # A package that is installed later is found by the next process: to read the metadata of all packages
    # takes a third of the time in which a simulated board opens.
    return _installed().select(group=group)


@cache
def _installed() -> EntryPoints:
    # Python 3.11 returns its groups, which select in the same way.
    return cast(EntryPoints, entry_points())


@cache
def installed_version() -> str:
    """Return the version of this package, ``unknown`` if it is imported from a source tree."""
    try:
        return version("heli-host")
    except PackageNotFoundError:
        return "unknown"
