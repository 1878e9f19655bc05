"""The scripts whose outcome is recorded, by name. Each reaches another part of the flight code."""

import math
import random
import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
from heli_host import declaration as d
from heli_host.link.frames import encode_frame
from heli_test_native import control
from heli_test_native import law as native_law
from heli_test_native import link as core_link

from tests.flight.harness import NO_AXES, WITHOUT_TRAVEL
from tests.flight.scripts import LEVEL_DEG, Board, Laws, Notes, hover, land, take_off, values_at_edges, wander

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
    divisors = [chance.uniform(1e-3, 1e4) for _ in range(500)]
    notes.add("reciprocal", struct.pack("<500f", *(control.reciprocal(divisor) for divisor in divisors)))
    mixed = bytearray()
    for _ in range(1500):
        collective_V, differential_V, differential_max_V = (
            chance.choice((chance.uniform(-15.0, 15.0), 0.0, 2.0)) for _ in range(3)
        )
        least_V, most_V = chance.uniform(-10.0, 0.0), chance.uniform(0.1, 12.0)
        mixed += struct.pack(
            "<4f", *control.mix(collective_V, differential_V, least_V, most_V, abs(differential_max_V))
        )
        mixed += struct.pack(
            "<f", control.motor_from_lift_V(chance.uniform(-0.1, 0.1), chance.choice((0.0, 1.0, 5.0)))
        )
    notes.add("mixer", bytes(mixed))
    rates, smooth = control.RateFilter(), chance.uniform(0.003, 0.7)
    notes.add(
        "rate", struct.pack("<500f", *(rates.update(chance.uniform(-2.0, 2.0), smooth) for _ in range(500)))
    )


def _changed_row(row: list[int], size: int, chance: random.Random) -> list[int]:
    """Return a row of which some numbers changed by at most `size`, each within the range of its channel."""
    changed = [value + chance.randrange(-size, size + 1) if chance.random() < 0.3 else value for value in row]
    # Large changes need the range of 32 bits; after small ones the numbers stay within 16.
    low, high = (-(1 << 15), (1 << 15) - 1) if size < 1 << 20 else (-(1 << 31), (1 << 31) - 1)
    return [
        min(max(value, 0), 255) if channel.scale == 1.0 and channel.kind else min(max(value, low), high)
        for value, channel in zip(changed, d.CHANNELS, strict=True)
    ]


def _command_frame(k: int, chance: random.Random) -> bytes:
    """Return a command, sometimes with a request or a sequence number that another has had."""
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
    request = chance.choice((k & 0xFF, 5))
    sequence = k & 0xFF if chance.random() < 0.9 else 3
    return encode_frame(kind.ID, sequence, kind(request, *fields).pack())


