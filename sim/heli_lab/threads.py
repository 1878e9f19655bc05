"""Work shared out to threads: filters, programs and arithmetic on arrays leave Python's lock."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
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
    other_works: Callable[[], bool] | None = None
    """Whether there is another thread that this one shares the machine with, and it has something to do."""

    @property
    def alone(self) -> bool:
        """Whether this thread is to do its work by itself."""
        return self.shared or (self.other_works is not None and self.other_works())


_here = _Here()


def default_thread_count() -> int:
    """Threads of a work that was not told how many: two, or one where ``OMP_NUM_THREADS`` is 1, which is how
    one says that other processes have the other cores.
    """
    if _here.alone:
        return 1
    if _here.threads is not None:
        return _here.threads
    return 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2


def limit_malloc_arenas() -> None:
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


def parallel_map(work: Callable[[_Item], _T], items: Sequence[_Item], threads: int | None = None) -> list[_T]:
    """Do `work` on each of some items, by several threads, and return what it made of each in their order.
    A share of a work is not shared out again.

    Parameters
    ----------
    work : callable
        Called with an item, by any thread; what it raises is raised here.
    items : sequence
        What to work on.
    threads : int, optional
        Threads, 1 or more; `default_thread_count` where not given.
    """
    threads = default_thread_count() if threads is None else threads
    if threads == 1 or len(items) < 2 or _here.alone:
        return [work(item) for item in items]
    return list(_pool(threads).map(work, items))


class Prefetcher:
    """Works that will be asked for one after the other, done by a thread beside from the last one on: it and
    whoever asks meet in the middle. They must not depend on each other. While one of the two has nothing to
    do, the other shares out its work.
    """

    def __init__(self) -> None:
        self._waiting: dict[str, Future[object]] = {}
        self._awaited = threading.Event()

    @contextmanager
    def working(self, works: Mapping[str, Callable[[], object]]) -> Iterator[None]:
        """Begin these `works`, by key, and end what was not asked for with the block. Where there is no
        second thread nothing is done ahead.
        """
        if default_thread_count() < 2 or len(works) < 2 or _here.other_works is not None:
            yield
            return
        threads = default_thread_count()
        self._waiting = {
            key: _beside().submit(self._beside_whoever_asks, work, threads)
            for key, work in reversed(list(works.items()))
        }
        _here.other_works = lambda: self.left
        try:
            yield
        finally:
            # All are waited for, whatever one of them raises.
            with ExitStack() as stack:
                stack.callback(setattr, _here, "other_works", None)
                for key in self._waiting:
                    stack.callback(self.wait_for, key)

    def wait_for(self, key: str) -> None:
        """Wait for the work of a `key` if it was begun; what it raises is raised here. It is done no more
        where it was not.
        """
        work = self._waiting.pop(key, None)
        if work is not None and not work.cancel():
            self._awaited.set()
            try:
                work.result()
            finally:
                self._awaited.clear()

    @property
    def left(self) -> bool:
        """Whether the thread beside has something to do."""
        return any(not work.done() for work in self._waiting.values())

    def _beside_whoever_asks(self, work: Callable[[], object], threads: int) -> object:
        _here.other_works = lambda: not self._awaited.is_set()
        with using_threads(threads):
            return work()


@cache
def _beside() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)
