"""Frames that no board would send, for the whole host: session, view, parameters and recorder.

``python -m tests.link.fuzz_host 1000000`` sends so many and says what broke; ``make fuzz`` does it.
"""

import random
import struct
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from heli_host import declaration
from heli_host.board.heli import Heli
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import summarise
from heli_host.declaration import CHANNELS, MAX_TELEMETRY_PAYLOAD, MessageId
from heli_host.errors import HeliError
from heli_host.fly.recorder import Recorder
from heli_host.link.frames import encode_frame
from heli_host.link.session import Session

from tests.link.fake_board import FakeBoard, FakeLine

_MESSAGES = [
    message
    for message in vars(declaration).values()
    if isinstance(message, type) and hasattr(message, "STRUCT") and hasattr(message, "ID")
]
_FLOATS = [float("nan"), float("inf"), float("-inf"), -0.0, 3.4e38, 1e-45, 1.0, 2.0**24]
_WIDTH_BITS = (0, 2, 4, 8, 16, 32)
_BASE_BYTES = sum(struct.calcsize(channel.code) for channel in CHANNELS)
# One of many frames always demands a new handshake, and the others are then dropped.
_A_READING = (4, 20, 300)
# A session ends when the board reports another declaration, and when it has waited too long.
_READINGS_A_SESSION = 40


class Frames:
    """Frames from a seed: sound ones with any content, and damaged ones."""

    def __init__(self, seed: int) -> None:
        self.sent = 0
        self._random = random.Random(seed)
        self._seq = 0
        self._tick = 0

    def reading(self, board_bytes: bytes) -> bytes:
        """Bytes of one reading: frames of the board among many others."""
        made = [self.frame() for _ in range(self._random.choice(_A_READING))]
        made.insert(self._random.randrange(len(made)), board_bytes)
        return b"".join(made)

    def frame(self) -> bytes:
        """The next one."""
        chance = self._random
        self.sent += 1
        self._seq = (self._seq + 1) & 0xFF if chance.random() < 0.9 else chance.randrange(256)
        kind = chance.random()
        if kind < 0.45:
            message = chance.choice(_MESSAGES)
            if message.ID == MessageId.WELCOME and chance.random() < 0.98:
                # One that fits the hello ends the session: another declaration.
                message = declaration.EventMessage
            return encode_frame(message.ID | 128, self._seq, self._fields(message))
        if kind < 0.7:
            return encode_frame(MessageId.TELEMETRY, self._seq, self._batch())
        payload = chance.randbytes(chance.choice((0, 1, 2, 11, 22, 40, chance.randrange(480))))
        frame = encode_frame(chance.randrange(128, 256), self._seq, payload)
        if kind < 0.85:
            return frame
        at = chance.randrange(len(frame))
        return frame[:at] + chance.randbytes(chance.randrange(3)) + frame[at + 1 :]

    def _fields(self, message: Any) -> bytes:
        chance = self._random
        payload = bytearray(chance.randbytes(message.STRUCT.size))
        at = 0
        for code in message.STRUCT.format.lstrip("<"):
            size = struct.calcsize(f"<{code}")
            if code == "f" and chance.random() < 0.7:
                struct.pack_into("<f", payload, at, chance.choice(_FLOATS))
            elif code != "f" and chance.random() < 0.6:
                # Enumerations, request numbers and counts are small.
                payload[at : at + size] = chance.randrange(16).to_bytes(size, "little")
            at += size
        tail = chance.randbytes(4 * chance.randrange(33)) if chance.random() < 0.2 else b""
        return bytes(payload) + tail

    def _batch(self) -> bytes:
        chance = self._random
        count = chance.randrange(1, 33)
        codes = [chance.choice((0, 0, 0, 1, 2, 3, 4, chance.randrange(16))) for _ in CHANNELS]
        # Codes from 6 on are unknown: any length of the differences is wrong for them.
        difference_bytes = sum(((count - 1) * _WIDTH_BITS[code % 6] + 7) >> 3 for code in codes)
        nibbles = [*codes, 0] if len(codes) % 2 else codes
        widths = bytes(low | high << 4 for low, high in zip(nibbles[::2], nibbles[1::2], strict=True))
        bases = bytearray(chance.randbytes(_BASE_BYTES))
        if chance.random() < 0.7:
            # Those of 8 bits, which come last, are enumerations.
            bases[-4:] = (chance.randrange(9) for _ in range(4))
        # Mostly the next tick; sometimes some are lost, or the board seems to have restarted.
        first = self._tick + chance.choice((0, 0, 0, 0, chance.randrange(300)))
        if chance.random() < 0.05:
            first = chance.choice((chance.getrandbits(32), chance.randrange(100_000), 2**32 - 1))
        self._tick = (first + count) & 0xFFFFFFFF
        first &= 0xFFFFFFFF
        head = struct.pack("<IB", first, count)
        return (head + widths + bases + chance.randbytes(difference_bytes))[:MAX_TELEMETRY_PAYLOAD]


def unexpected(error: Exception) -> Exception | None:
    """The error that should not be, None for one that the package reports on purpose."""
    if not isinstance(error, HeliError):
        return error
    cause = error.__cause__
    reading_failed = "reading failed" in str(error)
    return (
        error
        if reading_failed or (cause is not None and not isinstance(cause, HeliError | OSError))
        else None
    )


def fuzz_host(seed: int, frames: int) -> tuple[int, Counter[str]]:
    """Send frames to sessions, one after the other, that are used as a program would use them."""
    made, broken = Frames(seed), Counter[str]()

    def attempt(action: Callable[[], object]) -> bool:
        try:
            action()
        except Exception as error:  # noqa: BLE001 - it is what the fuzzer looks for
            wrong = unexpected(error)
            if wrong is not None:
                broken[f"{type(wrong).__name__}: {wrong}"] += 1
            return False
        return True

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fuzzed.mcap"
        while made.sent < frames:
            attempt(lambda: _one_session(made, path, attempt))
            path.unlink(missing_ok=True)
    return made.sent, broken


def _one_session(made: Frames, path: Path, attempt: Callable[[Callable[[], object]], bool]) -> None:
    line = FakeLine(FakeBoard())
    session = Session(line, session_number=made.sent & 0xFFFFFFFF, reconnect_timeout_s=2.0)
    session.connect()
    heli = Heli(session)
    recorder = Recorder(heli, path)
    line.damage_to_host(made.reading)
    used: list[Callable[[], object]] = [
        session.status,
        heli.params.refresh,
        lambda: heli.params.set("hover_V", 1.5),
        lambda: heli.samples(1.0),
        lambda: heli.info,
        session.device_tick,
    ]
    for number in range(_READINGS_A_SESSION):
        if not attempt(lambda: session.wait_for(lambda: False, 0.02)) and not session.connected:
            break
        attempt(lambda: heli.latest)
        attempt(used[number % len(used)])
        attempt(lambda: heli.counters)
    attempt(session.close)
    attempt(recorder.close)
    attempt(lambda: summarise(read_log(path)))


def main() -> int:
    """Fuzz with as many frames as the command line says."""
    start_s = time.process_time()
    sent, broken = fuzz_host(1, int(sys.argv[1]))
    for what, count in broken.most_common(20):
        print(f"{count:8d} {what}")
    print(
        f"{sent} frames in {time.process_time() - start_s:.0f} s of CPU, {broken.total()} unexpected errors"
    )
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
