"""Limits of a process that the system enforces."""

from __future__ import annotations

import math
import sys
from contextlib import suppress


def can_limit() -> bool:
    """Whether this system can limit processes; Windows cannot."""
    try:
        import resource  # noqa: F401
    except ImportError:
        return False
    return True


def limit_process(kind: str, soft: int, hard: int | None = None) -> None:
    """Set a limit of this process, as far as its present hard limit permits.

    A system that has no such limit leaves the process as it is: Windows has none at all, and macOS none of
    the address space.

    Parameters
    ----------
    kind : str
        Which limit: ``CPU`` in s, ``AS`` and ``FSIZE`` in bytes, ``NOFILE``, or another ``RLIMIT_`` of
        `resource`.
    soft : int
        Where the system reports the excess to the process.
    hard : int, optional
        Where it ends the process, and the most that `soft` can be raised to later; stays where not given.
    """
    if sys.platform == "win32" or not can_limit():
        return
    import resource

    def lower(*limits: int) -> int:
        return min(limits, key=lambda limit: math.inf if limit == resource.RLIM_INFINITY else limit)

    with suppress(AttributeError, OSError, ValueError):
        number = getattr(resource, f"RLIMIT_{kind}")
        present = resource.getrlimit(number)[1]
        hard = present if hard is None else lower(hard, present)
        resource.setrlimit(number, (lower(soft, hard), hard))
