"""The telemetry codec and the frame in plain, slow Python, written from docs/reference/link.md alone.

The witness for heli_host.link: it shares no line, no table and no library with it.
"""

import re
import struct
from pathlib import Path

BITS_OF_CODE = (0, 2, 4, 8, 16, 32)
LINK_DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "reference" / "link.md"


def channel_types(document: str) -> list[str]:
    """Wire types of the telemetry channels, from the document's table of them."""
    table = document.partition("| channel | base |")[2].partition("\n\n")[0]
    return re.findall(r"^\| `\w+` \| (\w+) \|", table, re.MULTILINE)


TYPES = channel_types(LINK_DOCUMENT.read_text(encoding="utf-8"))


def size_of(wire_type: str) -> int:
    """Bytes of a number: 2 for i16."""
    return int(wire_type[1:]) // 8


def is_signed(wire_type: str) -> bool:
    """Whether a type has a sign: i16, not u16."""
    return wire_type[0] == "i"


def limits(wire_type: str) -> tuple[int, int]:
    """Least and most of a type, as a row of int32 holds them."""
    bits = 8 * size_of(wire_type)
    if is_signed(wire_type) or bits == 32:
        return -(1 << (bits - 1)), (1 << (bits - 1)) - 1
    return 0, (1 << bits) - 1


def in_row(value: int, wire_type: str) -> int:
    """A number of a type as a row of int32 holds it."""
    return signed(value, 32) if size_of(wire_type) == 4 else value


def crc32(data: bytes) -> int:
    """CRC-32 of IEEE 802.3, one bit at a time."""
    crc = 0xFFFFFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ (0xEDB88320 if crc & 1 else 0)
    return crc ^ 0xFFFFFFFF


def cobs_encode(data: bytes) -> bytes:
    """Consistent overhead byte stuffing: every block of non-zero bytes gets its length + 1 in front."""
    out = bytearray()
    block = bytearray()
    for byte in data:
        if byte == 0:
            out.append(len(block) + 1)
            out += block
            block.clear()
            continue
        block.append(byte)
        if len(block) == 254:
            out.append(255)
            out += block
            block.clear()
    out.append(len(block) + 1)
    out += block
    return bytes(out)


def frame(message_id: int, seq: int, payload: bytes) -> bytes:
    """One frame with its delimiter."""
    plain = bytes([1, message_id, seq % 256]) + payload
    return cobs_encode(plain + crc32(plain).to_bytes(4, "little")) + b"\x00"


def f32(value: float) -> bytes:
    """IEEE 754 single precision, least significant byte first."""
    return struct.pack("<f", value)


def signed(value: int, bits: int) -> int:
    """Two's complement of the low ``bits`` bits."""
    value %= 1 << bits
    return value - (1 << bits) if value >= 1 << (bits - 1) else value


def smallest_code(deltas: list[int]) -> int:
    """Code of the narrowest width that holds every delta."""
    for code, bits in enumerate(BITS_OF_CODE):
        if bits == 0:
            if all(delta == 0 for delta in deltas):
                return code
        elif all(-(1 << (bits - 1)) <= delta < 1 << (bits - 1) for delta in deltas):
            return code
    raise AssertionError("a delta modulo 2^32 fits 32 bits")


def telemetry_payload(
    first_tick: int, samples: list[list[int]], codes: list[int] | None = None, types: list[str] = TYPES
) -> bytes:
    """Pack samples (a row a tick, one number a channel) into one telemetry payload, as narrow as they go."""
    count = len(samples)
    deltas = [
        [signed(samples[k][channel] - samples[k - 1][channel], 32) for k in range(1, count)]
        for channel in range(len(types))
    ]
    codes = [smallest_code(column) for column in deltas] if codes is None else codes
    out = bytearray(first_tick.to_bytes(4, "little"))
    out.append(count)
    nibbles = [*codes, 0]  # the 0 fills the last byte of an odd number of channels
    for pair in range((len(types) + 1) // 2):
        out.append(nibbles[2 * pair] + 16 * nibbles[2 * pair + 1])
    for channel, wire_type in enumerate(types):
        size = size_of(wire_type)
        out += (samples[0][channel] % (1 << (8 * size))).to_bytes(size, "little")
    for channel in range(len(types)):
        bits = BITS_OF_CODE[codes[channel]]
        number = 0
        for position, delta in enumerate(deltas[channel]):
            number += (delta % (1 << bits)) << (position * bits) if bits else 0
        out += number.to_bytes(((count - 1) * bits + 7) // 8, "little")
    return bytes(out)


def telemetry_samples(payload: bytes, types: list[str] = TYPES) -> tuple[int, list[list[int]]]:
    """Unpack one telemetry payload: the first tick and a row of one number a channel for each tick."""
    first_tick = int.from_bytes(payload[:4], "little")
    count = payload[4]
    # A code of 4 bits per channel, the first in the low half of its byte: the width of its differences.
    position = 5 + (len(types) + 1) // 2
    codes = []
    for byte in payload[5:position]:
        codes += [byte % 16, byte // 16]
    # The first tick's numbers as they are, then each channel's differences from tick to tick.
    row = []
    for wire_type in types:
        base = payload[position : position + size_of(wire_type)]
        row.append(in_row(int.from_bytes(base, "little", signed=is_signed(wire_type)), wire_type))
        position += len(base)
    rows = [row]
    columns = []
    for channel in range(len(types)):
        bits = BITS_OF_CODE[codes[channel]]
        size = ((count - 1) * bits + 7) // 8
        number = int.from_bytes(payload[position : position + size], "little")
        position += size
        columns.append([signed(number >> (k * bits), bits) if bits else 0 for k in range(count - 1)])
    if position != len(payload):
        raise ValueError("payload length does not fit its header")
    for k in range(count - 1):
        rows.append([signed(value + columns[channel][k], 32) for channel, value in enumerate(rows[-1])])
    return first_tick, rows
