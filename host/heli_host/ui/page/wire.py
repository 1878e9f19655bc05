"""Messages on the page's WebSocket, JSON texts and binary frames; see docs/reference/dashboard-protocol.md.

A frame begins with a header of 24 bytes, little-endian. Its fields are kind (u8, 1), flags (u8), number of
channels (u16), frame number (u32) and number of rows (u32). Then follow the present state of the board (u8,
255 without telemetry), its fault (u8), 0 (u16), and the tick of the first row (f64). Bit 0 of the flags means
that rows between the rows of this frame were left out. Bit 1 means that rows before the first are missing.

The ticks since the first follow (u32 each), then the raw numbers (i32) of all rows, channel by channel.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from heli_host.errors import LinkError
from heli_host.ui.page.telemetry_buffer import BufferRows

THINNED, RESET = 1, 2

_SAMPLES = 1
_HEADER = struct.Struct("<BBHIIBBHd")


@dataclass(frozen=True)
class Rows:
    """Contents of a frame."""

    number: int  # Number of the frame; the client acknowledges it by this number
    flags: int  # `THINNED` and `RESET`, combined
    state: int
    """state, fault: State and fault of the board when the frame was sent; `heli_host.ui.page.source.UNKNOWN`
    if unknown."""
    fault: int
    tick: npt.NDArray[np.int64]  # (n,): Device time [tick of 1 ms], unwrapped beyond 2^32
    raw: npt.NDArray[np.int32]  # (n, channels): Raw numbers in the order of the declaration's ``CHANNELS``


def pack(cut: BufferRows, number: int, state: tuple[int, int]) -> bytes:
    """Encode a frame."""
    flags = THINNED * cut.thinned + RESET * cut.reset
    first = int(cut.tick[0]) if len(cut.tick) else 0
    rows, channels = cut.raw.shape
    head = _HEADER.pack(_SAMPLES, flags, channels, number & 0xFFFFFFFF, rows, *state, 0, float(first))
    offsets = (cut.tick - first).astype("<u4").tobytes()
    return head + offsets + np.ascontiguousarray(cut.raw.T, "<i4").tobytes()


def unpack(frame: bytes) -> Rows:
    """Decode a `frame` that `pack` made."""
    if len(frame) < _HEADER.size:
        raise LinkError(
            "the dashboard sent an incomplete frame", "use the same version of heli-host at both ends"
        )
    kind, flags, channels, number, rows, state, fault, _, first = _HEADER.unpack_from(frame)
    if kind != _SAMPLES or len(frame) != _HEADER.size + 4 * rows * (1 + channels):
        raise LinkError(
            "the dashboard sent an unknown frame", "use the same version of heli-host at both ends"
        )
    offsets = np.frombuffer(frame, "<u4", rows, _HEADER.size)
    raw = np.frombuffer(frame, "<i4", rows * channels, _HEADER.size + 4 * rows)
    return Rows(
        number, flags, state, fault, offsets.astype(np.int64) + int(first), raw.reshape(channels, rows).T
    )


def as_json(news: Mapping[str, Any]) -> tuple[str, bool]:
    """Encode a message as JSON, with null for numbers that are not finite, and return whether there were
    any.
    """
    try:
        return json.dumps(news, allow_nan=False, separators=(",", ":")), False
    except ValueError:
        return json.dumps(_without_nan(news), allow_nan=False, separators=(",", ":")), True


def _without_nan(news: Any) -> Any:
    """Return a JSON value with None instead of each number that is not finite."""
    if isinstance(news, Mapping):
        return {name: _without_nan(value) for name, value in news.items()}
    if isinstance(news, list | tuple):
        return [_without_nan(value) for value in news]
    return None if isinstance(news, float) and not math.isfinite(news) else news
