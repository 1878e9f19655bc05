"""Ctrl-C, SIGTERM and SIGHUP during a flight: none is lost, none interrupts a stop or the end of a log."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from types import FrameType, TracebackType
from typing import Any, Self

CTRL_C = "Ctrl-C"
_NAMES = ("SIGINT", "SIGTERM", "SIGHUP")
_INTERRUPTED = tuple(f"aborted: {name}" for name in (CTRL_C, *_NAMES))


_interrupted = threading.Event()


def flight_was_interrupted() -> bool:
    """Whether a signal has ended a flight, or its landing, in this process."""
    return _interrupted.is_set()


def name_of(error: KeyboardInterrupt) -> str:
    """Return the name of the signal that caused an interrupt, ``Ctrl-C`` for SIGINT."""
    name = str(error.args[0]) if error.args else CTRL_C
    return CTRL_C if name == "SIGINT" else name


def was_interrupted(outcome: str) -> bool:
    """Whether an interrupt ended a flight."""
    return outcome.startswith(_INTERRUPTED)


class Interrupts:
    """Replaces the handlers of SIGINT, SIGTERM and SIGHUP while a ``with`` block runs."""

    # The first signal raises KeyboardInterrupt in the main thread. `allow_one_more` permits one further. All
    # others are only recorded, because they would interrupt what the first one started: the stop of the
    # motors, or the end of the log. Signals without a handler keep their default. In another thread than the
    # main thread nothing is replaced.

    def __init__(self) -> None:
        self._names: list[str] = []
        self._raised = 0
        self._raises_left = 1
        self._shielded = False
        self._before: dict[signal.Signals, Callable[[int, FrameType | None], Any]] = {}

    def __enter__(self) -> Self:
        # Python accepts new handlers in the main thread only. Windows lacks some of the signals, and a signal
        # without a handler in Python is not callable: it keeps its default.
        if threading.current_thread() is threading.main_thread():
            for name in _NAMES:
                number = getattr(signal.Signals, name, None)
                handler = signal.getsignal(number) if number is not None else None
                if number is not None and callable(handler):
                    self._before[number] = handler
                    signal.signal(number, self._remember_and_raise)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    @property
    def remembered(self) -> list[str]:
        """Names of the signals that arrived and raised nothing, in order."""
        return self._names[self._raised :]

    def allow_one_more(self) -> None:
        """Let the next signal raise KeyboardInterrupt; raise immediately if one has arrived meanwhile."""
        self._raises_left = 1
        self._raise_remembered()

    def allow_no_more(self) -> None:
        """Only record the signals that arrive from now on."""
        self._raises_left = 0

    @contextlib.contextmanager
    def shielded(self) -> Iterator[None]:
        """Delay a signal that arrives in this ``with`` block to its end."""
        self._shielded = True
        try:
            yield
        finally:
            self._shielded = False
        self._raise_remembered()

    def _remember_and_raise(self, number: int, frame: FrameType | None) -> None:
        """Record a signal, and raise KeyboardInterrupt if this is permitted now."""
        self._names.append(CTRL_C if number == signal.SIGINT else signal.Signals(number).name)
        # A handler may have more to do than to raise.
        with contextlib.suppress(KeyboardInterrupt):
            self._before[signal.Signals(number)](number, frame)
        if not self._shielded:
            self._raise_remembered()

    def _raise_remembered(self) -> None:
        """Raise KeyboardInterrupt for a recorded signal, as often as permitted."""
        if self._raises_left and self.remembered:
            self._raises_left -= 1
            self._raised += 1
            _interrupted.set()
            raise KeyboardInterrupt(self._names[self._raised - 1])