def line_under_load(notes: Notes, _laws: Any) -> None:
    """Samples and events of any size, commands and streams, while the transmitter takes little or nothing."""
    chance = notes.chance
    harness = core_link.Harness(2100, 512)
    tick, sent, executed = 0, bytearray(), bytearray()
    harness.receive(
        encode_frame(d.MessageId.HELLO, 0, d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=7).pack())
    )
    harness.poll()
    harness.sent()
    row = [0] * len(d.Channel)
    for k in range(3500):
        harness.begin_tick(tick)
        size = chance.choice((0, 1, 2, 7, 8, 100, 127, 128, 30000, 1 << 30))
        row = _changed_row(row, size, chance)
        harness.push_samples(tick, np.array([row], np.int32))
        if chance.random() < 0.05:
            harness.push_event(tick, chance.randrange(20))
        if chance.random() < 0.15:
            harness.receive(_command_frame(k, chance))
        for _ in range(chance.choice((0, 0, 0, 1, 6))):
            stream: Any = chance.choice(
                (
                    d.SetpointMessage(apply_tick=k, elevation_rad=0.1, pitch_rad=0.2, travel_rad=0.3),
                    d.VoltagesMessage(front_V=1.0, back_V=2.0, valid_ms=k),
                    d.FollowingMessage(elevation_rad=0.1, pitch_rad=0.2, travel_rad=k),
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
                message_id, payload = request
                executed += bytes([message_id]) + payload
                harness.answer(chance.choice((0, 0, 4)), k & 0xFF, 0.5 * k)
            for _ in range(chance.choice((1, 9))):
                value = harness.take_stream()
                if value is not None:
                    message_id, payload = value
                    executed += bytes([message_id]) + payload
        harness.publish(k)
        sent += harness.sent() + struct.pack("<I", harness.ticks_since_host_frame())
        tick = (tick + chance.choice((1, 1, 1, 1, 1, 1, 1, 1, 2))) & 0xFFFFFFFF
        if k % 250 == 249:
            notes.add("sent", bytes(sent))
            notes.add("taken", bytes(executed))
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
            params.set(spec.index, chance.uniform(spec.min, spec.max), idle=True)
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
    # A word: the operation in 5 bits from 27, then fields of 9 bits from 18, 9 and 0, which mostly are cells.
    for place, word in enumerate(words):
        others = [word ^ 1 << bit for bit in range(32)]
        for shift in (0, 9, 18):
            rest = word & ~(0x1FF << shift)
            ends = (0, 1, 16, 17, 18, len(words) - place - 1, len(words) - place, len(words) - place + 1, 511)
            others += [rest | (end & 0x1FF) << shift for end in ends]
        others += [word & 0x07FFFFFF | code << 27 for code in range(32)]
        # Sums of products whose terms end before, at and behind the end of the law.
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


def excitations(board: Board, _laws: Laws) -> None:
    """Each signal in closed loop, with values that are allowed and values that are not."""
    take_off(board)
    for kind in (1, 2, 3, 4, 5):
        for _ in range(2):
            chance = board.chance
            start_Hz = 3.0 * chance.random()
            stop_Hz = chance.choice((start_Hz, start_Hz + 4.0, 500.0))
            board.ask(
                d.ExciteMessage,
                kind=kind,
                front_V=chance.random(),
                back_V=-chance.random(),
                start_Hz=start_Hz,
                stop_Hz=stop_Hz,
                duration_s=0.7,
                seed=9 + kind,
            )
            hover(board, 0.9, LEVEL_DEG)
    # Kind, front_V, back_V, start_Hz, stop_Hz, duration_s and seed: each at its limit or just beyond it.
    for fields in (
        (0, 0.1, 0.1, 1.0, 2.0, 1.0, 1),
        (6, 0.1, 0.1, 1.0, 2.0, 1.0, 1),
        (1, 2.0, -2.0, 0.0, 0.0, 0.001, 0),
        (1, 2.001, 0.0, 0.0, 0.0, 1.0, 0),
        (1, 0.0, -2.001, 0.0, 0.0, 1.0, 0),
        (3, 0.1, 0.1, -0.1, 2.0, 1.0, 1),
        (3, 0.1, 0.1, 500.0, 500.0, 0.1, 1),
        (4, 0.1, 0.1, 500.1, 501.0, 1.0, 1),
        (4, 0.1, 0.1, 2.0, 1.0, 1.0, 1),
        (5, 0.1, 0.1, 0.0, 0.01, 0.1, 1),
        (5, 0.1, 0.1, 0.0, 0.009, 0.1, 1),
        (5, 0.1, 0.1, 0.0, 500.0, 0.1, 0),
        (1, 0.1, 0.1, 0.0, 0.0, 0.0009, 0),
        (1, 0.1, 0.1, 0.0, 0.0, 120.1, 0),
        (1, 0.1, 0.2, 0.0, 0.0, 120.0, 0),
    ):
        board.ask(d.ExciteMessage, *fields)
        hover(board, 0.1, LEVEL_DEG)
    board.ask(d.ExciteStopMessage)
    land(board, 500)


def parameters_at_edges(board: Board, _laws: Laws) -> None:
    """Each parameter is set to its ends and beyond, idle and in flight, and read back."""
    for spec in d.PARAMS:
        for value in values_at_edges(spec):
            board.request = board.request % 255 + 1
            board.send(d.ParamSetMessage(board.request, spec.index, value))
            board.run(2)
        board.set(**{spec.name: spec.default})
    for first in (0, 1, len(d.PARAMS) - 1, len(d.PARAMS), 40):
        board.ask(d.ParamsReadMessage, first)
    board.ask(d.ParamSetMessage, len(d.PARAMS), 1.0)
    board.set(hover_V=1.5)
    board.ask(d.ParamsSaveMessage)
    board.ask(d.ParamsDefaultMessage)
    board.ask(d.ArmMessage)
    for spec in d.PARAMS:
        board.ask(d.ParamSetMessage, spec.index, spec.default)
    board.ask(d.ParamsDefaultMessage)
    board.ask(d.ParamsSaveMessage)


def inconsistent(board: Board, _laws: Laws) -> None:
    """Sets of parameters that fit together just so, or just not."""
    for names in (
        {"motor_max_V": 12.0}, {"motor_max_V": 12.001}, {"motor_min_V": -12.0}, {"motor_min_V": -12.001},
        {"pitch_setpoint_max_deg": 45.0}, {"pitch_max_deg": 30.0}, {"pitch_max_deg": 29.0},
        {"setpoint_hold_s": 2.0}, {"setpoint_hold_s": 2.001}, {"setpoint_land_s": 0.5},
        {"elevation_max_deg": 2.0}, {"elevation_max_deg": 1.0}, {"travel_max_deg": 10.0},
        {"elevation_rest_deg": 0.0}, {"pitch_motion_V": 1.4}, {"hover_V": 0.0}, {"controller": 1.0},
        {"elevation_counts_per_rev": -4096.0}, {"motor_front_sign": -1.0}, {"motor_back_sign": 0.0},
    ):  # fmt: skip
        board.set(**names)
        board.ask(d.ArmMessage)
        board.run(5)
        board.ask(d.StopMessage)
        board.ask(d.ParamsDefaultMessage)


def moved_by_hand(board: Board, _laws: Laws) -> None:
    """A person moves the arm: arming near its conditions, limits in flight, broken encoders."""
    # Counts about the tolerances of arming: 2 degrees of elevation, 10 of pitch, 175 of travel.
    near_its_limit = {0: (22, 23, 24), 1: (113, 114, -115), 2: (1991, 1992, -2000)}
    for axis, counts in ((axis, counts) for axis, values in near_its_limit.items() for counts in values):
        board.shift[axis] = counts
        board.run(1)
        board.ask(d.ArmMessage)
        board.run(1200)
        board.ask(d.ArmMessage)
        board.run(20)
        board.ask(d.StopMessage)
        board.shift[axis] = 0
        board.run(1000)
    # Counts beyond the limits of the angles, slowly, then fewer of them beyond the limits of the rates.
    for axis, jump in ((0, 560), (1, 515), (2, 2010), (0, 40), (1, 120), (2, 60)):
        board.ask(d.ArmMessage)
        board.ask(d.ControlMessage, axes=NO_AXES, front_V=0.5, back_V=0.5)
        board.run(20)
        for _ in range(20):
            board.shift[axis] += jump // 20
            board.run(5 if jump > 200 else 1)
        board.run(30)
        board.ask(d.ArmMessage)
        board.ask(d.ClearFaultMessage)
        board.shift[axis] = 0
        board.run(1500)
    # encoder_illegal_max transitions, and one more.
    for axis in range(3):
        for illegal in (5, 6):
            board.ask(d.ArmMessage)
            board.illegal[axis] += illegal
            board.run(3)
            board.ask(d.StopMessage)
            board.ask(d.ClearFaultMessage)
    # As many late ticks as overrun_max tolerates, then one.
    for late_ticks in (10, 1):
        board.ask(d.ArmMessage)
        board.is_late = True
        board.run(late_ticks)
        board.is_late = False
        board.ask(d.ControlMessage, axes=NO_AXES, front_V=0.2, back_V=0.2)
    board.ask(d.ClearFaultMessage)
    for stop in (True, False):
        board.ask(d.ArmMessage)
        board.core.stop_input(stop)
        board.run(5)
        board.ask(d.ClearFaultMessage)
    board.core.stop_input(False)
    for edges in (3, 0):
        board.core.overload(edges)
        board.run(2)
        board.ask(d.ArmMessage)
    board.core.overload(7)
    board.run(5)
    board.core.overload(0)
    board.ask(d.ZeroMessage, axes=0)
    board.ask(d.ZeroMessage, axes=8)
    board.ask(d.ClearFaultMessage)
    board.shift = [30, -40, 70]
    for axes in (1, 2, 4, 7):
        board.ask(d.ZeroMessage, axes=axes)
        board.run(60)


def _random_message(board: Board) -> Any:
    chance = board.chance
    volts = (chance.choice((0.0, 1.0, 1.7, 10.0, 10.001, -0.001)), chance.choice((0.0, 1.5, 10.0, 12.0)))
    return chance.choice(
        (
            (d.ArmMessage,),
            (d.StopMessage,),
            (d.LandMessage,),
            (d.StreamMessage,),
            (d.ClearFaultMessage,),
            (d.ControlMessage, chance.randrange(9), *volts),
            (d.ControlMessage, 7, *volts),
            (d.ControlMessage, 3, 0.0, 0.0),
            (d.ExciteMessage, chance.randrange(7), 0.4, 0.3, 0.5, 3.0, 0.5, chance.randrange(3)),
            (d.ExciteStopMessage,),
            (d.StatusReadMessage,),
            (d.PingMessage, chance.randrange(1 << 60)),
            (d.ZeroMessage, chance.randrange(9)),
            (d.ParamsReadMessage, chance.randrange(80)),
            (d.ParamsOriginReadMessage,),
            (d.ControllerReadMessage, chance.randrange(3)),
            (d.LawReadMessage,),
            (d.LawFlyMessage, chance.randrange(2)),
            (d.LawSetMessage, 0, 1.0),
            (d.LawEndMessage,),
            (d.ParamsSaveMessage,),
            (d.ArmMessage,),
            (d.ControlMessage, 7, 0.0, 0.0),
        )
    )


def any_commands(board: Board, _laws: Laws) -> None:
    """Commands in any order, some of them lost, repeated or damaged on the line."""
    for _ in range(220):
        kind, *fields = _random_message(board)
        accident = board.chance.random()
        if accident < 0.8:
            board.ask(kind, *fields)
        elif accident < 0.9:
            # Another command with the number of the last one, as if it were its repetition.
            board.send(kind(board.request, *fields))
            board.run(2)
        else:
            # A bit is wrong; in half of these frames the zero at the end is missing too.
            frame = bytearray(encode_frame(kind.ID, board.sequence & 0xFF, kind(1, *fields).pack()))
            frame[board.chance.randrange(len(frame))] ^= 1 << board.chance.randrange(8)
            board.raw(bytes(frame) + (b"\0" if accident < 0.95 else b""))
        for _ in range(board.chance.choice((0, 0, 1, 5, 20))):
            board.point(
                elevation_deg=8.0 * board.chance.random(),
                pitch_deg=0.0,
                travel_deg=20.0 * board.chance.random(),
                ahead_ms=board.chance.randrange(-40, 40),
            )
            board.run(board.chance.choice((1, 10, 20, 30)))
    board.ask(d.StatusReadMessage)


def noise_on_the_line(board: Board, _laws: Laws) -> None:
    """Bytes that are no frames, frames of each length with a right checksum, and numbers that are none."""
    chance = board.chance
    for k in range(150):
        board.raw(
            bytes(chance.randrange(256) for _ in range(chance.choice((1, 5, 60, 300)))) + b"\0" * (k % 3)
        )
        length, number = chance.choice((0, 1, 2, 3, 14, 17, 53, 64)), chance.randrange(256)
        board.raw(
            encode_frame(number, chance.randrange(256), bytes(chance.randrange(256) for _ in range(length)))
        )
        bad = struct.unpack("<f", struct.pack("<I", chance.choice((0x7F800000, 0xFF800000, 0x7FC00000))))[0]
        board.raw(
            encode_frame(d.MessageId.SETPOINT, 0, struct.pack("<Ifff", 0, *chance.sample((0.0, 0.1, bad), 3)))
        )
        board.raw(
            encode_frame(
                d.MessageId.CONTROL, 0, struct.pack("<BBff", k & 0xFF, 7, *chance.sample((bad, 1.0), 2))
            )
        )
        board.run(chance.choice((1, 3)))
        if k % 10 == 0:
            board.ask(d.StatusReadMessage)


_ROUGH: Final = {"gust_rad_s2": 0.3, "friction_rad_s2": 0.02}


@dataclass(frozen=True)
class Script:
    """What is done to a board, and the arm that its motors move."""

    play: Callable[[Any, Laws], None]
    arm: dict[str, float] = field(default_factory=dict)


def flight(board: Board, _laws: Laws) -> None:
    """Rise, wander, land."""
    take_off(board)
    wander(board, 8.0)
    land(board)


def other_parameters(board: Board, _laws: Laws) -> None:
    """A flight with every parameter a little off, then one with parameters that change in flight."""
    for spec in d.PARAMS:
        if spec.name.endswith(("counts_per_rev", "sign", "controller", "rest_deg", "supply_V")):
            continue
        perturbed = spec.default * (1.0 + 0.2 * (2.0 * board.chance.random() - 1.0))
        value = round(perturbed) if spec.integer else perturbed
        board.set(**{spec.name: min(max(value, spec.min), spec.max)})
    take_off(board, seconds=2.0)
    for _ in range(12):
        spec = board.chance.choice([spec for spec in d.PARAMS if not spec.idle_only])
        board.set(**{spec.name: spec.default * (0.8 + 0.4 * board.chance.random())})
        wander(board, 1.0)
    land(board)
    board.ask(d.ParamsSaveMessage)
    board.ask(d.ParamsOriginReadMessage)


def encoder_dies(board: Board, _laws: Laws, axis: int) -> None:
    """An encoder stops counting in flight; the board lands."""
    take_off(board)
    wander(board, 3.0)
    board.freeze(axis)
    wander(board, 6.0, (5.0, 0.0, 20.0) if axis else (12.0, 0.0, 20.0))
    board.run(3000)
    board.ask(d.ClearFaultMessage)
    board.ask(d.StatusReadMessage)


def encoders_die(board: Board, _laws: Laws, axis: int) -> None:
    """An encoder dies again and again, at any moment, also under a hard drive and on the ground."""
    chance = board.chance
    for _ in range(9):
        board.set(travel_motion_deg=4.0 + 8.0 * chance.random(), motion_s=0.3 + chance.random())
        board.set(following_s=0.3 + chance.random(), travel_motion_s=0.5 + chance.random())
        board.arm.gain = chance.choice((0.5, 1.0, 1.5))
        take_off(board, 10.0 * (chance.random() - 0.5), 1.5 + 2.0 * chance.random())
        wander(board, chance.choice((0, 1, 2)), (10.0, 0.0, 40.0))
        board.freeze(axis)
        span_deg = chance.choice(((14.0, 0.0, 100.0), (2.0, 0.0, 10.0)))
        for _ in range(6):
            wander(board, 1.0, span_deg)
            if board.core.state in (d.State.FAULT, d.State.EMERGENCY_LANDING):
                break
        board.run(chance.choice((10, 1500)))
        board.put_back()


def probes(board: Board, _laws: Laws) -> None:
    """Travel that friction holds, with an encoder that lives or not, is asked at several elevations."""
    chance = board.chance
    for k in range(6):
        board.arm.friction_rad_s2 = chance.choice((0.01, 0.02, 0.03))
        board.set(travel_silence_s=chance.choice((2.5, 1.0)), travel_motion_deg=chance.choice((8.0, 6.0)))
        take_off(board, (0.0, -10.0, 8.0)[k % 3], 3.0)
        if k % 2:
            board.freeze(2)
        hover(board, 9.0, ((0.0, -10.0, 8.0)[k % 3], 0.0, 0.0))
        board.put_back()


def host_stops(board: Board, _laws: Laws) -> None:
    """Setpoints stop; the board holds, then lands. A second flight is stopped in each state."""
    take_off(board)
    board.run(800)
    hover(board, 0.5, target_deg=(3.0, 0.0, 5.0))
    board.run(9000)
    for ticks in (5, 700, 2600):
        board.ask(d.ArmMessage)
        board.ask(d.ControlMessage, axes=WITHOUT_TRAVEL, front_V=1.0, back_V=1.0)
        hover(board, 1.0, target_deg=(-5.0, 4.0, 0.0))
        board.run(ticks)
        board.ask(d.StopMessage)
        board.run(1500)
    board.ask(d.ArmMessage)
    board.run(3000)
    board.ask(d.ArmMessage)
    board.ask(d.ControlMessage, axes=NO_AXES, front_V=1.5, back_V=1.6)
    board.run(6000)


def doublet(tilt_V: float, duration_s: float) -> dict[str, float]:
    """Return the fields of an excitation that tilts the arm to one side, then to the other."""
    return {
        "kind": d.Excitation.DOUBLET,
        "front_V": tilt_V,
        "back_V": -tilt_V,
        "start_Hz": 0.0,
        "stop_Hz": 0.0,
        "duration_s": duration_s,
        "seed": 0,
    }


def streams(board: Board, _laws: Laws) -> None:
    """The host streams voltages near hover, late, beyond their range, and with setpoints of its own."""
    take_off(board, seconds=2.0)
    board.ask(d.StreamMessage)
    for k in range(150):
        board.send(
            d.VoltagesMessage(
                front_V=1.7 + 0.2 * board.chance.random(),
                back_V=1.65,
                valid_ms=board.chance.choice((5, 30, 500)),
            )
        )
        if k % 3 == 0:
            board.send(d.FollowingMessage(elevation_rad=0.1, pitch_rad=0.01 * k, travel_rad=-0.2))
        if k % 40 == 39:
            board.send(d.VoltagesMessage(front_V=11.0, back_V=1.0, valid_ms=20))
            board.point(elevation_deg=1.0, pitch_deg=1.0, travel_deg=1.0)
        board.run(board.chance.choice((3, 10, 20)))
    board.ask(d.ExciteMessage, **doublet(tilt_V=0.3, duration_s=0.4))
    board.run(700)
    hover(board, 2.0, LEVEL_DEG)
    # Without setpoints, the board lands by itself.
    board.run(6000)


def law(board: Board, laws: Laws, name: str = "steady") -> None:
    """A law that came over the link flies, is changed in flight, and hands over."""
    board.upload(*laws[name])
    board.ask(d.LawFlyMessage, on=1)
    take_off(board)
    for on in (1, 1):
        board.ask(d.LawFlyMessage, on=on)
    wander(board, 3.0, span_deg=(4.0, 2.0, 15.0))
    board.ask(d.LawSetMessage, index=0, value=1.2)
    # Both refused: the law has no such parameter, and a law that flies is not replaced.
    board.ask(d.LawSetMessage, index=9, value=1.2)
    board.ask(d.LawBeginMessage, hash=1, words=20)
    board.ask(d.ExciteMessage, **doublet(tilt_V=0.2, duration_s=0.3))
    wander(board, 4.0, span_deg=(4.0, 2.0, 15.0))
    board.ask(d.LawReadMessage)
    board.ask(d.LawFlyMessage, on=0)
    wander(board, 4.0, span_deg=(4.0, 2.0, 15.0))
    board.ask(d.LawFlyMessage, on=1)
    hover(board, 0.4, target_deg=(1.0, 0.0, 0.0))
    land(board, 5000)


def thrown(board: Board, laws: Laws) -> None:
    """Laws fly until the board takes over, from many attitudes; then it brings the arm back."""
    chance = board.chance
    for k in range(8):
        board.upload(*laws[("throws", "steady", "own setpoints", "divides by zero")[k % 4]])
        board.set(law_envelope=chance.choice((0.5, 0.8, 1.0)), law_jump_max_V=chance.choice((2.5, 6.0)))
        take_off(board, 16.0 * (chance.random() - 0.5), 2.5)
        hover(board, 0.5, (0.0, 0.0, chance.choice((0.0, 60.0, -120.0))))
        board.ask(d.LawFlyMessage, on=1)
        board.ask(d.LawSetMessage, index=0, value=chance.choice((1.0, 0.6, 1.3, 2.0, -1.0)))
        hover(board, 3.0, target_deg=(2.0, 0.0, board.arm.angle[2] * 50.0))
        board.ask(d.LawFlyMessage, on=0)
        wander(board, 5.0, span_deg=(8.0, 0.0, 30.0))
        board.put_back()


def law_rests(board: Board, laws: Laws) -> None:
    """A law flies while friction holds travel; then the board's own controller does."""
    board.upload(*laws["steady"])
    take_off(board)
    board.ask(d.LawFlyMessage, on=1)
    hover(board, 10.0, LEVEL_DEG)
    board.ask(d.LawFlyMessage, on=0)
    hover(board, 6.0, LEVEL_DEG)
    board.ask(d.ControlMessage, axes=WITHOUT_TRAVEL, front_V=0.0, back_V=0.0)
    hover(board, 4.0, target_deg=(0.0, 2.0, 0.0))


def law_sinks(board: Board, laws: Laws) -> None:
    """A law follows a setpoint down to the table, three times."""
    board.upload(*laws["steady"])
    take_off(board, 12.0, 3.5)
    # Slow braking: the guard foresees the table from far above.
    board.set(elevation_acceleration_deg_s2=6.0)
    for low_deg in (-25.5, -20.0, -25.5):
        board.ask(d.LawFlyMessage, on=1)
        hover(board, 3.0, target_deg=(low_deg, 0.0, 0.0))
        hover(board, 4.0, target_deg=(18.0, 0.0, 0.0))


def bad_tapes(board: Board, laws: Laws) -> None:
    """A law is uploaded with one bit wrong, with words missing, and twice."""
    words, crc = laws["steady"]
    for _ in range(150):
        changed = list(words)
        changed[board.chance.randrange(len(changed))] ^= 1 << board.chance.randrange(32)
        data = struct.pack(f"<{len(changed)}I", *changed)
        board.upload(changed, zlib.crc32(data) if board.chance.random() < 0.9 else crc)
    board.upload(words[:-1], crc)
    board.ask(d.LawBeginMessage, hash=crc, words=0)
    board.ask(d.LawBeginMessage, hash=crc, words=2000)
    board.ask(d.LawPartMessage, 0, *([0] * 12))
    board.upload(words, crc)
    board.ask(d.LawEndMessage)


SCRIPTS: Final[dict[str, Script]] = {
    "fixed point": Script(fixed_point),
    "operations": Script(operations),
    "parameters in flash": Script(parameters_in_flash),
    "line under load": Script(line_under_load),
    "tapes": Script(tapes),
    "parameters that do not fit": Script(inconsistent),
    "noise on the line": Script(noise_on_the_line),
    "parameters at edges": Script(parameters_at_edges),
    "bad tapes": Script(bad_tapes),
    "excitations": Script(excitations),
    "any commands 1": Script(any_commands, {"gust_rad_s2": 0.2}),
    "any commands 2": Script(any_commands, {"gust_rad_s2": 0.2}),
    "moved by hand": Script(moved_by_hand),
    "streams": Script(streams),
    "host stops": Script(host_stops),
    "flight": Script(flight),
    "flight in gusts": Script(flight, {"gust_rad_s2": 0.8}),
    "weak motors": Script(flight, {"gain": 0.35}),
    "strong motors": Script(flight, {"gain": 2.5, "friction_rad_s2": 0.02}),
    "other parameters 1": Script(other_parameters, {"gust_rad_s2": 0.3}),
    "other parameters 2": Script(other_parameters, {"gust_rad_s2": 0.3}),
    "elevation encoder dies": Script(partial(encoder_dies, axis=0)),
    "pitch encoder dies": Script(partial(encoder_dies, axis=1), {"gust_rad_s2": 0.2}),
    "travel encoder dies": Script(partial(encoder_dies, axis=2), {"gust_rad_s2": 0.2}),
    "law": Script(law),
    "law that throws": Script(partial(law, name="throws"), {"gust_rad_s2": 0.2}),
    "law that jumps": Script(partial(law, name="jumps")),
    "law without numbers": Script(partial(law, name="divides by zero")),
    "law with wishes": Script(partial(law, name="own setpoints")),
    "law at rest": Script(law_rests, {"pitch_gust_rad_s2": 0.9, "friction_rad_s2": 0.03}),
    "law that sinks": Script(law_sinks, {"gain": 0.8}),
    "elevation encoder dies often": Script(partial(encoders_die, axis=0), _ROUGH),
    "pitch encoder dies often": Script(partial(encoders_die, axis=1), _ROUGH),
    "travel encoder dies often": Script(partial(encoders_die, axis=2), _ROUGH),
    "probes 1": Script(probes, {"pitch_gust_rad_s2": 0.9}),
    "probes 2": Script(probes, {"pitch_gust_rad_s2": 0.9}),
    "laws that throw often 1": Script(thrown, {"gust_rad_s2": 0.1}),
    "laws that throw often 2": Script(thrown, {"gust_rad_s2": 0.1}),
}
"""The seed of a script is its place in this table."""
PARTS: Final = tuple(list(SCRIPTS)[:5])
"""Those that need no whole board."""
