"""Work shared out to threads: filters, programs and arithmetic on arrays leave Python's lock."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

_T = TypeVar("_T")
_Item = TypeVar("_Item")


class _Here(threading.local):
    shared = False
    """Whether this thread does a share of a work, so that it shares out nothing itself."""
    threads: int | None = None


_here = _Here()


def usual_threads() -> int:
    """Threads of a work that was not told how many: two, or one where ``OMP_NUM_THREADS`` is 1, which is how
    one says that other processes have the other cores.
    """
    if _here.threads is not None:
        return _here.threads
    return 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2


@contextmanager
def using_threads(threads: int | None) -> Iterator[None]:
    """Have works in this block use so many `threads`, 1 or more, as usual ones; None changes nothing."""
    before = _here.threads
    _here.threads = before if threads is None else threads
    try:
        yield
    finally:
        _here.threads = before


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, initializer=lambda: setattr(_here, "shared", True))


def shared_out(work: Callable[[_Item], _T], items: Sequence[_Item], threads: int | None = None) -> list[_T]:
    """Do `work` on each of some items, by several threads, and return what it made of each in their order.
    A share of a work is not shared out again.

    Parameters
    ----------
    work : callable
        Called with an item, by any thread; what it raises is raised here.
    items : sequence
        What to work on.
    threads : int, optional
        Threads, 1 or more; `usual_threads` where not given.
    """
    threads = usual_threads() if threads is None else threads
    if threads == 1 or len(items) < 2 or _here.shared:
        return [work(item) for item in items]
    return list(_pool(threads).map(work, items))
