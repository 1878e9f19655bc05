"""Changes of the state that telemetry shows and no event told: the event was lost on the line.

An event is sent once. Telemetry carries the state, the fault and what led there with every tick, so one batch
that arrives says what a lost event would have said. The board sends an event before the batch with its tick:
what was not told by then never will be.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt

from heli_host.declaration import Channel, Event, EventMessage, Fault
from heli_host.link.channels import MODES
from heli_host.link.telemetry import Ticks

# Sixteen wait on the board at most.
_TOLD = 64
_TICK_MODULUS = 1 << 32
_WATCHED = [channel - MODES.start for channel in (Channel.STATE, Channel.TRIGGER, Channel.FAULT)]


class MissedEvents:
    """Compares telemetry with the events that arrived."""

    def __init__(self) -> None:
        self._told: deque[EventMessage] = deque(maxlen=_TOLD)
        self._tick: int | None = None
        self._row: npt.NDArray[np.int32] = np.zeros(MODES.stop - MODES.start, np.int32)

    def restart(self) -> None:
        """Forget everything: the board has started anew."""
        self._told.clear()
        self._tick = None

    def take_event(self, message: EventMessage) -> None:
        """Note an event that arrived."""
        if message.kind in (Event.STATE, Event.FAULT):
            self._told.append(message)

    def take_ticks(self, ticks: Ticks) -> list[EventMessage]:
        """Look through new samples.

        Parameters
        ----------
        ticks : Ticks
            In order, at least one; all events that came before them have been noted.

        Returns
        -------
        list of EventMessage
            What no event told, in order of time: changes of the state with what led to it, and faults, whose
            value is nan. Of changes between two samples that arrived only the last can be known, at the tick
            of the second.
        """
        modes = ticks.raw[:, MODES]  # (n, modes)
        if self._tick is None:
            self._row = modes[0]
        if (modes == self._row).all():
            self._tick = int(ticks.tick[-1])
            return []
        rows = modes[:, _WATCHED]  # (n, watched)
        before = np.vstack((self._row[_WATCHED], rows[:-1]))
        missed: list[EventMessage] = []
        for index in np.flatnonzero((rows != before).any(axis=1)).tolist():
            tick = int(ticks.tick[index])
            since = int(ticks.tick[index - 1]) if index else self._tick or 0
            state, trigger, fault = rows[index].tolist()
            state_before, trigger_before, fault_before = before[index].tolist()
            entered = (state, trigger) != (state_before, trigger_before)
            if entered and not self._was_told(Event.STATE, state, since, tick):
                missed.append(EventMessage(tick, Event.STATE, state, trigger, 0.0))
            tripped = fault not in (fault_before, Fault.NONE)
            if tripped and not self._was_told(Event.FAULT, fault, since, tick):
                missed.append(EventMessage(tick, Event.FAULT, fault, trigger, math.nan))
        self._tick, self._row = int(ticks.tick[-1]), modes[-1]
        return missed

    def _was_told(self, kind: Event, detail: int, since: int, tick: int) -> bool:
        span = (tick - since) % _TICK_MODULUS
        return any(
            told.kind == kind and told.detail == detail and (tick - told.tick) % _TICK_MODULUS < span
            for told in self._told
        )
