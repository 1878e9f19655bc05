"""What happens to files: bits that flip, sectors lost or copied over others, ends cut off."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Mutation = Callable[[bytearray, np.random.Generator, int], None]
"""Changes some bytes at a place."""


def mutated(data: bytes, seed: int, first: int = 0, last: int | None = None) -> bytes:
    """Return a copy with one to three mutations."""
    rng = np.random.default_rng(seed)
    changed = bytearray(data)
    for _ in range(int(rng.choice((1, 1, 1, 2, 3)))):
        end = min(len(changed), last if last is not None else len(changed))
        if end > first:
            _MUTATIONS[rng.integers(len(_MUTATIONS))](changed, rng, int(rng.integers(first, end)))
    return bytes(changed)


def _flip(data: bytearray, rng: np.random.Generator, at: int) -> None:
    data[at] ^= 1 << int(rng.integers(8))


def _replace(data: bytearray, rng: np.random.Generator, at: int) -> None:
    data[at] = int(rng.integers(256))


def _zero(data: bytearray, rng: np.random.Generator, at: int) -> None:
    run = min(int(rng.choice((4, 64, 512, 4096))), len(data) - at)
    data[at : at + run] = bytes(run)


def _scramble(data: bytearray, rng: np.random.Generator, at: int) -> None:
    run = min(int(rng.choice((2, 16, 512))), len(data) - at)
    data[at : at + run] = rng.bytes(run)


def _delete(data: bytearray, rng: np.random.Generator, at: int) -> None:
    del data[at : at + int(rng.choice((1, 8, 512)))]


def _insert(data: bytearray, rng: np.random.Generator, at: int) -> None:
    data[at:at] = rng.bytes(int(rng.choice((1, 8, 512))))


def _copy(data: bytearray, rng: np.random.Generator, at: int) -> None:
    run = int(rng.choice((8, 512, 4096)))
    source = int(rng.integers(len(data)))
    piece = data[source : source + run]
    data[at : at + len(piece)] = piece


def _cut(data: bytearray, rng: np.random.Generator, at: int) -> None:
    del data[at:]


_MUTATIONS: tuple[Mutation, ...] = (
    _flip,
    _flip,
    _flip,
    _replace,
    _zero,
    _scramble,
    _delete,
    _insert,
    _copy,
    _cut,
)
