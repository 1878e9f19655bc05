"""The page gives causes in words, and names the pilot's page where it is the cause."""

from __future__ import annotations

from pathlib import Path

import heli_host
import pytest
from heli_host.data.log.reader import read_log
from heli_host.declaration import Event, EventMessage, State, Trigger
from heli_host.fly.recorder import Recorder
from heli_host.link.events import event_text
from heli_host.ui.page.clients import PRESENT_S, ControlLease
from heli_host.ui.page.cockpit import Cockpit
from heli_host.ui.page.source import CAUSE_WORDS, cause, in_words

CLOSED = "the pilot's page was closed"


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
