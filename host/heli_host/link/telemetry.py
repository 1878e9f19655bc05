"""Unpacking of telemetry batches to ticks, many batches in one operation.

The deltas of one channel are 2, 4, 8, 16 or 32 bits wide and start on a byte, so each of them lies inside the
four bytes that begin at its own first byte. One gather of such words, two shifts (left to drop what is above,
right to extend the sign) and a running sum therefore unpack any number of batches, whatever their widths. The
bases of unsigned channels then lose the bits into which a sign was extended.
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
    """Consecutive samples of the board, one row a tick; a gap in ``tick`` is a loss.

    Parameters
    ----------
    tick : ndarray of uint32, shape (n,)
        Device time [tick of 1 ms].
    raw : ndarray of int32, shape (n, channels)
        Channels in the order of the declaration's ``CHANNELS``; multiply by their scale.
    """

    tick: npt.NDArray[np.uint32]
    raw: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.tick)


EMPTY_TICKS = Ticks(np.empty(0, np.uint32), np.empty((0, CHANNEL_COUNT), np.int32))


class _Layout:
    """What all batches of the same channels have in common.

    ``shape`` are the bytes of a payload that decide how long it is: count and widths. Of each channel's base,
    ``offset`` (channels,) is the byte at which it begins, ``shift`` (channels,) what is above it in a word,
    and ``bits`` (channels,) those that it has: all for a signed one, whose sign goes through the whole word.
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
    """Where the numbers of a batch lie, for one count and one set of widths.

    ``size`` is the length of such a payload, -1 when there can be none. ``index`` (n, channels) is the byte
    at which each number's word begins, ``left`` and ``right`` (n, channels) the shifts that cut it out.
    """

    size: int
    index: npt.NDArray[np.intp]
    left: npt.NDArray[np.uint32]
    right: npt.NDArray[np.int32]


class TelemetryDecoder:
    """Unpacks telemetry payloads.

    Parameters
    ----------
    channels : sequence of ChannelSpec
        Channels of a sample, in order.

    Attributes
    ----------
    malformed : int
        Payloads refused although their frame was sound: their length does not fit their header.
    """

    def __init__(self, channels: Sequence[ChannelSpec] = CHANNELS) -> None:
        self.malformed = 0
        self._layout = _Layout(channels)
        self._plans: dict[bytes, _Plan] = {}

    def decode(self, payloads: Sequence[bytes]) -> Ticks:
        """Unpack batches.

        Parameters
        ----------
        payloads : sequence of bytes
            Payloads of telemetry messages, in order of arrival.

        Returns
        -------
        Ticks
            All their samples, in the same order; malformed payloads are left out and counted.
        """
        plans: list[_Plan] = []
        parts: list[bytes] = []
        for payload in payloads:
            shape = payload[self._layout.shape]
            plan = self._plans.get(shape)
            if plan is None:
                plan = self._remember(shape)
            if plan.size == len(payload):
                plans.append(plan)
                parts.append(payload)
            else:
                self.malformed += 1
        if not plans:
            return EMPTY_TICKS
        parts.append(_PAD)
        joined = b"".join(parts)
        words = np.ndarray((len(joined) - 3,), "<u4", joined, strides=(1,))
        if len(plans) == 1:
            raw = _cut_out(words, plans[0].index, plans[0].left, plans[0].right)
            raw[0] &= self._layout.bits
            raw.cumsum(axis=0, dtype=np.int32, out=raw)
            return Ticks(words[0] + np.arange(len(raw), dtype=np.uint32), raw)
        return _unpack(words, plans, self._layout)

    def _remember(self, shape: bytes) -> _Plan:
        if len(self._plans) >= _PLANS_KEPT:
            self._plans.clear()
        plan = self._plans[shape] = _plan(shape, self._layout)
        return plan


def _plan(shape: bytes, layout: _Layout) -> _Plan:
    """Lay out a batch by its bytes from the count to the last width."""
    codes = [nibble for byte in shape[1:] for nibble in (byte & 15, byte >> 4)][: layout.channels]
    if len(codes) < layout.channels or shape[0] == 0 or max(codes) >= len(_WIDTH_BITS):
        nothing = np.empty((0, layout.channels))
        return _Plan(-1, nothing.astype(np.intp), nothing.astype(np.uint32), nothing.astype(np.int32))
    count = shape[0]
    width = _WIDTH_BITS[codes]  # (channels,)
    # (channels,), behind each channel's deltas
    end = layout.deltas_start + np.cumsum((width * (count - 1) + 7) >> 3)
    bit = width * np.arange(count - 1)[:, None]  # (n - 1, channels), of each delta in its channel
    begin = np.concatenate(([layout.deltas_start], end[:-1]))
    right = np.vstack((layout.shift, np.broadcast_to(32 - width, bit.shape)))
    left = np.vstack((layout.shift, 32 - width - (bit & 7)))
    index = np.vstack((layout.offset, begin + (bit >> 3)))
    return _Plan(int(end[-1]), index, left.astype(np.uint32), right.astype(np.int32))


def _cut_out(
    words: npt.NDArray[np.uint32],
    index: npt.NDArray[np.intp],
    left: npt.NDArray[np.uint32],
    right: npt.NDArray[np.int32],
) -> npt.NDArray[np.int32]:
    """Cut numbers of some bits out of 32-bit words: a shift to the left removes the bits before, an
    arithmetic shift to the right those behind, and extends the sign.
    """
    # A shift by 32, for a delta of no bits, gives 0 in numpy: it is defined there.
    return np.asarray((words.take(index) << left).view(np.int32) >> right)


def _unpack(words: npt.NDArray[np.uint32], plans: Sequence[_Plan], layout: _Layout) -> Ticks:
    """Unpack batches of telemetry of one reading together: n samples in f batches. Each batch has the
    absolute numbers of its first sample, then differences.
    """
    size = np.array([plan.size for plan in plans])  # (f,)
    count = np.array([len(plan.index) for plan in plans])  # (f,)
    start = np.cumsum(size) - size  # (f,), first byte of each batch
    row = np.cumsum(count) - count  # (f,), first row of each batch
    index = np.concatenate([plan.index for plan in plans])  # (n, channels)
    index += np.repeat(start, count)[:, None]
    raw = _cut_out(
        words,
        index,
        np.concatenate([plan.left for plan in plans]),
        np.concatenate([plan.right for plan in plans]),
    )
    raw[row] &= layout.bits
    # Each base is an absolute number: what the batches before have summed up to is taken off it first.
    raw[row[1:]] -= np.add.reduceat(raw, row, axis=0, dtype=np.int32)[:-1]
    raw.cumsum(axis=0, dtype=np.int32, out=raw)
    first = words.take(start) - row.astype(np.uint32)
    tick = np.repeat(first, count) + np.arange(len(raw), dtype=np.uint32)
    return Ticks(tick, raw)
