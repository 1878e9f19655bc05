"""Reconstructs events that were lost on the line from the telemetry.

The board sends each event once. Telemetry carries state, fault and trigger with every tick, so the next batch
shows what a lost event would have said. The board sends an event before the batch with its tick: an event
that has not arrived before that batch is lost.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
import numpy.typing as npt

from heli_host.declaration import Channel, Event, EventMessage, Fault
from heli_host.link.channels import MODES
from heli_host.link.events import LinkEvent, event_kind, event_text
from heli_host.link.telemetry import Ticks

_MAX_ARRIVED_EVENTS = 64
"""Number of arrived events that are remembered; the board queues at most 16."""
_TICK_MODULUS = 1 << 32
"""The board's tick counter has 32 bits, and starts again at 0 after 2^32 ticks of 1 ms."""
_WATCHED_COLUMNS = [channel - MODES.start for channel in (Channel.STATE, Channel.TRIGGER, Channel.FAULT)]
"""Columns of state, trigger and fault among the channels `MODES`."""


class MissedEvents:
    """Compares telemetry with the events that arrived."""

    def __init__(self) -> None:
        self._arrived: deque[EventMessage] = deque(maxlen=_MAX_ARRIVED_EVENTS)
        self._tick: int | None = None
        self._row: npt.NDArray[np.int32] = np.zeros(MODES.stop - MODES.start, np.int32)

    def restart(self) -> None:
        """Forget everything, because the board has restarted."""
        self._arrived.clear()
        self._tick = None

    def take_event(self, message: EventMessage) -> None:
        """Record an event that arrived."""
        if message.kind in (Event.STATE, Event.FAULT):
            self._arrived.append(message)

    def take_ticks(self, ticks: Ticks) -> list[EventMessage]:
        """Return the events that new samples imply and that have not arrived.

        `ticks`: At least one sample, in order. All events that arrived before them must have been recorded.
        """
        modes = ticks.raw[:, MODES]  # (n, modes)
        if self._tick is None:
            self._row = modes[0]
        if (modes == self._row).all():
            self._tick = int(ticks.tick[-1])
            return []
        rows = modes[:, _WATCHED_COLUMNS]  # (n, 3)
        before = np.vstack((self._row[_WATCHED_COLUMNS], rows[:-1]))
        missed: list[EventMessage] = []
        for index in np.flatnonzero((rows != before).any(axis=1)).tolist():
            tick = int(ticks.tick[index])
            tick_before = int(ticks.tick[index - 1]) if index else self._tick or 0
            state, trigger, fault = rows[index].tolist()
            state_before, trigger_before, fault_before = before[index].tolist()
            is_new_state = (state, trigger) != (state_before, trigger_before)
            if is_new_state and not self._has_arrived(Event.STATE, state, tick_before, tick):
                missed.append(EventMessage(tick, Event.STATE, state, trigger, 0.0))
            is_new_fault = fault not in (fault_before, Fault.NONE)
            if is_new_fault and not self._has_arrived(Event.FAULT, fault, tick_before, tick):
                missed.append(EventMessage(tick, Event.FAULT, fault, trigger, math.nan))
        self._tick, self._row = int(ticks.tick[-1]), modes[-1]
        return missed

    def _has_arrived(self, kind: Event, detail: int, tick_before: int, tick: int) -> bool:
        """Whether such an event arrived whose tick is after `tick_before`, and not after `tick`."""
        span_ticks = (tick - tick_before) % _TICK_MODULUS
        return any(
            event.kind == kind and event.detail == detail and (tick - event.tick) % _TICK_MODULUS < span_ticks
            for event in self._arrived
        )


def insert_missed(message: EventMessage, wall_ns: int, events: list[LinkEvent]) -> None:
    """Insert a reconstructed event before the events that happened later."""
    text = f"{event_text(message)}; from telemetry, its event was lost"
    event = LinkEvent(message.tick, wall_ns, event_kind(message), text, message)
    for index, other in enumerate(events):
        # An event without a message comes from the link; its tick is only the newest one at that time.
        if other.message is not None and _is_later(other.tick, message.tick):
            events.insert(index, event)
            return
    events.append(event)


def _is_later(tick: int, reference_tick: int) -> bool:
    """Whether a tick is after another one, by less than half a turn of the 32-bit counter."""
    return 0 < (tick - reference_tick) % _TICK_MODULUS < _TICK_MODULUS // 2
