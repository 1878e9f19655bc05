"""Telemetry: batches of bytes become accepted ticks, losses are counted, and lost events are reconstructed.

Many batches are unpacked in one operation. The board sends each event once. Telemetry carries state, fault
and trigger with every tick, so the next batch shows what a lost event would have said. The board sends an
event before the batch with its tick: an event that has not arrived before that batch is lost.
"""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.declaration import (
    CHANNELS,
    Channel,
    ChannelSpec,
    Event,
    EventMessage,
    Fault,
    State,
    StatusMessage,
    TelemetryMessage,
)
from heli_host.link.channels import MODES, declared
from heli_host.link.clock import ClockFit
from heli_host.link.events import LinkEvent, event_kind, event_text

CHANNEL_COUNT = len(CHANNELS)

_HEADER_BYTES = TelemetryMessage.STRUCT.size
_COUNT_BYTE = _HEADER_BYTES - 1
_PAD = b"\0\0\0\0"
_WIDTH_BITS = np.array([0, 2, 4, 8, 16, 32], dtype=np.intp)
# A flight uses some tens of them; each takes 4 KiB.
_PLANS_KEPT = 512


@dataclass(frozen=True)
class Ticks:
    """Consecutive samples of the board, one row a tick; a gap in ``tick`` is a loss."""

    tick: npt.NDArray[np.uint32]  # (n,): Device time [tick of 1 ms]
    raw: npt.NDArray[np.int32]
    """(n, channels): Channels in the order of the declaration's ``CHANNELS``; multiply by their scale."""

    def __len__(self) -> int:
        return len(self.tick)


EMPTY_TICKS = Ticks(np.empty(0, np.uint32), np.empty((0, CHANNEL_COUNT), np.int32))


class _Layout:
    """Layout of a batch as far as it depends on the channels only."""

    # ``shape`` is the slice of a payload that determines its length: count and widths. For the base of each
    # channel, ``offset`` (channels,) is its first byte, ``shift`` (channels,) the number of bits above it in
    # a word, and ``bits`` (channels,) a mask of its bits: all 32 for a signed channel, because of its sign.

    def __init__(self, channels: Sequence[ChannelSpec]) -> None:
        sizes = [struct.calcsize(channel.code) for channel in channels]
        bases_start = _HEADER_BYTES + (len(channels) + 1) // 2
        unsigned = [channel.code.isupper() for channel in channels]
        self.channels = len(channels)
        self.shape = slice(_COUNT_BYTE, bases_start)
        self.deltas_start = bases_start + sum(sizes)
        self.offset = np.cumsum((bases_start, *sizes[:-1]))
        self.shift = np.array([32 - 8 * size for size in sizes])
        all_bits = np.full(self.channels, 0xFFFFFFFF, np.uint32)
        self.bits = np.where(unsigned, all_bits >> self.shift.astype(np.uint32), all_bits).view(np.int32)


@dataclass(frozen=True)
class _Plan:
    """Positions of the numbers in a batch, for one number of ticks and one set of widths."""

    # ``size`` is the length of the payload, -1 if count or widths are invalid. ``index`` (n, channels) is the
    # first byte of the word of each number; ``left`` and ``right`` (n, channels) are the shifts that extract
    # it.

    size: int
    index: npt.NDArray[np.intp]
    left: npt.NDArray[np.uint32]
    right: npt.NDArray[np.int32]


class TelemetryDecoder:
    """Unpacks telemetry payloads."""

    def __init__(self, channels: Sequence[ChannelSpec] = CHANNELS) -> None:
        self.malformed = 0
        self._layout = _Layout(channels)
        self._plans: dict[bytes, _Plan] = {}

    def decode(self, payloads: Sequence[bytes]) -> Ticks:
        """Unpack batches."""
        plans: list[_Plan] = []
        valid_payloads: list[bytes] = []
        for payload in payloads:
            shape = payload[self._layout.shape]  # the bytes with the count of ticks and the widths
            plan = self._plans.get(shape)
            if plan is None:
                plan = self._plan_of_new_shape(shape)
            if plan.size == len(payload):
                plans.append(plan)
                valid_payloads.append(payload)
            else:
                self.malformed += 1
        if not plans:
            return EMPTY_TICKS
        # The words of 32 bits that begin at each byte, because numbers do; the last ones reach into the pad.
        joined = b"".join([*valid_payloads, _PAD])
        words = np.ndarray((len(joined) - 3,), "<u4", joined, strides=(1,))
        if len(plans) == 1:
            # The quick way for one batch, which most readings have.
            (plan,) = plans
            raw = _extract(words, plan.index, plan.left, plan.right)
            raw[0] &= self._layout.bits
            raw.cumsum(axis=0, dtype=np.int32, out=raw)
            return Ticks(words[0] + np.arange(len(raw), dtype=np.uint32), raw)
        return _unpack(words, plans, self._layout)

    def _plan_of_new_shape(self, shape: bytes) -> _Plan:
        """Compute the positions in a batch of a new shape, and keep them."""
        if len(self._plans) >= _PLANS_KEPT:
            self._plans.clear()
        plan = self._plans[shape] = _unpacking_plan(shape, self._layout)
        return plan


