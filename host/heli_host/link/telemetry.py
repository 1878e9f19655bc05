"""Telemetry batches to ticks, many at a time.

The deltas of one channel are 2, 4, 8, 16 or 32 bits wide and start on a byte, so each of them lies inside the
four bytes that begin at its own first byte. One gather of such words, two shifts (left to drop what is above,
right to extend the sign) and a running sum therefore unpack any number of batches, whatever their widths.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.link.declaration import CHANNELS

CHANNEL_COUNT = len(CHANNELS)

_HEADER_BYTES = 5
_WIDTHS_BYTES = (CHANNEL_COUNT + 1) // 2
_BASE_BYTES = tuple({"b": 1, "h": 2, "i": 4}[channel.code[-1].lower()] for channel in CHANNELS)
_BASES_START = _HEADER_BYTES + _WIDTHS_BYTES
_DELTAS_START = _BASES_START + sum(_BASE_BYTES)
_PAD = b"\0\0\0\0"
_WIDTH_BITS = np.array([0, 2, 4, 8, 16, 32], dtype=np.intp)
_WIDTH_CODES = len(_WIDTH_BITS)
_BASE_OFFSET = np.cumsum((_BASES_START, *_BASE_BYTES[:-1]))  # (11,)
_BASE_SHIFT = np.array([32 - 8 * size for size in _BASE_BYTES], dtype=np.uint32)  # (11,)
_UNSIGNED = tuple(i for i, channel in enumerate(CHANNELS) if channel.code[-1].isupper())
_NIBBLE = np.arange(CHANNEL_COUNT) % 2 * 4
_NIBBLE_BYTE = _HEADER_BYTES + np.arange(CHANNEL_COUNT) // 2
# Above this many batches at once the intermediate arrays leave the second-level cache.
_BATCHES_AT_ONCE = 128


@dataclass(frozen=True)
class Ticks:
    """Consecutive samples of the board, one row a tick; a gap in ``tick`` is a loss.

    Parameters
    ----------
    tick : ndarray of uint32, shape (n,)
        Device time [tick of 1 ms].
    raw : ndarray of int32, shape (n, 11)
        Channels in the order of the declaration's ``CHANNELS``; multiply by their scale.
    """

    tick: npt.NDArray[np.uint32]
    raw: npt.NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.tick)


EMPTY_TICKS = Ticks(np.empty(0, np.uint32), np.empty((0, CHANNEL_COUNT), np.int32))


class TelemetryDecoder:
    """Unpacks telemetry payloads.

    Attributes
    ----------
    malformed : int
        Payloads refused although their frame was sound: their length does not fit their header.
    """

    def __init__(self) -> None:
        self.malformed = 0

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
        parts: list[Ticks] = []
        start = 0
        while start < len(payloads):
            count = payloads[start][4] if len(payloads[start]) >= _DELTAS_START else 0
            end = start + 1
            limit = min(len(payloads), start + _BATCHES_AT_ONCE)
            while end < limit and len(payloads[end]) >= _DELTAS_START and payloads[end][4] == count:
                end += 1
            if count == 0:
                self.malformed += 1
                end = start + 1
            else:
                parts.append(self._decode_alike(payloads[start:end], count))
            start = end
        if len(parts) == 1:
            return parts[0]
        if not parts:
            return EMPTY_TICKS
        return Ticks(
            np.concatenate([part.tick for part in parts]), np.concatenate([part.raw for part in parts])
        )

    def _decode_alike(self, payloads: Sequence[bytes], count: int) -> Ticks:
        joined = b"".join((*payloads, _PAD))
        data = np.frombuffer(joined, np.uint8)
        words = np.ndarray((len(joined) - 3,), "<u4", joined, strides=(1,))
        length = np.fromiter(map(len, payloads), np.intp, len(payloads))  # (f,)
        start = np.cumsum(length) - length  # (f,)

        code = (data[start[:, None] + _NIBBLE_BYTE] >> _NIBBLE) & 15  # (f, 11)
        sound = code.max(axis=1) < _WIDTH_CODES  # (f,)
        width = _WIDTH_BITS[np.minimum(code, _WIDTH_CODES - 1)]  # (f, 11)
        end = np.cumsum((width * (count - 1) + 7) >> 3, axis=1)  # (f, 11), behind the channel's deltas
        sound &= end[:, -1] == length - _DELTAS_START
        if not sound.all():
            self.malformed += int(len(payloads) - np.count_nonzero(sound))
            kept = [payload for payload, good in zip(payloads, sound, strict=True) if good]
            return self._decode_alike(kept, count) if kept else EMPTY_TICKS

        frames = len(payloads)
        bit = width[:, None, :] * np.arange(count - 1)[:, None]  # (f, count - 1, 11)
        index = np.empty((frames, count, CHANNEL_COUNT), np.intp)
        index[:, 0] = start[:, None] + _BASE_OFFSET
        np.right_shift(bit, 3, out=index[:, 1:])
        delta_start = end - ((width * (count - 1) + 7) >> 3) + (start + _DELTAS_START)[:, None]  # (f, 11)
        index[:, 1:] += delta_start[:, None, :]
        right = np.empty((frames, count, CHANNEL_COUNT), np.uint32)
        right[:, 0] = _BASE_SHIFT
        right[:, 1:] = (32 - width)[:, None, :]
        left = right.copy()
        left[:, 1:] -= (bit & 7).astype(np.uint32)
        raw = (words.take(index) << left).view(np.int32) >> right.view(np.int32)
        raw[:, 0, _UNSIGNED] &= 255
        np.cumsum(raw, axis=1, dtype=np.int32, out=raw)
        first = words.take(start)
        tick = first[:, None] + np.arange(count, dtype=np.uint32)
        return Ticks(tick.reshape(-1), raw.reshape(-1, CHANNEL_COUNT))
