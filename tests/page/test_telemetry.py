"""Telemetry: every reader gets every row while it keeps up; a replayed log shows what it holds."""

from __future__ import annotations

import re
from dataclasses import replace

import heli_host
import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_log
from heli_host.errors import LinkError, ParameterError
from heli_host.fly.plan import Plan
from heli_host.link.telemetry import CHANNEL_COUNT
from heli_host.ui.page.replay import Replay
from heli_host.ui.page.telemetry import RESET, THINNED, BufferRows, TelemetryBuffer, pack, unpack
from hypothesis import given
from hypothesis import strategies as st

from tests.page.page_server import SHORT_PLAN


def rows(first: int, count: int) -> tuple[np.ndarray, np.ndarray]:
    tick = np.arange(first, first + count, dtype=np.int64)
    raw = (tick[:, None] * (1 + np.arange(CHANNEL_COUNT))).astype(np.int32)
    return tick, raw


def check_rows(cut: BufferRows) -> None:
    np.testing.assert_array_equal(
        cut.raw, (cut.tick[:, None] * (1 + np.arange(CHANNEL_COUNT))).astype(np.int32)
    )


@given(st.lists(st.integers(0, 40), max_size=20), st.lists(st.booleans(), min_size=20, max_size=20))
def test_a_reader_that_keeps_up_gets_each_row_once(counts: list[int], reads: list[bool]) -> None:
    buffer, position, written, got = TelemetryBuffer(1000), 0, 0, []
    for count, read in zip(counts, reads, strict=False):
        buffer.append(*rows(written, count))
        written += count
        if read:
            cut = buffer.rows_since(position, 1000)
            position = cut.end
            got += cut.tick.tolist()
            assert not cut.reset
            assert not cut.thinned
            check_rows(cut)
    got += buffer.rows_since(position, 1000).tick.tolist()
    assert got == list(range(written))


@given(st.integers(1, 500), st.integers(1, 60))
def test_a_reader_that_fell_behind_gets_some_rows_and_the_newest(written: int, most: int) -> None:
    buffer = TelemetryBuffer(100)
    for first in range(0, written, 7):
        buffer.append(*rows(first, min(7, written - first)))
    cut = buffer.rows_since(0, most)
    assert 0 < len(cut.tick) <= most
    assert cut.tick[-1] == written - 1
    assert cut.reset == (written > 100)
    assert cut.thinned == (
        len(set(np.diff(cut.tick).tolist()) - {1}) > 0 or (len(cut.tick) == 1 < min(written, 100))
    )
    check_rows(cut)


def test_more_than_fits_keeps_the_newest() -> None:
    buffer = TelemetryBuffer(10)
    buffer.append(*rows(0, 25))
    cut = buffer.rows_since(0, 100)
    assert cut.tick.tolist() == list(range(15, 25))
    assert buffer.end == 25
    check_rows(cut)


def test_cleared_rows_are_not_read_and_the_reader_is_informed() -> None:
    buffer = TelemetryBuffer(100)
    buffer.append(*rows(0, 20))
    buffer.clear()
    buffer.append(*rows(5, 3))
    cut = buffer.rows_since(10, 100)
    assert cut.tick.tolist() == [5, 6, 7]
    assert cut.reset


@given(st.integers(0, 2**40), st.integers(0, 50), st.booleans(), st.booleans())
def test_a_frame_holds_what_was_packed(first: int, count: int, reset: bool, thinned: bool) -> None:
    tick = np.arange(first, first + count, dtype=np.int64)
    raw = np.random.default_rng(1).integers(-(2**31), 2**31, (count, CHANNEL_COUNT)).astype(np.int32)
    got = unpack(pack(BufferRows(tick, raw, count, reset, thinned), 7, (4, 12)))
    assert got.tick.tolist() == tick.tolist()
    np.testing.assert_array_equal(got.raw, raw)
    assert (got.number, got.state, got.fault) == (7, 4, 12)
    assert got.flags == RESET * reset + THINNED * thinned


@pytest.mark.parametrize(
    "damage", [lambda b: b[:-1], lambda b: b[:10], lambda b: b"\2" + b[1:], lambda b: b + b"\0"]
)
def test_bytes_that_are_no_frame_are_recognised(damage: object) -> None:
    assert callable(damage)
    with pytest.raises(LinkError):
        unpack(damage(pack(BufferRows(*rows(3, 4), 4, False, False), 1, (4, 12))))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("replay") / "flight.mcap"
    with heli_host.connect("sil://?speed=max") as heli:
        heli.fly(Plan.parse(SHORT_PLAN, "short"), log=path)
    return read_log(path)


@pytest.mark.medium
def test_a_replay_names_its_log_and_when_it_began_in_words(log: Log) -> None:
    board = Replay(log, {}).describe()["board"]
    assert re.fullmatch(r"flight\.mcap: native, \d{4}-\d\d-\d\d \d\d:\d\d UTC", board), board
    assert Replay(without_start(log), {}).describe()["board"] == "flight.mcap: native"


def without_start(log: Log) -> Log:
    session = {**log.metadata["session"], "start": "yesterday"}
    return replace(log, metadata={**log.metadata, "session": session})


def advance(replay: Replay, ticks: int) -> None:
    replay._advance(ticks)


@pytest.mark.medium
def test_what_is_played_is_what_the_log_holds(log: Log) -> None:
    replay = Replay(log, {})
    position, tick, raw = 0, [], []
    while replay.status()["playing"]:
        advance(replay, 333)
        cut = replay.buffer.rows_since(position, 10_000)
        position = cut.end
        tick.append(cut.tick)
        raw.append(cut.raw)
    np.testing.assert_array_equal(np.concatenate(raw), log.raw)
    assert np.concatenate(tick).tolist() == np.rint(log.ticks["t_s"] * 1e3).tolist()


@pytest.mark.medium
def test_it_goes_on_from_where_it_was_put_and_shows_what_was_before(log: Log) -> None:
    replay = Replay(log, {})
    advance(replay, 10)
    replay.actions["seek"].run({"t_s": float(log.ticks["t_s"][4000])})
    cut = replay.buffer.rows_since(10, 10_000)
    assert cut.reset
    np.testing.assert_array_equal(cut.raw, log.raw[:4000])
    advance(replay, 100)
    np.testing.assert_array_equal(replay.buffer.rows_since(cut.end, 10_000).raw, log.raw[4000:4100])


@pytest.mark.medium
def test_it_ends_at_the_end_and_begins_again_when_it_is_played(log: Log) -> None:
    replay = Replay(log, {})
    advance(replay, 10**7)
    assert not replay.status()["playing"]
    replay.actions["play"].run({"on": True, "speed": 1000.0})
    assert replay.status()["speed"] == 50.0
    advance(replay, 5)
    assert replay.status()["at_s"] < float(log.ticks["t_s"][20])


@pytest.mark.medium
def test_a_stop_pauses_it_and_nonsense_is_refused(log: Log) -> None:
    replay = Replay(log, {})
    replay.stop()
    assert not replay.status()["playing"]
    with pytest.raises(ParameterError):
        replay.actions["seek"].run({"t_s": "later"})
    assert replay.describe()["span_s"][1] > 5.0
