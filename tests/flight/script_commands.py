"""Scripts in which the host commands what it may, and what it may not, and a person moves the arm."""

from __future__ import annotations

import struct
from typing import Any

from heli_host import declaration as d
from heli_host.link.frames import encode_frame

from tests.flight.scripts import Board, Laws, hover, land, take_off, values_at_edges


def excitations(board: Board, _laws: Laws) -> None:
    """Each signal in closed loop, with values that are allowed and values that are not."""
    take_off(board)
    for kind in (1, 2, 3, 4, 5):
        for _ in range(2):
            chance = board.chance
            start_Hz = 3.0 * chance.random()
            stop_Hz = chance.choice((start_Hz, start_Hz + 4.0, 500.0))
            board.ask(
                d.ExciteMessage, kind, chance.random(), -chance.random(), start_Hz, stop_Hz, 0.7, 9 + kind
            )
            hover(board, 0.9, (0.0, 0.0, 0.0))
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
        hover(board, 0.1, (0.0, 0.0, 0.0))
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
    for axis, counts in (
        (0, 22),
        (0, 23),
        (0, 24),
        (1, 113),
        (1, 114),
        (1, -115),
        (2, 1991),
        (2, 1992),
        (2, -2000),
    ):
        board.shift[axis] = counts
        board.run(1)
        board.ask(d.ArmMessage)
        board.run(1200)
        board.ask(d.ArmMessage)
        board.run(20)
        board.ask(d.StopMessage)
        board.shift[axis] = 0
        board.run(1000)
    for axis, jump in ((0, 560), (1, 515), (2, 2010), (0, 40), (1, 120), (2, 60)):
        board.ask(d.ArmMessage)
        board.ask(d.ControlMessage, 0, 0.5, 0.5)
        board.run(20)
        for _ in range(20):
            board.shift[axis] += jump // 20
            board.run(5 if jump > 200 else 1)
        board.run(30)
        board.ask(d.ArmMessage)
        board.ask(d.ClearFaultMessage)
        board.shift[axis] = 0
        board.run(1500)
    for axis in range(3):
        for bad in (5, 6):
            board.ask(d.ArmMessage)
            board.illegal[axis] += bad
            board.run(3)
            board.ask(d.StopMessage)
            board.ask(d.ClearFaultMessage)
    for late in (10, 1):
        board.ask(d.ArmMessage)
        board.late = True
        board.run(late)
        board.late = False
        board.ask(d.ControlMessage, 0, 0.2, 0.2)
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
    board.ask(d.ZeroMessage, 0)
    board.ask(d.ZeroMessage, 8)
    board.ask(d.ClearFaultMessage)
    board.shift = [30, -40, 70]
    for axes in (1, 2, 4, 7):
        board.ask(d.ZeroMessage, axes)
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
            board.send(kind(board.request, *fields))
            board.run(2)
        else:
            frame = bytearray(encode_frame(kind.ID, board.sequence & 0xFF, kind(1, *fields).pack()))
            frame[board.chance.randrange(len(frame))] ^= 1 << board.chance.randrange(8)
            board.raw(bytes(frame) + (b"\0" if accident < 0.95 else b""))
        for _ in range(board.chance.choice((0, 0, 1, 5, 20))):
            board.point(
                8.0 * board.chance.random(),
                0.0,
                20.0 * board.chance.random(),
                board.chance.randrange(-40, 40),
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
