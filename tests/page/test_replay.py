"""A log played again shows what it holds, from any moment, at any speed."""

from __future__ import annotations

import re
from dataclasses import replace

import heli_host
import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_log
from heli_host.errors import ParameterError
from heli_host.fly.plan import Plan
from heli_host.ui.page.replay import Replay

from tests.page.page_server import SHORT_PLAN

pytestmark = pytest.mark.medium


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("replay") / "flight.mcap"
    with heli_host.connect("sil://?speed=max") as heli:
        heli.fly(Plan.parse(SHORT_PLAN, "short"), log=path)
    return read_log(path)


def test_a_replay_names_its_log_and_when_it_began_in_words(log: Log) -> None:
    board = Replay(log, {}).describe()["board"]
    assert re.fullmatch(r"flight\.mcap: native, \d{4}-\d\d-\d\d \d\d:\d\d UTC", board), board
    assert Replay(without_start(log), {}).describe()["board"] == "flight.mcap: native"


def without_start(log: Log) -> Log:
    session = {**log.metadata["session"], "start": "yesterday"}
    return replace(log, metadata={**log.metadata, "session": session})


def advance(replay: Replay, ticks: int) -> None:
    replay._advance(ticks)


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


def test_it_goes_on_from_where_it_was_put_and_shows_what_was_before(log: Log) -> None:
    replay = Replay(log, {})
    advance(replay, 10)
    replay.actions["seek"].run({"t_s": float(log.ticks["t_s"][4000])})
    cut = replay.buffer.rows_since(10, 10_000)
    assert cut.reset
    np.testing.assert_array_equal(cut.raw, log.raw[:4000])
    advance(replay, 100)
    np.testing.assert_array_equal(replay.buffer.rows_since(cut.end, 10_000).raw, log.raw[4000:4100])


def test_it_ends_at_the_end_and_begins_again_when_it_is_played(log: Log) -> None:
    replay = Replay(log, {})
    advance(replay, 10**7)
    assert not replay.status()["playing"]
    replay.actions["play"].run({"on": True, "speed": 1000.0})
    assert replay.status()["speed"] == 50.0
    advance(replay, 5)
    assert replay.status()["at_s"] < float(log.ticks["t_s"][20])


def test_a_stop_pauses_it_and_nonsense_is_refused(log: Log) -> None:
    replay = Replay(log, {})
    replay.stop()
    assert not replay.status()["playing"]
    with pytest.raises(ParameterError):
        replay.actions["seek"].run({"t_s": "later"})
    assert replay.describe()["span_s"][1] > 5.0
