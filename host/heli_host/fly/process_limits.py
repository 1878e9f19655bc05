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

    If the system does not have this limit, nothing changes: Windows has no such limits, and macOS does not
    limit the address space.
    """
    if sys.platform == "win32" or not can_limit():
        return
    import resource

    def lowest(*limits: int) -> int:
        return min(limits, key=lambda limit: math.inf if limit == resource.RLIM_INFINITY else limit)

    with suppress(AttributeError, OSError, ValueError):
        number = getattr(resource, f"RLIMIT_{kind}")
        hard_limit = resource.getrlimit(number)[1]
        hard = hard_limit if hard is None else lowest(hard, hard_limit)
        resource.setrlimit(number, (lowest(soft, hard), hard))
