"""Unpacking of telemetry batches to ticks, many batches in one operation.

A batch contains a base value of each channel, then the differences (deltas) from tick to tick. The deltas of
one channel are 0, 2, 4, 8, 16 or 32 bits wide. Each delta is within the four bytes that begin at its first
byte, which form a word. Any number of batches can therefore be unpacked in four steps: gather the words,
shift them left to remove higher bits, shift them right to extend the sign, and sum up along time. Finally the
sign extension of unsigned channels is removed.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.declaration import CHANNELS, ChannelSpec, TelemetryMessage

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
    """Layout of a batch as far as it depends on the channels only.

    ``shape`` is the slice of a payload that determines its length: count and widths. For the base of each
    channel, ``offset`` (channels,) is its first byte, ``shift`` (channels,) the number of bits above it in a
    word, and ``bits`` (channels,) a mask of its bits: all 32 for a signed channel, because of its sign.
    """

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
    """Positions of the numbers in a batch, for one number of ticks and one set of widths.

    ``size`` is the length of the payload, -1 if count or widths are invalid. ``index`` (n, channels) is the
    first byte of the word of each number; ``left`` and ``right`` (n, channels) are the shifts that extract
    it.
    """

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
            shape = payload[self._layout.shape]
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
        valid_payloads.append(_PAD)
        joined = b"".join(valid_payloads)
        words = np.ndarray((len(joined) - 3,), "<u4", joined, strides=(1,))
        if len(plans) == 1:
            raw = _extract(words, plans[0].index, plans[0].left, plans[0].right)
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
    """Extract the numbers from 32-bit words, shape (n, channels).

    A shift to the left removes the higher bits; an arithmetic shift to the right removes the lower bits and
    extends the sign.
    """
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
