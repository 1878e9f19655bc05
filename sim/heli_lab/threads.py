"""Parallel work in threads: filters, compiled programs and array arithmetic release Python's lock."""

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
"""Constant M_ARENA_MAX of glibc's malloc.h."""
_T = TypeVar("_T")
_Item = TypeVar("_Item")


class _ThreadState(threading.local):
    is_worker = False
    """Whether this is a worker thread of `parallel_map`, which starts no further threads."""
    threads: int | None = None
    is_other_busy: Callable[[], bool] | None = None
    """Returns whether the other thread of a `Prefetcher` is busy; None outside of one."""

    @property
    def is_serial(self) -> bool:
        """Whether this thread must not start further threads."""
        return self.is_worker or (self.is_other_busy is not None and self.is_other_busy())


_state = _ThreadState()


def default_thread_count() -> int:
    """Return the default number of threads: two, or one if ``OMP_NUM_THREADS`` is 1.

    That setting states that other processes use the other cores.
    """
    if _state.is_serial:
        return 1
    if _state.threads is not None:
        return _state.threads
    return 1 if os.environ.get("OMP_NUM_THREADS") == "1" else 2


def limit_malloc_arenas() -> None:
    """Make all threads share one heap if the C library is glibc, to save memory.

    By default each thread has a heap, and other threads cannot use what it frees. The memory of a diagnosis
    of ten minutes at 1 kHz was 0.58 GB, and 0.49 GB with one heap; of one minute 0.27 GB and 0.19 GB. Only a
    program may call this, before it starts threads.
    """
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).mallopt(_ARENA_MAX, 1)


@contextmanager
def using_threads(threads: int | None) -> Iterator[None]:
    """Set the default number of `threads`, 1 or more, inside of this block; None changes nothing."""
    before = _state.threads
    _state.threads = before if threads is None else threads
    try:
        yield
    finally:
        _state.threads = before


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(threads, initializer=lambda: setattr(_state, "is_worker", True))


def parallel_map(work: Callable[[_Item], _T], items: Sequence[_Item], threads: int | None = None) -> list[_T]:
    """Call `work` with each item in several threads, and return the results in the order of the items.

    Calls from a worker thread are serial.

    Parameters
    ----------
    work : callable
        Called with an item, in any thread; its exceptions are raised here.
    items : sequence
        Arguments.
    threads : int, optional
        Number of threads, 1 or more; by default `default_thread_count`.
    """
    threads = default_thread_count() if threads is None else threads
    if threads == 1 or len(items) < 2 or _state.is_serial:
        return [work(item) for item in items]
    return list(_pool(threads).map(work, items))


class Prefetcher:
    """Second thread that computes independent tasks in reverse order, while the caller needs them in order.

    The two threads meet in the middle. While one of them is idle, `parallel_map` in the other uses both
    cores.
    """

    def __init__(self) -> None:
        self._pending: dict[str, Future[object]] = {}
        self._is_awaited = threading.Event()

    @contextmanager
    def working(self, tasks: Mapping[str, Callable[[], object]]) -> Iterator[None]:
        """Start `tasks`, by key, in the second thread; the end of the block waits for all that have started.

        With a single thread, nothing is computed in advance.
        """
        if default_thread_count() < 2 or len(tasks) < 2 or _state.is_other_busy is not None:
            yield
            return
        threads = default_thread_count()
        self._pending = {
            key: _second_thread().submit(self._run_task, task, threads)
            for key, task in reversed(list(tasks.items()))
        }
        _state.is_other_busy = lambda: self.is_busy
        try:
            yield
        finally:
            # Wait for every task, even if one of them raises.
            with ExitStack() as stack:
                stack.callback(setattr, _state, "is_other_busy", None)
                for key in self._pending:
                    stack.callback(self.wait_for, key)

    def wait_for(self, key: str) -> None:
        """Wait for the task of a `key` if it has started, and raise its exception; cancel it otherwise."""
        task = self._pending.pop(key, None)
        if task is not None and not task.cancel():
            self._is_awaited.set()
            try:
                task.result()
            finally:
                self._is_awaited.clear()

    @property
    def is_busy(self) -> bool:
        """Whether the second thread has unfinished tasks."""
        return any(not task.done() for task in self._pending.values())

    def _run_task(self, task: Callable[[], object], threads: int) -> object:
        _state.is_other_busy = lambda: not self._is_awaited.is_set()
        with using_threads(threads):
            return task()


@cache
def _second_thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1)
