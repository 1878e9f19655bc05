"""Scripts for parts of the flight code: arithmetic, the line under load, the parameters' flash."""

from __future__ import annotations

import math
import random
import struct
import zlib
from collections.abc import Iterator, Sequence
from typing import Any, Final

import numpy as np
from heli_host import declaration as d
from heli_host.link.frames import encode_frame
from heli_test_native import control
from heli_test_native import law as native_law
from heli_test_native import link as core_link

from tests.flight.scripts import Laws, Notes

_SUM: Final = next(operation.code for operation in d.OPERATIONS if operation.name == "sum_of_products")


def _bits(chance: random.Random, count: int) -> np.ndarray[Any, np.dtype[np.uint32]]:
    """Any bits, with a third of them near each other and some at the ends of the range."""
    words = [chance.getrandbits(32) for _ in range(count)]
    words[::7] = [
        chance.choice((0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x3F800000, 0x7F800000)) for _ in words[::7]
    ]
    words[::3] = [0x3D000000 + word % 0x05000000 | word & 0x80000000 for word in words[::3]]
    # The ends of each power of two, where ranges of arguments meet.
    words[::5] = [chance.randrange(512) << 23 | chance.choice((0, 1, 0x7FFFFF)) for _ in words[::5]]
    return np.array(words, np.uint32)


def operations(notes: Notes, _laws: Any) -> None:
    """Every operation of a tape, on any bits."""
    chance = notes.chance
    pairs = _bits(chance, 6000).view(np.float32).reshape(-1, 2)
    angles = np.array(
        [[chance.uniform(-9000.0, 9000.0), chance.uniform(-2.0, 2.0)] for _ in range(1500)], np.float32
    )
    operands = np.ascontiguousarray(np.vstack([pairs, angles]))
    for operation in d.OPERATIONS:
        if operation.name not in ("select", "sum_of_products"):
            notes.add(operation.name, _recorded(native_law.operate(operation.code, operands)))


def _recorded(results: Any) -> bytes:
    """Bytes of numbers; the sign and payload of "no number" may differ between processors."""
    return np.where(np.isnan(results), np.float32(7.0), results).astype("<f4").tobytes()


def fixed_point(notes: Notes, _laws: Any) -> None:
    """Sums, products, roots and conversions of fixed-point numbers, the mixer and the filter."""
    chance = notes.chance
    raw = [int(word) - (1 << 31) for word in _bits(chance, 4000)]
    pairs = list(zip(raw[::2], raw[1::2], strict=True))
    for name in ("quantity_sum", "quantity_difference", "quantity_product"):
        operate = getattr(control, name)
        notes.add(name, struct.pack(f"<{len(pairs)}i", *(operate(a, b) for a, b in pairs)))
    floats = [struct.unpack("<f", struct.pack("<I", word & 0xFFFFFFFF))[0] for word in raw]
    floats = [1.5 if math.isnan(value) else value for value in floats] + [
        chance.uniform(-130.0, 130.0) for _ in range(500)
    ]
    notes.add("quantity", struct.pack(f"<{len(floats)}i", *(control.quantity(value) for value in floats)))
    roots = [chance.getrandbits(chance.randrange(1, 62)) for _ in range(1500)]
    notes.add("square_root", struct.pack(f"<{len(roots)}I", *(control.square_root(value) for value in roots)))
    small = [chance.uniform(1e-3, 1e4) for _ in range(500)]
    notes.add("reciprocal", struct.pack("<500f", *(control.reciprocal(value) for value in small)))
    mixed = bytearray()
    for _ in range(1500):
        volts = [chance.choice((chance.uniform(-15.0, 15.0), 0.0, 2.0)) for _ in range(3)]
        least_V, most_V = chance.uniform(-10.0, 0.0), chance.uniform(0.1, 12.0)
        mixed += struct.pack("<4f", *control.mix(volts[0], volts[1], least_V, most_V, abs(volts[2])))
        mixed += struct.pack(
            "<f", control.motor_from_lift_V(chance.uniform(-0.1, 0.1), chance.choice((0.0, 1.0, 5.0)))
        )
    notes.add("mixer", bytes(mixed))
    rates, smooth = control.RateFilter(), chance.uniform(0.003, 0.7)
    notes.add(
        "rate", struct.pack("<500f", *(rates.update(chance.uniform(-2.0, 2.0), smooth) for _ in range(500)))
    )


