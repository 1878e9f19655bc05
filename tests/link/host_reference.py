"""The telemetry codec and the frame in the slowest, plainest words, written from docs/link.md alone.

The witness for heli_host.link: it shares no line, no table and no library with it.
"""

from __future__ import annotations

import struct

BITS_OF_CODE = (0, 2, 4, 8, 16, 32)
BASE_SIZES = (4, 4, 4, 4, 4, 4, 2, 2, 1, 1, 1)
BASE_SIGNED = (True, True, True, True, True, True, True, True, False, False, False)


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


def telemetry_payload(first_tick: int, samples: list[list[int]], codes: list[int] | None = None) -> bytes:
    """Pack samples (a row a tick, 11 channels) into one telemetry payload, as narrow as they go."""
    count = len(samples)
    deltas = [
        [signed(samples[k][channel] - samples[k - 1][channel], 32) for k in range(1, count)]
        for channel in range(11)
    ]
    codes = [smallest_code(column) for column in deltas] if codes is None else codes
    out = bytearray(first_tick.to_bytes(4, "little"))
    out.append(count)
    nibbles = [*codes, 0]
    for pair in range(6):
        out.append(nibbles[2 * pair] + 16 * nibbles[2 * pair + 1])
    for channel in range(11):
        size = BASE_SIZES[channel]
        out += (samples[0][channel] % (1 << (8 * size))).to_bytes(size, "little")
    for channel in range(11):
        bits = BITS_OF_CODE[codes[channel]]
        number = 0
        for position, delta in enumerate(deltas[channel]):
            number += (delta % (1 << bits)) << (position * bits) if bits else 0
        out += number.to_bytes(((count - 1) * bits + 7) // 8, "little")
    return bytes(out)


def telemetry_samples(payload: bytes) -> tuple[int, list[list[int]]]:
    """Unpack one telemetry payload: the first tick and a row of 11 channels a tick."""
    first_tick = int.from_bytes(payload[:4], "little")
    count = payload[4]
    codes = []
    for byte in payload[5:11]:
        codes += [byte % 16, byte // 16]
    position = 11
    row = []
    for channel in range(11):
        size = BASE_SIZES[channel]
        row.append(int.from_bytes(payload[position : position + size], "little", signed=BASE_SIGNED[channel]))
        position += size
    rows = [row]
    columns = []
    for channel in range(11):
        bits = BITS_OF_CODE[codes[channel]]
        size = ((count - 1) * bits + 7) // 8
        number = int.from_bytes(payload[position : position + size], "little")
        position += size
        columns.append([signed(number >> (k * bits), bits) if bits else 0 for k in range(count - 1)])
    if position != len(payload):
        raise ValueError("payload length does not fit its header")
    for k in range(count - 1):
        rows.append([signed(rows[-1][channel] + columns[channel][k], 32) for channel in range(11)])
    return first_tick, rows
