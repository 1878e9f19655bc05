"""Frames: ``COBS(protocol | message id | sequence | payload | crc32) 0x00``, see docs/reference/link.md."""

from __future__ import annotations

import zlib
from typing import NamedTuple

from cobs import cobs

from heli_host.declaration import MAX_COMMAND_PAYLOAD, MAX_TELEMETRY_PAYLOAD, PROTOCOL
from heli_host.errors import HandshakeTimeout, LinkError, WrongDevice

_HEADER_BYTES = 3
_CRC_BYTES = 4
_OVERHEAD_BYTES = _HEADER_BYTES + _CRC_BYTES
_MAX_PLAIN = MAX_TELEMETRY_PAYLOAD + _OVERHEAD_BYTES
# COBS adds one byte in front and one for every full 254 bytes.
_MAX_ENCODED = _MAX_PLAIN + 1 + _MAX_PLAIN // 254
_EXCERPT_BYTES = 64
# The CRC-32 of anything that ends with its own CRC-32, least significant byte first.
_CRC_RESIDUE = 0x2144DF1C


class Frame(NamedTuple):
    """One frame that passed every check."""

    id: int  # Message id; this host may not know it
    seq: int  # Sequence number, modulo 256
    payload: bytes  # Bytes between header and CRC


def encode_frame(message_id: int, seq: int, payload: bytes) -> bytes:
    """Build one frame, with its delimiter."""
    limit = MAX_COMMAND_PAYLOAD if message_id < 128 else MAX_TELEMETRY_PAYLOAD
    if len(payload) > limit:
        raise ValueError(f"payload of {len(payload)} bytes; a frame carries at most {limit}")
    content = bytes((PROTOCOL, message_id, seq & 0xFF)) + payload
    encoded: bytes = cobs.encode(content + zlib.crc32(content).to_bytes(4, "little"))
    return encoded + b"\0"


class FrameParser:
    """Splits a byte stream into frames; the stream may contain any bytes."""

    def __init__(self) -> None:
        self.frames_ok = 0
        self.frames_bad = 0
        self.frames_lost = 0
        self.frames_repeated = 0
        self.bytes_received = 0
        self.bytes_dropped = 0
        self.excerpt = b""
        self._partial = b""
        self._overlong = False
        self._synchronised = False
        self._expected_seq = -1

    @property
    def pending(self) -> bytes:
        """Bytes since the last delimiter: the head of a frame, or of something that is none."""
        return self._partial

    def feed(self, data: bytes) -> list[Frame]:
        """Process bytes from the board, and return the frames that they complete."""
        self.bytes_received += len(data)
        encoded_frames = (self._partial + data).split(b"\0")
        self._partial = encoded_frames.pop()  # behind the last delimiter
        frames: list[Frame] = []
        decode, crc32 = cobs.decode, zlib.crc32  # looked up once, because every frame passes here
        for encoded in encoded_frames:
            if self._overlong:
                # The rest of a frame whose beginning was dropped.
                self._overlong = False
                self._count_bad(encoded)
                continue
            if not encoded:
                self._synchronised = True
                continue
            try:
                decoded = decode(encoded) if len(encoded) <= _MAX_ENCODED else b""
            except cobs.DecodeError:
                decoded = b""
            is_complete = len(decoded) >= _OVERHEAD_BYTES and decoded[0] == PROTOCOL
            if not is_complete or crc32(decoded) != _CRC_RESIDUE:
                self._count_bad(encoded)
                continue
            _, message_id, seq = decoded[:_HEADER_BYTES]
            if seq != self._expected_seq:
                self._count_gap(seq)
            self._expected_seq = (seq + 1) & 0xFF
            frames.append(Frame(message_id, seq, decoded[_HEADER_BYTES:-_CRC_BYTES]))
        if frames:
            self.frames_ok += len(frames)
            self._synchronised = True
        if len(self._partial) > _MAX_ENCODED:
            self._count_dropped_bytes(self._partial)
            self._partial = b""
            self._overlong = True
        return frames

    def restart(self) -> None:
        """Discard the incomplete frame and the sequence number, because the line was interrupted."""
        self._partial = b""
        self._overlong = False
        self._synchronised = False
        self.restart_sequence()

    def restart_sequence(self) -> None:
        """Accept any sequence number in the next frame, because the other end has restarted."""
        self._expected_seq = -1

    def _count_gap(self, seq: int) -> None:
        """Count the frames that are missing before the number `seq`, which has 8 bits; one less than expected
        is a repetition.
        """
        if self._expected_seq < 0:
            return
        gap = (seq - self._expected_seq) & 0xFF
        if gap == 0xFF:
            self.frames_repeated += 1
        else:
            self.frames_lost += gap

    def _count_bad(self, part: bytes) -> None:
        self._count_dropped_bytes(part)
        self.frames_bad += self._synchronised
        self._synchronised = True

    def _count_dropped_bytes(self, part: bytes) -> None:
        self.bytes_dropped += len(part)
        self.excerpt = (self.excerpt + part)[-_EXCERPT_BYTES:]


def no_welcome(parser: FrameParser, url: str, timeout_s: float) -> LinkError:
    """Return the error for a handshake that timed out."""
    if parser.frames_ok:
        return HandshakeTimeout(
            f"a board on {url} sends data, but did not answer within {timeout_s:g} s",
            "press the board's reset button; if the error stays, flash the firmware of this release",
        )
    if parser.bytes_received == 0:
        return HandshakeTimeout(
            f"no data came from {url} within {timeout_s:g} s",
            "check power and cable, that it is the programming port, and that the firmware is flashed",
        )
    last_bytes = parser.excerpt + parser.pending
    excerpt = last_bytes[-16:]  # as many as fit into a line
    received_text = f"{parser.bytes_received} bytes (the last: {excerpt.hex(' ')})"
    # A boot loader, a console, or a simulated board with another host sends readable text.
    last_line = last_bytes.strip(b"\r\n\0").rpartition(b"\n")[2].decode("ascii", errors="replace")
    if last_line and last_line.isascii() and last_line.isprintable():
        received_text += f", in words {last_line!r},"
    return WrongDevice(
        f"{received_text} came from {url}, but no frame of this link",
        "choose another port (heli-host ports lists them), or flash the firmware of this release",
        parser.bytes_received,
        excerpt,
    )
