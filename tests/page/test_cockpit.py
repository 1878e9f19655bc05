"""The cockpit: whether its board is real, the causes it names, who is the pilot, and which law flies."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import heli_host
import pytest
from heli_host.board.heli import Heli
from heli_host.board.law_flight import loaded
from heli_host.data.log.reader import read_log
from heli_host.declaration import Event, EventMessage, Flags, State, Trigger
from heli_host.errors import BadLaw, ParameterError, SetpointError
from heli_host.fly.recorder import Recorder
from heli_host.link.events import event_text
from heli_host.ui.page.actions import LawChoice
from heli_host.ui.page.clients import ABSENT_S, PRESENT_S, ControlLease
from heli_host.ui.page.cockpit import Cockpit, is_simulated
from heli_host.ui.page.source import CAUSE_WORDS, cause, in_words

from tests.page.page_server import steady, tired

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
    return event_text(EventMessage(0, Event.STATE, State.EMERGENCY_LANDING, trigger, 0.0))


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
    lease.leave("a")
    assert lease.absence(0.0) == CLOSED


@pytest.mark.medium
def test_a_closed_page_is_the_cause_on_the_page_and_in_the_log(tmp_path: Path) -> None:
    absence = [""]
    with heli_host.connect("sil://?speed=max") as heli:
        cockpit = Cockpit(
            heli, lambda *_: Recorder(heli, tmp_path / "a.mcap"), [], "board", {}, rig_name="mine"
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
    lease.leave("a")
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
    lease.leave("b")
    assert lease.asking is None
    assert not lease.answer("a", grant=True)
    assert lease.pilot == "a"


def test_an_id_that_is_connected_is_not_given_twice() -> None:
    lease = lease_of_two_clients()
    assert not lease.join("a", "page 3", 0.0)
    assert lease.count() == 2


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