def _unpacking_plan(shape: bytes, layout: _Layout) -> _Plan:
    """Compute the positions of the numbers in a batch from its count and widths, `shape`."""
    # Two channels share a byte: each has a code of four bits for the width of its differences.
    codes = [nibble for byte in shape[1:] for nibble in (byte & 15, byte >> 4)][: layout.channels]
    if len(codes) < layout.channels or shape[0] == 0 or max(codes) >= len(_WIDTH_BITS):
        # No payload has this size, so that each batch with these widths counts as malformed.
        empty = np.empty((0, layout.channels))
        return _Plan(-1, empty.astype(np.intp), empty.astype(np.uint32), empty.astype(np.int32))
    count = shape[0]
    width_bits = _WIDTH_BITS[codes]  # (channels,)
    # First byte behind the differences of each channel, (channels,); they begin at a whole byte.
    end_byte = layout.deltas_start + np.cumsum((width_bits * (count - 1) + 7) >> 3)
    # Position of each difference within those of its channel, (n - 1, channels).
    bit_position = width_bits * np.arange(count - 1)[:, None]
    first_byte = np.concatenate(([layout.deltas_start], end_byte[:-1]))
    # A number is cut out of the 32 bits at its byte: a shift to the left discards the bits behind it, a shift
    # to the right those before it, and extends the sign. The first row is that of the absolute numbers.
    right = np.vstack((layout.shift, np.broadcast_to(32 - width_bits, bit_position.shape)))
    left = np.vstack((layout.shift, 32 - width_bits - (bit_position & 7)))
    index = np.vstack((layout.offset, first_byte + (bit_position >> 3)))
    return _Plan(int(end_byte[-1]), index, left.astype(np.uint32), right.astype(np.int32))


def _extract(
    words: npt.NDArray[np.uint32],
    index: npt.NDArray[np.intp],
    left: npt.NDArray[np.uint32],
    right: npt.NDArray[np.int32],
) -> npt.NDArray[np.int32]:
    """Extract the numbers from 32-bit words, shape (n, channels)."""
    # A shift to the left removes the higher bits; an arithmetic shift to the right removes the lower bits and
    # extends the sign.
    # Unlike in C, a shift by 32 is defined in numpy: a delta of 0 bits becomes 0.
    return np.asarray((words.take(index) << left).view(np.int32) >> right)


def _unpack(words: npt.NDArray[np.uint32], plans: Sequence[_Plan], layout: _Layout) -> Ticks:
    """Unpack batches of telemetry of one reading together: n samples in f batches. Each batch has the
    absolute numbers of its first sample, then differences.
    """
    size = np.array([plan.size for plan in plans])  # (f,)
    count = np.array([len(plan.index) for plan in plans])  # (f,)
    first_byte = np.cumsum(size) - size  # (f,), first byte of each batch
    first_row = np.cumsum(count) - count  # (f,), first row of each batch
    index = np.concatenate([plan.index for plan in plans])  # (n, channels)
    index += np.repeat(first_byte, count)[:, None]
    raw = _extract(
        words,
        index,
        np.concatenate([plan.left for plan in plans]),
        np.concatenate([plan.right for plan in plans]),
    )
    raw[first_row] &= layout.bits
    # Each base is an absolute number, so the sum of the previous batches is subtracted from it first.
    raw[first_row[1:]] -= np.add.reduceat(raw, first_row, axis=0, dtype=np.int32)[:-1]
    raw.cumsum(axis=0, dtype=np.int32, out=raw)
    first_tick = words.take(first_byte) - first_row.astype(np.uint32)
    tick = np.repeat(first_tick, count) + np.arange(len(raw), dtype=np.uint32)
    return Ticks(tick, raw)


