"""Version of the installed package."""

from __future__ import annotations

from functools import cache


@cache
def installed_version() -> str:
    """Return the version of this package, ``unknown`` if it is imported from a source tree.

    The result is kept, because reading the metadata takes a millisecond.
    """
    # Imported here, because it would triple the time that an import of the package takes.
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("heli-host")
    except PackageNotFoundError:
        return "unknown"
