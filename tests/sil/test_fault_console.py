"""A fault that a user types at a served board acts on its rig, until the user ends it."""

from __future__ import annotations

import os
import pty
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from heli_host.declaration import ArmMessage, Result
from heli_sim import _native
from heli_sim.sil.clock import TimedClock
from heli_sim.sil.fault_console import HELP, FaultConsole
from heli_sim.sil.server import serve
from heli_sim.sil.tcp import TcpEndpoint

from tests.sil.harness import Host, world

pytestmark = pytest.mark.medium

# Only how long a failing test takes.
PATIENCE_s = 120.0


class Person:
    """Types at a world through a pipe, and reads the answers."""

    def __init__(self, host: Host) -> None:
        self.answers: list[str] = []
        self._fd, self._pen = os.pipe()
        self.console = FaultConsole(host.world, self._fd, self.answers.append)

    def type_in(self, text: str) -> str:
        os.write(self._pen, text.encode())
        assert self.console.watched() == [self._fd]
        self.console.listen([self._fd])
        return self.answers[-1] if self.answers else ""

    def leave(self) -> None:
        os.close(self._pen)
        self.console.listen([self._fd])

    def close(self) -> None:
        os.close(self._fd)


@pytest.fixture
def host() -> Host:
    return Host(world())


@pytest.fixture
def person(host: Host) -> Iterator[Person]:
    person = Person(host)
    yield person
    person.close()


def test_the_stop_switch_is_pressed_and_released(host: Host, person: Person) -> None:
    host.drive(1.9, 1.9)
    reply = person.type_in("stop\n")
    assert reply == f"{host.world.time_s:.1f} s: the stop switch is pressed"
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]


def test_a_released_switch_lets_the_motors_run_again(host: Host, person: Person) -> None:
    host.hello()
    person.type_in("stop\n")
    host.wait(10)
    assert host.order(ArmMessage).result == Result.CHECK_FAILED
    assert "released" in person.type_in("release\n")
    host.wait(10)
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V[0] > 1.8


def test_an_encoder_out_does_not_count_and_goes_on_from_where_it_stopped(host: Host, person: Person) -> None:
    board = host.world.board.sim
    assert isinstance(board, _native.NativeBoard)
    host.world.native.locked = [True] * 3

    def pitched(angle_rad: float) -> list[bool]:
        before = board.counts
        host.world.state = np.array([0.1, angle_rad, angle_rad, 0.0, 0.0, 0.0])
        host.wait(1)
        return [count != was for count, was in zip(board.counts, before, strict=True)]

    pitched(0.0)
    person.type_in("pull travel\n")
    assert "pitch encoder is unplugged" in person.type_in("pull pitch\n")
    host.wait(1)
    assert pitched(0.1) == [False, False, False]
    assert "plugged in" in person.type_in("plug pitch\n")
    host.wait(1)
    assert pitched(0.1) == [False, False, False]
    assert pitched(0.2) == [False, True, False]


def test_motors_without_supply_get_no_voltage(host: Host, person: Person) -> None:
    host.drive(1.9, 1.9)
    person.type_in("supply off\n")
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]
    person.type_in("supply on\n")
    host.wait(1)
    assert host.world.native.volts_V[0] > 1.8


def test_a_line_may_come_in_pieces_and_several_at_once(person: Person) -> None:
    assert person.type_in("sto") == ""
    person.type_in("p\n\nrelease\nsup")
    assert [answer.split(": ")[1] for answer in person.answers] == [
        "the stop switch is pressed",
        "the stop switch is released",
    ]


def test_what_is_not_understood_says_what_is(host: Host, person: Person) -> None:
    for line in (
        "halt",
        "pull",
        "pull yaw",
        "supply",
        "supply up",
        "stop now",
        "\x1b[A\xff",
        "stop\0",
        "x" * 4000,
    ):
        assert person.type_in(line + "\n").endswith(f"this cannot be rehearsed; say {HELP}")
    assert host.world.rig_faults == host.world.options.rig_faults


def test_what_was_asked_for_at_the_start_can_be_ended_and_comes_all_the_same() -> None:
    host = Host(world(stop_switch="0.1,0.9:0.1", supply_out="0"))
    person = Person(host)
    host.wait(200)
    person.type_in("release\n")
    person.type_in("supply on\n")
    host.wait(10)
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V[0] > 1.8
    host.wait(950 - host.world.tick)
    assert host.world.native.volts_V == [0.0, 0.0]
    person.close()


def test_when_the_lines_end_the_board_is_served_on(person: Person) -> None:
    person.leave()
    assert person.console.watched() == []


def test_in_the_background_the_terminal_is_left_to_the_shell(
    host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    master, terminal = pty.openpty()
    console = FaultConsole(host.world, terminal, print)
    monkeypatch.setattr("heli_sim.sil.fault_console.os.tcgetpgrp", lambda fd: os.getpgrp())
    assert console.watched() == [terminal]
    # A process that reads then is stopped by the system, and the board with it.
    monkeypatch.setattr("heli_sim.sil.fault_console.os.tcgetpgrp", lambda fd: os.getpgrp() + 1)
    assert console.watched() == []
    os.close(terminal)
    os.close(master)


def test_a_served_board_listens_while_it_flies(host: Host, person: Person) -> None:
    stop_fd, stop_pen = os.pipe()
    received: list[str] = []

    def say(text: str) -> None:
        received.append(text)
        os.write(stop_pen, b"x")

    reader, pen = os.pipe()
    os.write(pen, b"pull travel\n")
    endpoint = TcpEndpoint("127.0.0.1", 0)
    patience = threading.Timer(PATIENCE_s, os.write, (stop_pen, b"x"))
    patience.start()
    serve(endpoint, host.world, TimedClock(1.0), stop_fd, FaultConsole(host.world, reader, say))
    patience.cancel()
    endpoint.close()
    assert received and "travel encoder is unplugged" in received[0]
    for fd in (stop_fd, stop_pen, reader, pen):
        os.close(fd)


def test_a_hand_turns_an_axis_and_lets_it_go(host: Host, person: Person) -> None:
    reply = person.type_in("turn elevation -5\nturn pitch 20\n")
    assert reply.endswith("a hand turns pitch to 20 degrees, and holds it")
    host.wait(1500)
    assert np.degrees(host.world.state[:2]) == pytest.approx([-5.0, 20.0])
    person.type_in("let pitch\n")
    host.wait(300)
    elevation_deg, pitch_deg = np.degrees(host.world.state[:2])
    assert elevation_deg == pytest.approx(-5.0)
    assert pitch_deg < 19.0


@pytest.mark.parametrize(
    "line", ["turn roll 5", "turn pitch up", "turn pitch nan", "turn pitch 900", "turn pitch"]
)
def test_a_hand_turns_no_other_axis_and_to_no_other_angle(host: Host, person: Person, line: str) -> None:
    assert HELP in person.type_in(f"{line}\n")
    assert np.all(np.isnan(host.world.native.hand_rad))
