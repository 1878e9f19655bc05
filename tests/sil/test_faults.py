"""Faults of the link are repeatable, counted, and what their plan says."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import pytest
from heli_host.declaration import MessageId, StatusMessage
from heli_sim.errors import OptionError
from heli_sim.sil.faults import FaultPlan, FaultyStream
from heli_sim.sil.intervals import Span
from heli_sim.sil.options import parse_options, parse_url
from hypothesis import given
from hypothesis import strategies as st

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
