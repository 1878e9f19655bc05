"""Detail of a fault: its sign, the count since arming, and that nothing else erases it."""

from __future__ import annotations

import math

import pytest
from heli_host import declaration as d
from heli_host.declaration import Channel, Event, Fault, Result, State
from heli_host.link.telemetry import TelemetryDecoder
from heli_test_native.flight import ToldLaw, fault_before_arming

from tests.flight.harness import REST_DEG, Harness


def fault_in_telemetry(harness: Harness) -> Fault:
    payload = [frame.payload for frame in harness.frames if frame.id == d.MessageId.TELEMETRY][-1]
    return Fault(TelemetryDecoder().decode([payload]).raw[-1, Channel.FAULT])


def landing_without_travel() -> Harness:
    harness = Harness()
    harness.set("travel_motion_deg", 4.0)
    harness.arm()
    harness.glide(0, 0, 60)
    harness.close_loops()
    harness.glide(1, 10.0, 60)
    harness.keep_flying(1500)
    assert harness.state is State.EMERGENCY_LANDING
    return harness


def test_arming_is_refused_below_the_table_too(harness: Harness) -> None:
    harness.glide(0, REST_DEG - 4, 1.0)
    harness.tick(500)
    harness.ping()
    reply = harness.arm()
    assert (reply.result, reply.detail) == (Result.CHECK_FAILED, Fault.NOT_AT_REST)


@pytest.mark.parametrize("axis", [1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_limit_reports_which_way_it_was_broken(harness: Harness, axis: int, sign: int) -> None:
    harness.set("setpoint_hold_s", 5)
    harness.set("setpoint_land_s", 30)
    harness.fly()
    limit_deg = (46, 176)[axis - 1]
    harness.glide(axis, sign * limit_deg, 100)
    harness.tick(30)
    assert harness.last_event(Event.FAULT).value == pytest.approx(sign * limit_deg, abs=2)


def test_late_ticks_are_reported_as_counted_since_arming(harness: Harness) -> None:
    harness.tick(7, late=True)
    harness.fly()
    harness.tick(20, late=True)
    harness.tick(2)
    fault = harness.last_event(Event.FAULT)
    assert (fault.detail, fault.value) == (Fault.TICK_OVERRUN, 11)


def test_a_landing_that_is_asked_for_again_and_again_ends_as_soon() -> None:
    ended_ticks = []
    for asks in (1, 20):
        harness = Harness()
        harness.fly()
        harness.keep_flying(100, elevation_deg=REST_DEG)
        harness.ask(d.LandMessage(0))
        for k in range(2000):
            if harness.state is State.IDLE:
                ended_ticks.append(k)
                break
            if asks > 1 and k % 100 == 50 and harness.state is State.LANDING:
                harness.send(d.LandMessage(k // 100 + 100))
            harness.tick()
    assert len(ended_ticks) == 2 and abs(ended_ticks[1] - ended_ticks[0]) <= 5


def test_a_landing_that_is_asked_for_once_more_does_not_erase_why_the_board_lands() -> None:
    harness = landing_without_travel()
    assert harness.ask(d.LandMessage(0)).result == Result.OK
    harness.tick(40)
    assert harness.state is State.EMERGENCY_LANDING
    assert fault_in_telemetry(harness) is Fault.TRAVEL_MOTIONLESS


def test_an_axis_that_is_held_already_keeps_its_setpoint_when_its_loop_is_asked_for() -> None:
    law = ToldLaw()
    harness = Harness(law=law)
    harness.arm()
    harness.close_loops(3)
    harness.tick(600)
    assert harness.state is State.HOLD
    harness.glide(2, 5.0, 20.0)
    harness.close_loops(7)
    harness.tick(2)
    assert harness.state is State.CLOSED_LOOP
    assert math.degrees(law.setpoint_rad[2]) == pytest.approx(0.0, abs=0.1)


def test_a_setpoint_too_late_for_a_landing_is_no_fault(flying: Harness) -> None:
    flying.glide(0, 0, 60)
    flying.ask(d.LandMessage(0))
    before = sum(event.kind == Event.SETPOINT_REJECTED for event in flying.events)
    flying.keep_flying(1000)
    assert flying.state is State.LANDING
    assert sum(event.kind == Event.SETPOINT_REJECTED for event in flying.events) == before


def test_the_time_of_a_landing_that_took_too_long_is_counted_from_its_beginning(harness: Harness) -> None:
    harness.tick(5000)
    harness.ping()
    harness.fly()
    harness.glide(0, 0, 60)
    harness.ask(d.LandMessage(0))
    for _ in range(157):
        harness.glide(0, 2.0, 50.0)
        harness.glide(0, 0.0, 50.0)
    fault = harness.last_event(Event.FAULT)
    assert fault.detail == Fault.LANDING_TIMEOUT
    assert fault.value == pytest.approx(12.0, abs=0.1)


def test_an_arm_must_lie_still_at_a_stretch_to_have_landed(flying: Harness) -> None:
    flying.glide(0, REST_DEG + 3, 60)
    flying.ask(d.LandMessage(0))
    for _ in range(4):
        flying.glide(0, REST_DEG, 30)
        flying.tick(200)
        flying.glide(0, REST_DEG + 3, 30)
        flying.tick(50)
    assert flying.state is State.LANDING


@pytest.mark.parametrize(("above_deg", "landed"), [(1.3, True), (1.7, False)])
def test_an_arm_has_landed_within_a_degree_and_a_half_of_its_rest(
    flying: Harness, above_deg: float, landed: bool
) -> None:
    flying.glide(0, REST_DEG + 8, 60)
    flying.ask(d.LandMessage(0))
    flying.glide(0, REST_DEG + above_deg, 30)
    flying.tick(2000)
    assert flying.state is (State.IDLE if landed else State.FAULT)
    assert landed or flying.last_event(Event.FAULT).detail == Fault.ELEVATION_REST


def test_a_host_that_has_been_silent_for_half_a_second_cannot_arm() -> None:
    hold_ticks = round(1e3 * {p.name: p.default for p in d.PARAMS}["setpoint_hold_s"])
    assert fault_before_arming(hold_ticks) == (Fault.NONE, 0.0)
    fault, age_s = fault_before_arming(hold_ticks + 1)
    assert fault == Fault.LINK_NOT_ALIVE
    assert age_s == pytest.approx(0.501)


def test_the_status_counts_the_illegal_transitions_of_each_encoder(harness: Harness) -> None:
    for axis, transitions in enumerate((3, 5, 7)):
        harness.break_encoder(axis, transitions)
    harness.tick(300)
    status = harness.ask(d.StatusReadMessage(0))
    assert (status.illegal_elevation, status.illegal_pitch, status.illegal_travel) == (3, 5, 7)


def test_more_illegal_transitions_than_the_status_can_count_stay_at_its_end(harness: Harness) -> None:
    for axis, transitions in enumerate((65_535, 65_536, 70_000)):
        harness.break_encoder(axis, transitions)
    harness.tick(300)
    status = harness.ask(d.StatusReadMessage(0))
    assert (status.illegal_elevation, status.illegal_pitch, status.illegal_travel) == (65_535,) * 3