def line_under_load(notes: Notes, _laws: Any) -> None:
    """Samples and events of any size, commands and streams, while the transmitter takes little or nothing."""
    chance = notes.chance
    harness = core_link.Harness(2100, 512)
    tick, sent, tapes = 0, bytearray(), bytearray()
    harness.receive(encode_frame(d.MessageId.HELLO, 0, d.HelloMessage(1, d.LINK_HASH, 7).pack()))
    harness.poll()
    harness.sent()
    row = [0] * len(d.Channel)
    for k in range(3500):
        harness.begin_tick(tick)
        size = chance.choice((0, 1, 2, 7, 8, 100, 127, 128, 30000, 1 << 30))
        row = [value + chance.randrange(-size, size + 1) if chance.random() < 0.3 else value for value in row]
        row = [
            min(max(value, 0), 255)
            if channel.scale == 1.0 and channel.kind
            else min(max(value, -32768), 32767)
            if size < 1 << 20
            else max(min(value, 2**31 - 1), -(2**31))
            for value, channel in zip(row, d.CHANNELS, strict=True)
        ]
        harness.push_samples(tick, np.array([row], np.int32))
        if chance.random() < 0.05:
            harness.push_event(tick, chance.randrange(20))
        if chance.random() < 0.15:
            kind, *fields = chance.choice(
                (
                    (d.PingMessage, k),
                    (d.StopMessage,),
                    (d.ArmMessage,),
                    (d.StatusReadMessage,),
                    (d.ControllerReadMessage, k % 4),
                    (d.ParamsReadMessage, k % 70),
                    (d.ControlMessage, 7, 1.0, 2.0),
                )
            )
            number = chance.choice((k & 0xFF, 5))
            harness.receive(
                encode_frame(kind.ID, k & 0xFF if chance.random() < 0.9 else 3, kind(number, *fields).pack())
            )
        for _ in range(chance.choice((0, 0, 0, 1, 6))):
            stream: Any = chance.choice(
                (
                    d.SetpointMessage(k, 0.1, 0.2, 0.3),
                    d.VoltagesMessage(1.0, 2.0, k),
                    d.FollowingMessage(0.1, 0.2, k),
                )
            )
            harness.receive(encode_frame(stream.ID, k & 0xFF, stream.pack()))
        for _ in range(chance.choice((0, 1, 2, 2))):
            harness.room = (
                chance.choice((0, 20, 60, 200, 4096)) if k % 900 < 600 else chance.choice((0, 0, 0, 0, 400))
            )
            harness.poll()
        if chance.random() < 0.8:
            request = harness.take_request()
            if request is not None:
                tapes += bytes([request[0]]) + request[1]
                harness.answer(chance.choice((0, 0, 4)), k & 0xFF, 0.5 * k)
            for _ in range(chance.choice((1, 9))):
                value = harness.take_stream()
                if value is not None:
                    tapes += bytes([value[0]]) + value[1]
        harness.publish(k)
        sent += harness.sent() + struct.pack("<I", harness.ticks_since_host_frame())
        tick = (tick + chance.choice((1, 1, 1, 1, 1, 1, 1, 1, 2))) & 0xFFFFFFFF
        if k % 250 == 249:
            notes.add("sent", bytes(sent))
            notes.add("taken", bytes(tapes))
    harness.room = 100_000
    harness.receive(encode_frame(d.MessageId.STATUS_READ, 9, d.StatusReadMessage(1).pack()))
    harness.poll()
    notes.add("last", harness.sent())


