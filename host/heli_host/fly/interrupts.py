"""Ctrl-C, and the signals that mean the same, while something flies: each counts, none comes in between."""

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


def name_of(error: KeyboardInterrupt) -> str:
    """Return what interrupted: ``Ctrl-C``, or the name of a signal.

    Parameters
    ----------
    error : KeyboardInterrupt
        As raised; its handler may have given it the name of the signal.
    """
    name = str(error.args[0]) if error.args else CTRL_C
    return CTRL_C if name == "SIGINT" else name


def was_interrupted(outcome: str) -> bool:
    """Whether a flight was ended by its user.

    Parameters
    ----------
    outcome : str
        Of the flight, in one line.
    """
    return outcome.startswith(_INTERRUPTED)


class Interrupts:
    """Takes the place of the handlers that raise KeyboardInterrupt; a context manager.

    One signal is raised; `allow_one_more` lets another through. What comes besides is only remembered: it
    could but break off what the others have begun, a stop of the motors or the last lines of a log. Signals
    that nobody handles are left alone, and so are all where this is not the main thread.
    """

    def __init__(self) -> None:
        self._names: list[str] = []
        self._raised = 0
        self._left = 1
        self._shielded = False
        self._before: dict[signal.Signals, Callable[[int, FrameType | None], Any]] = {}

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for name in _NAMES:
                number = getattr(signal.Signals, name, None)
                handler = signal.getsignal(number) if number is not None else None
                if number is not None and callable(handler):
                    self._before[number] = handler
                    signal.signal(number, self._take)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    @property
    def remembered(self) -> list[str]:
        """Names of the signals that were not raised, in order."""
        return self._names[self._raised :]

    def allow_one_more(self) -> None:
        """Raise the next signal, or now one that has come meanwhile."""
        self._left = 1
        self._catch_up()

    def allow_no_more(self) -> None:
        """Only remember what comes from now on."""
        self._left = 0

    @contextlib.contextmanager
    def shielded(self) -> Iterator[None]:
        """Raise what comes in this block at its end."""
        self._shielded = True
        try:
            yield
        finally:
            self._shielded = False
        self._catch_up()

    def _take(self, number: int, frame: FrameType | None) -> None:
        self._names.append(CTRL_C if number == signal.SIGINT else signal.Signals(number).name)
        # A handler may have more to do than to raise.
        with contextlib.suppress(KeyboardInterrupt):
            self._before[signal.Signals(number)](number, frame)
        if not self._shielded:
            self._catch_up()

    def _catch_up(self) -> None:
        if self._left and self.remembered:
            self._left -= 1
            self._raised += 1
            raise KeyboardInterrupt(self._names[self._raised - 1])
