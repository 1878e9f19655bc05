"""The cockpit: its board, causes, pilot and law; and telemetry, of which every reader gets every row."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.board.law_flight import loaded
from heli_host.data.log.reader import Log, read_log
from heli_host.declaration import Event, EventMessage, Flags, State, Trigger
from heli_host.errors import BadLaw, LinkError, ParameterError, SetpointError
from heli_host.fly.plan import Plan
from heli_host.fly.recorder import Recorder
from heli_host.link.events import event_text
from heli_host.link.telemetry import CHANNEL_COUNT
from heli_host.ui.page.actions import LawChoice
from heli_host.ui.page.clients import ABSENT_S, PRESENT_S, ControlLease
from heli_host.ui.page.cockpit import Cockpit, is_simulated
from heli_host.ui.page.replay import Replay
from heli_host.ui.page.source import CAUSE_WORDS, cause, in_words
from heli_host.ui.page.telemetry import RESET, THINNED, BufferRows, TelemetryBuffer, pack, unpack
from hypothesis import given
from hypothesis import strategies as st

from tests.page.page_server import SHORT_PLAN, steady, tired

CLOSED = "the pilot's page was closed"
STEADY, TIRED = steady().program, tired().program


@pytest.mark.parametrize(
    ("transport", "board", "simulated"),
    [
        ({"url": "/dev/ttyACM0"}, "due", False),
        ({"url": "/dev/pts/3"}, "native", True),
        ({"url": "/dev/pts/3", "rig": "makki2024"}, "due", True),
        ({"url": "/dev/pts/3", "label": "emulated Due, heli.elf"}, "due", True),
    ],
)
def test_a_board_is_simulated_only_if_something_says_so(
    transport: dict[str, Any], board: str, simulated: bool
) -> None:
    session = SimpleNamespace(transport=SimpleNamespace(**transport))
    heli = SimpleNamespace(session=session, info=SimpleNamespace(board=board))
    assert is_simulated(cast(Heli, heli)) is simulated


def state_text(trigger: Trigger) -> str:
    return event_text(
        EventMessage(tick=0, kind=Event.STATE, detail=State.EMERGENCY_LANDING, cause=trigger, value=0.0)
    )


@pytest.mark.parametrize("trigger", Trigger, ids=lambda trigger: trigger.name.lower())
def test_each_cause_of_the_board_has_words_of_its_own(trigger: Trigger) -> None:
    text = in_words(state_text(trigger))
    assert text == f"state emergency landing: {CAUSE_WORDS[trigger]}"
    assert "_" not in text
    assert len(set(CAUSE_WORDS.values())) == len(Trigger)


def test_only_missing_setpoints_are_put_down_to_the_pilot_s_page() -> None:
    named = {trigger for trigger in Trigger if cause(state_text(trigger), CLOSED) == CLOSED}
    assert named == {Trigger.STALE_HOLD, Trigger.STALE_LAND}


def test_a_text_without_a_cause_and_an_unknown_cause_stay_readable() -> None:
    assert in_words("setpoints came back") == "setpoints came back"
    assert cause("setpoints came back") == ""
    assert in_words("state hold, because of new_cause") == "state hold: new cause"


def test_a_closed_page_and_a_silent_page_are_different_causes() -> None:
    lease = ControlLease()
    assert lease.absence(0.0) == "no page has the control"
    lease.join("a", "page 1", 0.0)
    assert lease.absence(PRESENT_S) == ""
    assert lease.absence(PRESENT_S + 0.1) == "the pilot's page does not answer"
    lease.leave("a", 1.0)
    assert lease.absence(0.0) == CLOSED


@pytest.mark.medium
def test_a_closed_page_is_the_cause_on_the_page_and_in_the_log(tmp_path: Path) -> None:
    absence = [""]
    with heli_host.connect("sil://?speed=max") as heli:
        cockpit = Cockpit(
            heli,
            lambda *_: Recorder(heli, tmp_path / "a.mcap"),
            plans=[],
            board="board",
            rig={},
            rig_name="mine",
        )
        cockpit.watch_pilot(lambda: not absence[0], lambda: absence[0])
        cockpit.actions["record"].run({"on": True})
        heli.take_off()
        absence[0] = CLOSED
        heli.wait(1.0)
        assert heli.state is State.HOLD
        assert cockpit.status()["cause"] == CLOSED
        heli.wait(4.0)
        described = cockpit.describe()
        cockpit.close()
    texts = [event["text"] for event in described["events"]]
    assert f"state hold: {CLOSED}" in texts and f"state landing: {CLOSED}" in texts
    assert (described["kind"], described["rig_name"]) == ("simulation", "mine")
    notes = [event["message"] for event in read_log(tmp_path / "a.mcap").events if event["name"] == "pilot"]
    assert notes == [CLOSED]


def lease_of_two_clients() -> ControlLease:
    lease = ControlLease()
    assert lease.join("a", "page 1", 0.0)
    assert lease.join("b", "page 2", 0.0)
    return lease


def test_the_first_flies_and_a_program_never_by_itself() -> None:
    lease = ControlLease()
    lease.join("p", "program 1", 0.0, may_fly=False)
    assert lease.pilot is None
    lease.join("a", "page 2", 0.0)
    assert lease.pilot == "a"


def test_who_does_not_fly_neither_hands_over_nor_keeps() -> None:
    lease = lease_of_two_clients()
    assert not lease.ask("b", 0.0)
    assert not lease.answer("b", grant=True)
    assert lease.pilot == "a"
    assert lease.answer("a", grant=True)
    assert lease.pilot == "b"
    assert lease.asking is None


def test_a_pilot_is_present_as_long_as_the_last_sign_of_life_is_fresh() -> None:
    lease = lease_of_two_clients()
    lease.beat("a", 10.0)
    lease.beat("b", 20.0)
    assert lease.present(10.0 + PRESENT_S)
    assert not lease.present(10.0 + PRESENT_S + 0.01)


def test_a_pilot_who_left_is_absent_at_once_and_has_control_when_back() -> None:
    lease = lease_of_two_clients()
    lease.beat("a", 1.0)
    lease.leave("a", 1.0)
    assert not lease.present(1.0)
    assert lease.pilot == "a"
    assert lease.join("a", "page 3", 1.1)
    assert lease.present(1.1)


def test_control_of_an_absent_pilot_can_be_taken_and_the_pilot_watches() -> None:
    lease = lease_of_two_clients()
    lease.beat("a", 1.0)
    assert not lease.ask("b", 1.0 + ABSENT_S)
    assert lease.ask("b", 1.0 + ABSENT_S + 0.01)
    assert lease.pilot == "b"
    lease.beat("a", 5.0)
    assert lease.pilot == "b"


def test_who_asked_and_left_asks_no_more() -> None:
    lease = lease_of_two_clients()
    lease.ask("b", 0.1)
    lease.leave("b", 0.1)
    assert lease.asking is None
    assert not lease.answer("a", grant=True)
    assert lease.pilot == "a"


def test_an_id_that_is_connected_is_not_given_twice() -> None:
    lease = lease_of_two_clients()
    assert not lease.join("a", "page 3", 0.0)
    assert lease.count() == 2


@pytest.mark.parametrize(("closed_s", "pilot"), [(0.1, "reloaded"), (5.0, "a")])
def test_a_page_that_connects_before_its_predecessor_closes_keeps_control_and_a_duplicated_tab_gets_none(
    closed_s: float, pilot: str
) -> None:
    lease = lease_of_two_clients()
    assert lease.join("reloaded", "page 3", 0.0, reload_of="a")
    lease.leave("a", closed_s)
    assert lease.pilot == pilot


@pytest.fixture
def heli() -> Iterator[Heli]:
    with heli_host.connect("sil://?speed=max") as connected:
        yield connected


def flies(heli: Heli) -> bool:
    return bool(heli.latest.flags & Flags.LAW)


@pytest.mark.medium
def test_a_law_is_brought_on_the_table_and_flies_after_the_take_off(heli: Heli) -> None:
    laws = LawChoice(heli, [STEADY, TIRED])
    assert laws.status() == {"chosen": "", "flies": False, "taken_over": "", "values": {}}
    laws.choose("steady")
    assert loaded(heli.session).hash == STEADY.hash
    heli.take_off()
    assert not flies(heli)
    laws.engage()
    assert laws.status() == {"chosen": "steady", "flies": True, "taken_over": "", "values": {"kp": 16.0}}
    with pytest.raises(
        SetpointError, match="the board has no control law tired, and accepts one only on the table"
    ):
        laws.choose("tired")
    assert flies(heli)
    laws.choose("")
    heli.wait(0.1)
    assert not flies(heli)
    laws.choose("steady")
    assert flies(heli)


@pytest.mark.medium
def test_the_reason_of_a_takeover_is_shown_until_another_choice(heli: Heli) -> None:
    laws = LawChoice(heli, [STEADY, TIRED])
    heli.session.subscribe_events(laws.take_event)
    laws.choose("tired")
    heli.take_off()
    laws.engage()
    heli.wait_until(lambda sample: not sample.flags & Flags.LAW, 5.0)
    heli.wait(0.1)
    status = laws.status()
    assert status is not None
    assert status["taken_over"].startswith("voltage jump (")
    assert status["chosen"] == "tired"
    heli.land()
    laws.choose("steady")
    assert laws.status() == {"chosen": "steady", "flies": False, "taken_over": "", "values": {"kp": 16.0}}


@pytest.mark.medium
def test_a_landing_is_not_reported_as_a_takeover(heli: Heli) -> None:
    laws = LawChoice(heli, [STEADY])
    heli.session.subscribe_events(laws.take_event)
    laws.choose("steady")
    heli.take_off()
    laws.engage()
    heli.land()
    assert laws.status() == {"chosen": "steady", "flies": False, "taken_over": "", "values": {"kp": 16.0}}


@pytest.mark.medium
def test_what_cannot_be_chosen_is_said(heli: Heli) -> None:
    assert LawChoice(heli, []).status() is None
    with pytest.raises(ParameterError, match="unknown control law nosuch; choose from: steady"):
        LawChoice(heli, [STEADY]).choose("nosuch")
    with pytest.raises(BadLaw, match="two control laws have the same name: steady, steady"):
        LawChoice(heli, [STEADY, STEADY])


@pytest.mark.medium
def test_a_parameter_changed_in_flight_is_kept_when_the_law_is_sent_again(heli: Heli) -> None:
    laws = LawChoice(heli, [STEADY, TIRED])
    with pytest.raises(ParameterError, match="no control law is chosen"):
        laws.set("kp", 20.0)
    laws.choose("steady")
    with pytest.raises(BadLaw, match="control law steady has no parameter nosuch; choose from: kp"):
        laws.set("nosuch", 1.0)
    heli.take_off()
    laws.engage()
    assert laws.set("kp", 20.0) == (16.0, 20.0)
    heli.land()
    laws.choose("tired")
    laws.choose("steady")
    heli.take_off()
    laws.engage()
    assert laws.status() == {"chosen": "steady", "flies": True, "taken_over": "", "values": {"kp": 20.0}}
    heli.wait(0.1)
    assert heli.latest.signal_2 == pytest.approx(20.0)


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
            cut = buffer.rows_since(position=position, max_rows=1000)
            position = cut.end
            got += cut.tick.tolist()
            assert not cut.reset
            assert not cut.thinned
            check_rows(cut)
    got += buffer.rows_since(position=position, max_rows=1000).tick.tolist()
    assert got == list(range(written))


@given(st.integers(1, 500), st.integers(1, 60))
def test_a_reader_that_fell_behind_gets_some_rows_and_the_newest(written: int, most: int) -> None:
    buffer = TelemetryBuffer(100)
    for first in range(0, written, 7):
        buffer.append(*rows(first, min(7, written - first)))
    cut = buffer.rows_since(position=0, max_rows=most)
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
    cut = buffer.rows_since(position=0, max_rows=100)
    assert cut.tick.tolist() == list(range(15, 25))
    assert buffer.end == 25
    check_rows(cut)


def test_cleared_rows_are_not_read_and_the_reader_is_informed() -> None:
    buffer = TelemetryBuffer(100)
    buffer.append(*rows(0, 20))
    buffer.clear()
    buffer.append(*rows(5, 3))
    cut = buffer.rows_since(position=10, max_rows=100)
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
        cut = replay.buffer.rows_since(position=position, max_rows=10_000)
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
    cut = replay.buffer.rows_since(position=10, max_rows=10_000)
    assert cut.reset
    np.testing.assert_array_equal(cut.raw, log.raw[:4000])
    advance(replay, 100)
    np.testing.assert_array_equal(
        replay.buffer.rows_since(position=cut.end, max_rows=10_000).raw, log.raw[4000:4100]
    )


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