_TICK_MODULUS = 1 << 32


@dataclass(frozen=True)
class LinkCounters:
    """Counts of a session, from the first welcome on."""

    frames_ok: int = 0  # Frames from the board that passed every check
    frames_bad: int = 0
    """Frames refused: COBS, length, CRC, protocol, or telemetry whose length does not fit or whose
    enumerations have values that are not declared."""
    frames_lost: int = 0  # Gaps in the board's sequence numbers
    bytes_received: int = 0  # All bytes that arrived
    bytes_dropped: int = 0  # Bytes that belong to no accepted frame
    retries: int = 0  # Commands sent again because no answer came in time
    reconnects: int = 0  # Times that the link was lost, or the board fell silent, and came back
    restarts: int = 0  # Number of restarts of the board during the session
    ticks_received: int = 0  # Samples delivered
    ticks_lost: int = 0
    """Samples missing between those delivered; a restart of the board ends the counting before it."""
    setpoints_sent: int = 0  # setpoints_sent, voltages_sent: Streamed values that were sent
    setpoints_skipped: int = 0
    """setpoints_skipped, voltages_skipped: Streamed values that a newer value replaced before the rate limit
    permitted them to be sent."""
    voltages_sent: int = 0
    voltages_skipped: int = 0
    board: StatusMessage | None = None  # The newest counters that the board sent


class TickAccount:
    """Follows the tick numbers of a session."""

    def __init__(self) -> None:
        self.received = 0
        self.lost = 0
        self._last: int | None = None

    @property
    def last(self) -> int | None:
        """Newest tick, counted on over 2^32; None before the first and after a restart."""
        return self._last

    def restart(self) -> None:
        """Accept the next tick without a check of its number, because the board has restarted."""
        self._last = None

    def unwrap(self, tick: int) -> int:
        """Return a device tick without the wrap at 2^32."""
        if self._last is None:
            return tick
        half_range = _TICK_MODULUS // 2
        return self._last + (tick - self._last + half_range) % _TICK_MODULUS - half_range

    def take(self, ticks: Ticks) -> tuple[Ticks, bool]:
        """Count samples. Return those before a tick that jumps back, and whether there is such a tick."""
        if len(ticks) == 0:
            return ticks, False
        first, final = int(ticks.tick[0]), int(ticks.tick[-1])
        before = self._last if self._last is not None else first - 1
        # If first and last tick and their distance are right, no tick is missing. Only a restart and a loss
        # that compensate each other exactly within one reading would not be noticed.
        if (first - before) % _TICK_MODULUS == 1 and (final - first) % _TICK_MODULUS == len(ticks) - 1:
            self.received += len(ticks)
            self._last = before + len(ticks)
            return ticks, False
        # As signed numbers, steps are right across the wrap at 2^32, shape (n,).
        steps = np.diff(ticks.tick, prepend=np.uint32(before % _TICK_MODULUS)).astype(np.int32)
        has_jumped_back = bool(steps.min() <= 0)
        if has_jumped_back:
            accepted_count = int(np.argmax(steps <= 0))
            if accepted_count == 0:
                return EMPTY_TICKS, True
            ticks = Ticks(ticks.tick[:accepted_count], ticks.raw[:accepted_count])
            steps = steps[:accepted_count]
        elapsed_ticks = int(steps.sum())
        self.received += len(ticks)
        self.lost += elapsed_ticks - len(ticks)
        self._last = before + elapsed_ticks
        return ticks, has_jumped_back


_MAX_ARRIVED_EVENTS = 64
"""Number of arrived events that are remembered; the board queues at most 16."""
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
        """Return the events that new samples imply and that have not arrived."""
        # `ticks`: At least one sample, in order. All events that arrived before them must have been recorded.
        modes = ticks.raw[:, MODES]  # (n, modes)
        if self._tick is None:
            self._row = modes[0]  # nothing is known about what was before it
        if (modes == self._row).all():
            self._tick = int(ticks.tick[-1])
            return []  # nearly always
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
                missed.append(EventMessage(tick, kind=Event.STATE, detail=state, cause=trigger, value=0.0))
            is_new_fault = fault not in (fault_before, Fault.NONE)
            if is_new_fault and not self._has_arrived(Event.FAULT, fault, tick_before, tick):
                missed.append(
                    EventMessage(tick, kind=Event.FAULT, detail=fault, cause=trigger, value=math.nan)
                )
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


