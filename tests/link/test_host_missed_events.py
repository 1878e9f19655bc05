"""When an event is lost, telemetry reports its content once and in its place."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_host.declaration import Channel, Event, EventMessage, Fault, State, Trigger
from heli_host.link.events import LinkEvent, event_text
from heli_host.link.session import Session
from heli_host.link.telemetry import CHANNEL_COUNT, MissedEvents, Ticks, insert_missed

from tests.link.fake_board import FakeBoard, FakeLine


def ticks(first: int, *rows: tuple[State, Trigger] | tuple[State, Trigger, Fault]) -> Ticks:
    raw = np.zeros((len(rows), CHANNEL_COUNT), np.int32)
    for row, (state, trigger, *fault) in zip(raw, rows, strict=True):
        row[Channel.STATE], row[Channel.TRIGGER], row[Channel.FAULT] = state, trigger, sum(fault)
    return Ticks(np.arange(first, first + len(rows)).astype(np.uint32), raw)


FLYING = (State.CLOSED_LOOP, Trigger.CLOSE_LOOP)
HOLDING = (State.HOLD, Trigger.STALE_HOLD)
LANDING = (State.LANDING, Trigger.STALE_LAND)
LANDED = (State.IDLE, Trigger.STALE_LAND)
TRIPPED = (State.FAULT, Trigger.TRIP, Fault.PITCH_LIMIT)


def event(tick: int, state: State, cause: Trigger) -> EventMessage:
    return EventMessage(tick, Event.STATE, state, cause, 0.0)


def watching(*flown: tuple[State, Trigger]) -> MissedEvents:
    missed = MissedEvents()
    assert missed.take_ticks(ticks(100, *flown)) == []
    return missed


def test_the_first_samples_report_no_change() -> None:
    assert watching(LANDING, LANDING).take_ticks(ticks(102, LANDING)) == []


def test_a_change_with_a_lost_event_is_reported_with_trigger_and_tick() -> None:
    missed = watching(FLYING)
    events = missed.take_ticks(ticks(101, FLYING, HOLDING, HOLDING, LANDING))
    assert events == [
        event(102, State.HOLD, Trigger.STALE_HOLD),
        event(104, State.LANDING, Trigger.STALE_LAND),
    ]
    assert missed.take_ticks(ticks(105, LANDING, LANDING)) == []


def link_event(tick: int, message: EventMessage | None) -> LinkEvent:
    return LinkEvent(tick, 0, "any", "", message)


@pytest.mark.parametrize("base", [1000, 2**32 - 150], ids=["usual", "counter overflows"])
def test_a_reconstructed_event_stands_after_earlier_and_before_later_ones(base: int) -> None:
    earlier, lost, later = ((base + ticks) % 2**32 for ticks in (0, 100, 200))
    events = [
        link_event(earlier, event(earlier, *FLYING)),
        # An event of the link has no tick of its own.
        link_event(later, None),
        link_event(later, event(later, *LANDING)),
    ]
    insert_missed(event(lost, *HOLDING), 5, events)
    assert [entry.tick for entry in events] == [earlier, later, lost, later]
    assert events[2].message == event(lost, *HOLDING) and events[2].wall_ns == 5
    insert_missed(event((later + 1) % 2**32, *LANDED), 5, events)
    assert events[-1].message == event((later + 1) % 2**32, *LANDED)


def test_a_change_that_an_event_reported_is_not_reported_again() -> None:
    missed = watching(FLYING)
    missed.take_event(event(102, State.HOLD, Trigger.STALE_HOLD))
    assert missed.take_ticks(ticks(101, FLYING, HOLDING, LANDING)) == [
        event(103, State.LANDING, Trigger.STALE_LAND)
    ]


def test_an_event_within_a_gap_of_the_telemetry_counts_and_one_from_before_it_does_not() -> None:
    for tick, missing in ((101, 0), (900, 0), (1000, 0), (100, 1), (1001, 1)):
        missed = watching(FLYING)
        missed.take_event(event(tick, State.HOLD, Trigger.STALE_HOLD))
        assert len(missed.take_ticks(ticks(1000, HOLDING))) == missing, tick


def test_an_unseen_landing_is_reported_with_its_cause() -> None:
    missed = watching(FLYING)
    assert missed.take_ticks(ticks(9000, LANDED)) == [event(9000, State.IDLE, Trigger.STALE_LAND)]


def test_an_unseen_hold_is_reported_although_the_state_is_the_same() -> None:
    back = (State.CLOSED_LOOP, Trigger.SETPOINT_FRESH)
    assert watching(FLYING).take_ticks(ticks(900, back)) == [
        event(900, State.CLOSED_LOOP, Trigger.SETPOINT_FRESH)
    ]


def test_ticks_may_pass_2_to_the_32() -> None:
    missed = MissedEvents()
    missed.take_ticks(ticks(2**32 - 10, FLYING))
    missed.take_event(event(3, State.HOLD, Trigger.STALE_HOLD))
    assert missed.take_ticks(ticks(5, HOLDING)) == []


def test_a_fault_is_reported_by_its_code() -> None:
    missed = watching(FLYING)
    missed.take_event(event(101, State.FAULT, Trigger.TRIP))
    [fault] = missed.take_ticks(ticks(101, TRIPPED, TRIPPED))
    assert (fault.kind, fault.detail, fault.tick) == (Event.FAULT, Fault.PITCH_LIMIT, 101)
    assert math.isnan(fault.value)
    assert "pitch_limit" in event_text(fault) and "nan" not in event_text(fault)


@pytest.mark.medium
@pytest.mark.parametrize("lost", [False, True])
def test_a_session_reports_a_lost_event_once_with_telemetry_as_source(lost: bool) -> None:
    board = FakeBoard()
    session = Session(FakeLine(board))
    received: list[LinkEvent] = []
    session.subscribe_events(received.append)
    session.connect()
    session.wait(0.5)
    board.change_state(State.HOLD, tell=not lost)
    session.wait(0.5)
    [event] = [event for event in received if event.kind == "state"]
    assert event.text.startswith("state hold, because of ")
    assert ("lost" in event.text) == lost