def parameters_in_flash(notes: Notes, _laws: Any) -> None:
    """Sets of parameters are saved, cut off by a loss of power, damaged, and loaded."""
    chance = notes.chance
    board = core_link.Board(2100, 512)
    for k in range(120):
        params = core_link.Params()
        store = core_link.Store(board)
        source = store.load(params)
        values = np.array(params.values(), "<f4").tobytes()
        notes.add(
            f"{source} {store.generation} {store.origin[:2]} {params.consistent()}", values + board.flash
        )
        for _ in range(5):
            spec = chance.choice(d.PARAMS)
            params.set(spec.index, chance.uniform(spec.min, spec.max), True)
        board.steps_left = chance.choice((None, chance.randrange(2100), 1024, 1023, 512))
        store.save(params)
        board.steps_left = None
        if k % 3 == 0:
            flash = bytearray(board.flash)
            flash[chance.randrange(len(flash))] ^= 1 << chance.randrange(8)
            board.flash = bytes(flash)
        if k % 20 == 19:
            board.flash = bytes(chance.choice((0, 0xFF, chance.randrange(256))) for _ in board.flash)


def _changed_tapes(words: Sequence[int]) -> Iterator[list[int]]:
    """A law with each bit changed, with each field at its ends, and with each length."""
    for place, word in enumerate(words):
        others = [word ^ 1 << bit for bit in range(32)]
        for shift in (0, 9, 18):
            rest = word & ~(0x1FF << shift)
            ends = (0, 1, 16, 17, 18, len(words) - place - 1, len(words) - place, len(words) - place + 1, 511)
            others += [rest | (end & 0x1FF) << shift for end in ends]
        others += [word & 0x07FFFFFF | code << 27 for code in range(32)]
        others += [
            _SUM << 27 | word & 0x07FC0000 | min(len(words) - place + more, 511) % 512
            for more in (-2, -1, 0, 1)
        ]
        yield from ([*words[:place], other, *words[place + 1 :]] for other in others)
    yield from (list(words[:length]) for length in range(len(words)))


def _program(chance: random.Random) -> list[int]:
    """A program of any length, of operations on any cells that have a value."""
    constants, parameters, states, signals = (chance.randrange(5) for _ in range(4))
    numbers = [int(word) for word in _bits(chance, constants + parameters + states)]
    first_written = len(d.LAW_INPUTS) + len(numbers)
    instructions: list[int] = []
    written = list(range(first_written))
    length = chance.choice((1, 3, 30, 250, 900))
    while len(instructions) < length:
        target = chance.randrange(first_written, first_written + 40)
        code = chance.randrange(len(d.OPERATIONS))
        first, second = chance.choice(written), chance.choice(written)
        if code == _SUM:
            terms = chance.choice((1, 2, 7))
            instructions.append(code << 27 | target << 18 | terms)
            pairs = [(chance.choice(written), chance.choice(written)) for _ in range(terms)]
            instructions += [chance.randrange(2) << 31 | a << 9 | b for a, b in pairs]
        else:
            binary = d.OPERATIONS[code].operands > 1
            instructions.append(code << 27 | target << 18 | first << 9 | (second if binary else 0))
        written.append(target)
    old = range(first_written - states)
    outputs = [chance.choice(written) for _ in range(5 + signals)]
    outputs += [chance.choice([*old, *written[first_written:]]) for _ in range(states)]
    head = d.LAW_FORMAT | chance.choice((1, 2, 4, 10, 40, 3)) << 8 | signals << 16 | parameters << 24
    return [head, constants | states << 16, len(instructions), *numbers, *outputs, *instructions]


def tapes(notes: Notes, laws: Laws) -> None:
    """Laws with one mistake, and programs of any kind, are verified; those that are accepted run."""
    chance = notes.chance
    inputs = np.array([[chance.uniform(-1.0, 1.0) for _ in d.LAW_INPUTS] for _ in range(4)], np.float32)
    programs = {name: _changed_tapes(words) for name, (words, _) in laws.items()}
    programs |= {f"any {k}": (_program(chance) for _ in range(60)) for k in range(3)}
    for name, changes in programs.items():
        verdicts = bytearray()
        for number, changed in enumerate(changes):
            tape = native_law.Tape()
            crc = zlib.crc32(struct.pack(f"<{len(changed)}I", *changed))
            error, value, ticks = tape.load(changed, crc ^ (number % 50 == 49))
            verdicts += struct.pack("<BII", error, value, ticks)
            if error == d.LawError.NONE:
                tape.restart()
                verdicts.append(tape.set_parameter(number % 4, 1.25))
                verdicts += _recorded(tape.run(inputs))
        notes.add(name, bytes(verdicts))
