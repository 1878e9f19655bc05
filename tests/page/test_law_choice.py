"""Which law flies a page's board: brought there on the table, flown from the take-off on, or not at all."""

from __future__ import annotations

from collections.abc import Iterator

import heli_host
import pytest
from heli_host.board.heli import Heli
from heli_host.board.law_flight import loaded
from heli_host.declaration import Flags
from heli_host.errors import BadLaw, ParameterError, SetpointError
from heli_host.ui.page.actions import LawChoice

from tests.page.laws import steady, tired

pytestmark = pytest.mark.medium

STEADY, TIRED = steady().program, tired().program


@pytest.fixture
def heli() -> Iterator[Heli]:
    with heli_host.connect("sil://?speed=max") as connected:
        yield connected


def flies(heli: Heli) -> bool:
    return bool(heli.latest.flags & Flags.LAW)


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


def test_a_landing_is_not_reported_as_a_takeover(heli: Heli) -> None:
    laws = LawChoice(heli, [STEADY])
    heli.session.subscribe_events(laws.take_event)
    laws.choose("steady")
    heli.take_off()
    laws.engage()
    heli.land()
    assert laws.status() == {"chosen": "steady", "flies": False, "taken_over": "", "values": {"kp": 16.0}}


def test_what_cannot_be_chosen_is_said(heli: Heli) -> None:
    assert LawChoice(heli, []).status() is None
    with pytest.raises(ParameterError, match="unknown control law nosuch; choose from: steady"):
        LawChoice(heli, [STEADY]).choose("nosuch")
    with pytest.raises(BadLaw, match="two control laws have the same name: steady, steady"):
        LawChoice(heli, [STEADY, STEADY])


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
