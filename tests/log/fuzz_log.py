"""Damaged logs for the reader and all that follows it: an error of one line, or a log that can be used.

``python -m tests.log.fuzz_log 4000`` damages one log so often and says what broke; ``make fuzz`` does it.
"""

import random
import struct
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import summarise
from heli_host.errors import HeliError

from tests.log.made import write_made_log

_EDGES = [0, 1, 0x7F, 0x80, 0xFF, 2**31, 2**32 - 1, 2**63, 2**64 - 1]


def damaged(whole: bytes, chance: random.Random) -> bytes:
    """A log with some of its bytes changed, cut off, left out, doubled or exchanged."""
    data = bytearray(whole)
    for _ in range(chance.choice((1, 1, 2, 8))):
        at = chance.randrange(len(data))
        # The records at both ends are short, and decide how the rest is read.
        near = chance.choice((at, at % min(4096, len(data)), -1 - at % min(4096, len(data))))
        kind = chance.randrange(6)
        if kind == 0:
            data[near] ^= 1 << chance.randrange(8)
        elif kind == 1:
            data[near] = chance.randrange(256)
        elif kind == 2:
            size, value = chance.choice((("<I", 2**32), ("<Q", 2**64)))
            start = near % max(len(data) - 8, 1)
            struct.pack_into(size, data, start, chance.choice(_EDGES) % value)
        elif kind == 3 and len(data) > 16:
            del data[near % len(data) :]
        elif kind == 4 and len(data) > 16:
            start = near % len(data)
            del data[start : start + chance.randrange(1, 64)]
        else:
            start = near % len(data)
            data[start:start] = data[at : at + chance.randrange(1, 64)]
        if not data:
            return b""
    return bytes(data)


def fuzz_log(seed: int, count: int) -> Counter[str]:
    """Read damaged logs and use what can be read."""
    chance, broken = random.Random(seed), Counter[str]()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("error")
        path = Path(folder) / "made.mcap"
        write_made_log(path, n=600)
        complete = path.read_bytes()
        for _ in range(count):
            path.write_bytes(damaged(complete, chance))
            try:
                summarise(read_log(path))
            except HeliError:
                continue
            except Exception as error:  # noqa: BLE001 - it is what the fuzzer looks for
                broken[f"{type(error).__name__}: {error}"] += 1
    return broken


def main() -> int:
    """Fuzz with as many logs as the command line says."""
    start_s, count = time.process_time(), int(sys.argv[1])
    broken = fuzz_log(1, count)
    for what, often in broken.most_common(20):
        print(f"{often:8d} {what}")
    spent_s = time.process_time() - start_s
    print(f"{count} damaged logs in {spent_s:.0f} s of CPU, {broken.total()} unexpected errors")
    return 1 if broken else 0


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


if __name__ == "__main__":
    sys.exit(main())
