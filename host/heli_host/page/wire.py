"""What goes over the page's WebSocket, as text and as binary frames; docs/page.md describes them.

A frame is a header of 24 bytes, little-endian: kind (u8, 1), flags (u8: 1 rows were left out between these,
2 what came before does not go on in them), channels (u16), number of the frame (u32), rows (u32), the board's
state now (u8, 255 while nothing is heard of it), its fault (u8), 0 (u16), tick of the first row (f64). After
it ticks since the first (u32 each), then channel after channel the raw numbers of all rows (i32).
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
from heli_host.page.tape import Cut

THINNED, RESET = 1, 2

_SAMPLES = 1
_HEADER = struct.Struct("<BBHIIBBHd")


@dataclass(frozen=True)
class Rows:
    """What a frame holds.

    Parameters
    ----------
    number : int
        Number of the frame, by which it is acknowledged.
    flags : int
        `THINNED` and `RESET`.
    state, fault : int
        The board's when the frame was sent; `heli_host.page.source.UNKNOWN` while nothing was heard of it.
    tick : ndarray of int64, shape (n,)
        Device time [tick], counted on over 2^32.
    raw : ndarray of int32, shape (n, channels)
        Raw numbers in the order of the declaration.
    """

    number: int
    flags: int
    state: int
    fault: int
    tick: npt.NDArray[np.int64]
    raw: npt.NDArray[np.int32]


def pack(cut: Cut, number: int, state: tuple[int, int]) -> bytes:
    """Return a frame.

    Parameters
    ----------
    cut : Cut
        Its rows; a frame may have none.
    number : int
        Number of the frame.
    state : tuple of int
        State and fault of the board now.
    """
    flags = THINNED * cut.thinned + RESET * cut.reset
    first = int(cut.tick[0]) if len(cut.tick) else 0
    rows, channels = cut.raw.shape
    head = _HEADER.pack(_SAMPLES, flags, channels, number & 0xFFFFFFFF, rows, *state, 0, float(first))
    offsets = (cut.tick - first).astype("<u4").tobytes()
    return head + offsets + np.ascontiguousarray(cut.raw.T, "<i4").tobytes()


def unpack(frame: bytes) -> Rows:
    """Undo `pack`.

    Parameters
    ----------
    frame : bytes
        As it came.

    Raises
    ------
    LinkError
        It is no such frame.
    """
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
    """Return news as JSON, and whether a number in it was not finite: that is null there, as JSON has no NaN.

    Parameters
    ----------
    news : Mapping of str to object
        What a page shows or answers.
    """
    try:
        return json.dumps(news, allow_nan=False, separators=(",", ":")), False
    except ValueError:
        return json.dumps(_without_nan(news), allow_nan=False, separators=(",", ":")), True


def _without_nan(news: Any) -> Any:
    if isinstance(news, Mapping):
        return {name: _without_nan(value) for name, value in news.items()}
    if isinstance(news, list | tuple):
        return [_without_nan(value) for value in news]
    return None if isinstance(news, float) and not math.isfinite(news) else news
