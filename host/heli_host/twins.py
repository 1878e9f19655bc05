"""A twin beside a flight: a model of the rig that says when the rig is no longer what it was.

Nothing here knows a model. A package that does offers a function in the entry-point group
``heli_host.twins``; what it makes is fed with every tick, in a thread of its own, so that it holds nothing
up.
"""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Final, Protocol

from heli_host.errors import HeliError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from heli_host.link.session import Session
    from heli_host.link.telemetry import Ticks

ENTRY_POINT_GROUP: Final = "heli_host.twins"
PARTED: Final = "parted"
"""Kind of the news that the rig is no longer the rig."""
EVENT: Final = "twin"
"""Kind of the log's events that a twin causes."""
HOURS: Final = 10.0
"""Free flight in which one false alarm is allowed, h."""


@dataclass(frozen=True)
class TwinNews:
    """Something that a twin says.

    Parameters
    ----------
    kind : str
        ``free``, ``waits``, ``parted`` or ``named``.
    tick : int
        Device time [tick], counted on.
    text : str
        For a person.
    """

    kind: str
    tick: int
    text: str


class LiveTwin(Protocol):
    """What a package makes that knows models."""

    def take(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> Sequence[TwinNews]:
        """Take ticks in, and say what there is to say.

        Parameters
        ----------
        tick : ndarray of int64, shape (n,)
            Device time [tick], counted on over 2^32.
        raw : ndarray of int32, shape (n, channels)
            Raw numbers in the order of the declaration's ``CHANNELS``.
        """
        ...

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel of the twin that flew by itself for a moment; None where it does not
        fly.
        """
        ...

    def words(self) -> str:
        """What it does or has found, in one line."""
        ...


TwinMaker = Callable[[Mapping[str, float], float], LiveTwin]
"""Makes a twin for a board's parameters, with one false alarm in so many hours of free flight."""
TwinOpener = Callable[[str], TwinMaker]


def open_twin(name: str) -> TwinMaker:
    """Read what a twin is made of, before there is a board.

    Parameters
    ----------
    name : str
        Name of a rig, path of its file, or of a twin's file.

    Raises
    ------
    HeliError
        No package offers twins, or there is no such rig.
    """
    for entry in entry_points(group=ENTRY_POINT_GROUP):
        opener: TwinOpener = entry.load()
        return opener(name)
    raise HeliError("no installed package provides twins", "install heli-host with the package heli_lab")


class TwinWatch:
    """Feeds a twin from a session, and hands on what it says.

    In lockstep it is fed where the ticks come, so that a simulated flight is the same every time; else in a
    thread of its own.

    Parameters
    ----------
    session : Session
        Connected.
    twin : LiveTwin
        Made by what `open_twin` returns.
    on_change : callable, optional
        Called once, from that thread, when the rig is no longer the rig.

    Attributes
    ----------
    parted : str
        What the twin said when it parted, empty until then.
    trouble : str
        Why it no longer follows, if it does not.
    """

    def __init__(self, session: Session, twin: LiveTwin, on_change: Callable[[], None] | None = None) -> None:
        self.parted = ""
        self.trouble = ""
        self._session, self._twin, self._on_change = session, twin, on_change
        self._listeners: list[Callable[[TwinNews], None]] = []
        self._queue: queue.SimpleQueue[tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]] | None] = (
            queue.SimpleQueue()
        )
        self._thread: threading.Thread | None = None
        if not session.lockstep:
            self._thread = threading.Thread(target=self._run, name="twin", daemon=True)
            self._thread.start()
        self._unsubscribe = session.subscribe_ticks(self._take_ticks)

    def listen(self, listener: Callable[[TwinNews], None]) -> None:
        """Have news told, from the thread that feeds the twin.

        Parameters
        ----------
        listener : callable taking TwinNews
            Is told.
        """
        self._listeners.append(listener)

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel of the ghost; None where there is none."""
        return self._twin.ghost_rad() if not self.trouble else None

    def words(self) -> str:
        """What the twin does or has found, in one line."""
        return self.trouble or self._twin.words()

    def close(self) -> None:
        """End, after what has come is taken in."""
        self._unsubscribe()
        if self._thread is not None:
            self._queue.put(None)
            self._thread.join(5.0)
            self._thread = None

    def _take_ticks(self, ticks: Ticks) -> None:
        tick = self._session.ticks_counted_on(ticks)
        if self._thread is None:
            self._feed(tick, ticks.raw)
        else:
            self._queue.put((tick, ticks.raw))

    def _run(self) -> None:
        while (part := self._queue.get()) is not None:
            self._feed(*part)

    def _feed(self, tick: npt.NDArray[np.int64], raw: npt.NDArray[np.int32]) -> None:
        if self.trouble:
            return
        try:
            said = self._twin.take(tick, raw)
        except (ArithmeticError, ValueError, HeliError) as error:
            # A twin that fails must not end the flight that it watches.
            self.trouble = f"the twin failed and no longer follows: {error}"
            said = [TwinNews("failed", int(tick[-1]) if len(tick) else 0, self.trouble)]
        for news in said:
            first = news.kind == PARTED and not self.parted
            if first:
                self.parted = news.text
            for listener in self._listeners:
                listener(news)
            if first and self._on_change is not None:
                self._on_change()
