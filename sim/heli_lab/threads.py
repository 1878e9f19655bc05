"""Work shared out to threads: filters, programs and arithmetic on arrays leave Python's lock."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import cache
from typing import Final, TypeVar

_ARENA_MAX: Final = -8
"""M_ARENA_MAX of glibc's malloc.h."""
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


def one_heap() -> None:
    """Have all threads take memory from one heap, where the C library is glibc. By its default each thread
    has its own, and what one gives back no other gets: of ten minutes at 1 kHz a diagnosis held 0.58 GB, and
    0.49 with one heap; of one minute 0.27 and 0.19. It is for a program to choose, before it has threads.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


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


class Ahead:
    """Works that will be asked for one after the other, done by a thread beside from the last one on: it and
    whoever asks meet in the middle. They must not depend on each other.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, Future[object]] = {}

    @contextmanager
    def working(self, works: Mapping[str, Callable[[], object]]) -> Iterator[None]:
        """Begin these `works`, by key, and end what was not asked for with the block; in it nothing else is
        shared out. Where there is no second thread nothing is done ahead.
        """
        if usual_threads() < 2 or len(works) < 2 or _here.shared or self._waiting:
            yield
            return
        with using_threads(1):
            self._waiting = {key: _beside().submit(work) for key, work in reversed(list(works.items()))}
            try:
                yield
            finally:
                for key in list(self._waiting):
                    self.wait_for(key)

    def wait_for(self, key: str) -> None:
        """Wait for the work of a `key` if it was begun; what it raises is raised here. It is done no more
        where it was not.
        """
        work = self._waiting.pop(key, None)
        if work is not None and not work.cancel():
            work.result()


@cache
def _beside() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, initializer=lambda: setattr(_here, "shared", True))
