"""Faults of link and rig are repeatable, counted, and as planned; flights in which something fails."""

import os
import pty
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np
import pytest
from heli_host.declaration import ArmMessage, MessageId, Result, StatusMessage
from heli_sim import _native
from heli_sim.errors import OptionError
from heli_sim.sil.fault_console import HELP, FaultConsole
from heli_sim.sil.faults import FaultPlan, FaultyStream, Span
from heli_sim.sil.options import parse_options, parse_url
from heli_sim.sil.ports import TcpEndpoint
from heli_sim.sil.server import TimedClock, serve
from hypothesis import given
from hypothesis import strategies as st

from tests.running.long import samples
from tests.sil.faulty_flights import BLOWS, case, flown, mistakes_of, reason
from tests.sil.harness import Host, hello_frame, world

pytestmark = pytest.mark.medium

PLAN = FaultPlan(flip=1e-3, drop=1e-2, double=1e-2)
CLEAN = bytes(range(256)) * 40


@given(cuts=st.lists(st.integers(0, len(CLEAN)), max_size=30), seed=st.integers(0, 5))
def test_the_same_seed_spoils_the_same_bytes_however_they_are_cut(cuts: list[int], seed: int) -> None:
    passed_at_once = FaultyStream(PLAN, seed, 0).pass_through(CLEAN)
    stream = FaultyStream(PLAN, seed, 0)
    edges = [0, *sorted(cuts), len(CLEAN)]
    assert b"".join(stream.pass_through(CLEAN[a:b]) for a, b in pairwise(edges)) == passed_at_once


def test_seeds_and_directions_differ() -> None:
    spoiled = {FaultyStream(PLAN, seed, way).pass_through(CLEAN) for seed in (1, 2) for way in (0, 1)}
    assert len(spoiled) == 4


def test_rates_are_those_asked_for() -> None:
    stream = FaultyStream(FaultPlan(flip=1e-4, drop=1e-3, double=2e-3), 1, 0)
    for _ in range(100):
        stream.pass_through(CLEAN)
    seen, counters = stream.counters.bytes_seen, stream.counters
    assert seen == 100 * len(CLEAN)
    assert counters.flipped == pytest.approx(8e-4 * seen, rel=0.15)
    assert counters.dropped == pytest.approx(1e-3 * seen, rel=0.15)
    assert counters.doubled == pytest.approx(2e-3 * seen, rel=0.15)


@pytest.mark.parametrize(
    ("plan", "spoil"),
    [
        (FaultPlan(flip=1.0), lambda data: bytes(byte ^ 0xFF for byte in data)),
        (FaultPlan(drop=1.0), lambda _: b""),
        (FaultPlan(double=1.0), lambda data: bytes(byte for byte in data for _ in range(2))),
    ],
    ids=["flip", "drop", "double"],
)
def test_a_certain_fault_hits_every_byte(plan: FaultPlan, spoil: Callable[[bytes], bytes]) -> None:
    assert FaultyStream(plan, 1, 0).pass_through(CLEAN) == spoil(CLEAN)


def test_what_is_lost_and_what_is_doubled_adds_up() -> None:
    stream = FaultyStream(FaultPlan(drop=0.05, double=0.03), 3, 1)
    out = stream.pass_through(CLEAN)
    counters = stream.counters
    # A byte that is doubled and dropped is gone altogether.
    assert len(CLEAN) - counters.dropped <= len(out) <= len(CLEAN) - counters.dropped + counters.doubled


def test_flipped_bits_are_noticed_by_both_ends() -> None:
    host = Host(world(flip="3e-4"))
    for seq in range(200):
        host.wait(20, hello_frame(seq))
    assert host.frames_bad > 0
    status = [StatusMessage.unpack(f.payload) for f in host.frames if f.id == MessageId.STATUS]
    assert status[-1].frames_bad > 0
    assert host.world.counters()["flipped_bits"] > 0