_HELD_BATCHES = 500


@dataclass(frozen=True)
class AcceptedTelemetry:
    """Contents of the batches that were held."""

    ticks: Ticks  # Accepted samples, in order
    missed: list[EventMessage]  # Events that the samples imply and that have not arrived, in order of time
    jumped_back: bool  # True if the tick number fell, because the board restarted


class TelemetryReceiver:
    """Telemetry of one session."""

    # Part of an `Engine`: its callers serialise all calls. `latest_raw` has shape (channels,).
    # It owns the newest sample, the count of ticks, and the clock that relates device time to host time.

    def __init__(self) -> None:
        self.account = TickAccount()
        self.clock = ClockFit()
        self.latest_raw: npt.NDArray[np.int32] | None = None
        self._missed = MissedEvents()
        self._decoder = TelemetryDecoder()
        self._waiting_payloads: list[bytes] = []
        self._undeclared = 0

    @property
    def malformed(self) -> int:
        """Number of frames that passed their CRC and are no telemetry of this declaration."""
        return self._undeclared + self._decoder.malformed

    @property
    def state(self) -> State | None:
        """Supervisor state in the newest sample; None before the first, and for one unknown to this host."""
        if self.latest_raw is None:
            return None
        state = State._value2member_map_.get(int(self.latest_raw[Channel.STATE]))
        return state if isinstance(state, State) else None

    @property
    def speed(self) -> float:
        """Device seconds per host second, at least 1; a fast simulation shortens all intervals."""
        estimate = self.clock.estimate()
        return 1.0 if estimate is None else max(estimate.rate, 1.0)

    def is_behind(self, tick: int) -> bool:
        """Whether a tick from the board is lower than the newest one accepted."""
        return self.account.last is not None and self.account.unwrap(tick) < self.account.last

    def hold(self, payload: bytes) -> None:
        """Hold one batch until `accept_held`."""
        self._waiting_payloads.append(payload)

    def shorten_held(self) -> None:
        """Keep only the newest batches while no session is open."""
        del self._waiting_payloads[:-_HELD_BATCHES]

    def discard_held(self) -> None:
        """Discard the held batches, because they are older than the session."""
        self._waiting_payloads.clear()

    def restart(self) -> None:
        """Begin again with the next sample, because the board has restarted."""
        self._waiting_payloads.clear()
        self.account.restart()
        self._missed.restart()
        self.clock.reset()
        self.latest_raw = None

    def take_event(self, message: EventMessage) -> None:
        """Record an event that arrived, so that it is not reconstructed from samples."""
        self._missed.take_event(message)

    def accept_held(self, now_s: float) -> AcceptedTelemetry | None:
        """Turn the held batches into samples; None if there are no batches."""
        if not self._waiting_payloads:
            return None
        ticks = self._decoder.decode(self._waiting_payloads)
        self._waiting_payloads.clear()
        if self.latest_raw is None or (ticks.raw[:, MODES] != self.latest_raw[MODES]).any():
            ticks = self._without_undeclared(ticks)
        accepted, jumped_back = self.account.take(ticks)
        if not len(accepted):
            return AcceptedTelemetry(EMPTY_TICKS, [], jumped_back)
        self.latest_raw = accepted.raw[-1]
        self.clock.observe(self.account.last or 0, now_s)
        return AcceptedTelemetry(accepted, self._missed.take_ticks(accepted), jumped_back)

    def _without_undeclared(self, ticks: Ticks) -> Ticks:
        """Return the samples whose enumerations have declared values only."""
        # Other samples were corrupted on the board before their CRC was computed. Each run of such samples
        # counts as one malformed frame.
        is_declared = declared(ticks.raw)
        if is_declared.all():
            return ticks
        self._undeclared += int(np.count_nonzero(np.diff(is_declared.view(np.int8), prepend=np.int8(1)) < 0))
        return Ticks(ticks.tick[is_declared], ticks.raw[is_declared])
