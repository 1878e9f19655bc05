"""Conversion of the raw numbers of telemetry channels to values in units, and back.

A row of raw numbers is int32, whatever types its channels have on the wire: an unsigned 32-bit number from
2^31 on is stored as its two's complement.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum

import numpy as np
import numpy.typing as npt

from heli_host.declaration import AXES, CHANNELS, Axis, Channel, ChannelSpec

ENCODERS: tuple[Channel, ...] = tuple(
    next(channel for channel in Channel if CHANNELS[channel].axis is axis) for axis in Axis
)
"""The channel that counts each axis' encoder, in the order of `Axis`."""

_ENUMERATED = {
    channel: {int(value) for value in kind}
    for channel in Channel
    if (kind := CHANNELS[channel].kind) is not None and issubclass(kind, IntEnum)
}
_MAX = max(max(values) for values in _ENUMERATED.values())
# Which numbers have a name, one after the other for each enumerated channel; the last stands for all above.
_NAMED = np.array([number in values for values in _ENUMERATED.values() for number in range(_MAX + 2)])
_COLUMNS = np.array(list(_ENUMERATED))
_STARTS = np.arange(len(_ENUMERATED), dtype=np.uint32) * np.uint32(_MAX + 2)

MODES = slice(min(_ENUMERATED), max(_ENUMERATED) + 1)
"""Columns of a row among which are all enumerations: they seldom change, so a glance at them saves a look."""

_TYPES = tuple(np.dtype(spec.code) for spec in CHANNELS)


def is_whole(spec: ChannelSpec) -> bool:
    """Whether a channel's values are its raw numbers: counts, enumerations, bits."""
    return spec.scale == 1.0


def numbers(raw: npt.NDArray[np.int32], channel: Channel) -> npt.NDArray[np.integer]:
    """Return the raw numbers of a channel in the type that it has on the wire. Shapes: `raw` (...,
    channels).
    """
    return raw[..., channel].astype(_TYPES[channel])


def physical(raw: npt.NDArray[np.int32], channel: Channel) -> npt.NDArray[np.float64]:
    """Return a channel in its unit. Shapes: `raw` (..., channels)."""
    return numbers(raw, channel).astype(np.float64) * CHANNELS[channel].scale


def raw_numbers(
    values: npt.NDArray[np.floating] | npt.NDArray[np.integer], channel: Channel
) -> npt.NDArray[np.int32]:
    """Undo `physical`. Shapes: `values` (n,); returns (n,)."""
    counted = np.rint(values.astype(np.float64) / CHANNELS[channel].scale)
    return counted.astype(np.int64).astype(np.uint32).view(np.int32)


def declared(raw: npt.NDArray[np.int32]) -> npt.NDArray[np.bool_]:
    """Find the samples whose enumerations have only values of the declaration. Shapes: `raw` (n, channels);
    returns (n,).
    """
    values = np.minimum(raw.take(_COLUMNS, axis=1).view(np.uint32), np.uint32(_MAX + 1))  # (n, enumerated)
    return np.asarray(_NAMED.take(values + _STARTS).all(axis=1))


def rad_per_count(parameters: Mapping[str, float]) -> npt.NDArray[np.float64]:
    """Return the angle of one count of each axis' encoder. Returns shape (axes,)."""
    counts_per_rev = (abs(parameters.get(f"{axis}_counts_per_rev", 0.0)) for axis in AXES)
    return np.array([2.0 * np.pi / counts if counts else np.nan for counts in counts_per_rev])