def test_a_stall_holds_the_hosts_bytes_and_overflows_towards_it() -> None:
    host = Host(world(stall="1:0.5"))
    host.hello()
    host.wait(1000 - host.world.tick)
    before = host.world.native.line_counters()
    assert host.wait(400, bytes(100)) == []
    during = host.world.native.line_counters()
    assert during["to_board_bytes"] == before["to_board_bytes"]
    assert during["to_host_overflow"] > 0
    host.wait(200)
    assert host.world.native.line_counters()["to_board_bytes"] == before["to_board_bytes"] + 100


@pytest.mark.parametrize("slice_ticks", [1, 7, 333])
def test_a_stall_begins_and_ends_on_its_tick_however_time_is_cut(slice_ticks: int) -> None:
    def received(slice_ticks: int) -> bytes:
        host = Host(world(stall="1:0.5"))
        host.hello()
        data = b""
        while host.world.tick < 2000:
            data += host.world.advance(min(slice_ticks, 2000 - host.world.tick))
        assert host.world.native.line_counters()["to_host_overflow"] > 0
        return data

    assert received(slice_ticks) == received(2000)


def test_pulling_the_cable_loses_what_is_under_way_and_the_board_flies_on() -> None:
    host = Host(world(unplug="1:0.5"))
    host.drive(1.9, 1.9)
    host.wait(1000 - host.world.tick)
    assert host.world.unplugged
    boots = host.world.board.sim.boots
    assert host.wait(300, bytes(300)) == []
    assert host.world.native.to_board_waiting == 0
    host.wait(250)
    assert not host.world.unplugged
    assert host.world.board.sim.boots == boots


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ("colour=red", "colour"),
        ("flip=2", "probability"),
        ("drop=-0.1", "probability"),
        ("double=nan", "probability"),
        ("flip=often", "number"),
        ("stall=5", "stall"),
        ("stall=5:0", "interval of time"),
        ("stall=-1:2", "interval of time"),
        ("unplug=1:inf", "interval of time"),
        ("speed=0", "speed"),
        ("speed=-1", "speed"),
        ("speed=nan", "speed"),
        ("speed=fast", "number"),
        ("seed=-1", "seed"),
        ("seed=1.5", "whole"),
        ("slice_ms=0", "slice_ms"),
        ("reset_on_open=yes", "0 or 1"),
        ("rig", "key=value"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(query: str, says: str) -> None:
    with pytest.raises(OptionError, match=says) as error:
        parse_url(f"sil://?{query}")
    assert "\n" not in str(error.value)


def test_an_address_may_name_everything_or_nothing() -> None:
    assert parse_url("sil://").rig == "makki2024"
    assert parse_url("sil://?").speed is None
    options = parse_url(
        "sil://?rig=r.toml&seed=7&speed=2.5&flip=1e-4&stall=1:0.5,3:1&unplug=9:1&reset_on_open=1"
    )
    assert (options.rig, options.seed, options.speed, options.reset_on_open) == ("r.toml", 7, 2.5, True)
    assert options.faults.stalls == (Span(1.0, 0.5), Span(3.0, 1.0))
    assert options.faults.unplugs == (Span(9.0, 1.0),)
    with pytest.raises(OptionError, match="names a host or path"):
        parse_url("sil://makki2024")
    assert parse_options({}) == parse_url("sil://")


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


FLIGHTS = 150
CUT_FRAME = 439
"""Flight in which the cable cuts a frame in its middle."""


@pytest.mark.slow
def test_every_faulty_flight_is_reported_as_it_was() -> None:
    reasons: Counter[str] = Counter()
    complaints = []
    for number in (*range(samples(FLIGHTS, len(BLOWS))), CUT_FRAME):
        flight = flown(case(number))
        reasons[reason(flight)] += 1
        complaints += [f"{flight.case}: {complaint}" for complaint in mistakes_of(flight)]
    assert not complaints, "\n".join(complaints)
    # The set is worth something only while it has flights of all these ends in it.
    assert {"completed", "because of stale_land", "fault hardware_stop", "fault pitch_limit"} <= set(reasons)
    assert len(reasons) >= 8
