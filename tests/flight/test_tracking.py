"""An axis that does not follow, or does not count when it is driven, is a fault by its own name."""

from __future__ import annotations

from typing import Any

import heli_host.declaration as d
import pytest
from heli_host.declaration import Event, Fault, Result, State, Trigger

from tests.flight.harness import Harness

COUNT_DEG = 360.0 / 4096.0
ELEVATION, PITCH, TRAVEL = range(3)


def level(axes: int = 7) -> Harness:
    """A board that flies level, its arm moving a little all the time on every axis."""
    harness = Harness(tracked=True)
    assert harness.arm().result == Result.OK
    harness.glide(ELEVATION, 0.0, 100.0)
    assert harness.close_loops(axes).result == Result.OK
    return harness


def hover(harness: Harness, ticks: int, *, still: tuple[int, ...] = (), **setpoint: Any) -> None:
    """Keep it there: each axis swings by four counts unless it is still."""
    around = list(harness.angles_deg)
    for k in range(ticks):
        if k % 20 == 0:
            harness.setpoint(**setpoint)
        swing = (0, 2, 4, 2)[k // 10 % 4] * COUNT_DEG
        harness.move(*(at if axis in still else at + swing for axis, at in enumerate(around)))
        harness.tick()
    harness.move(*around)


def tripped(harness: Harness) -> tuple[Fault, Trigger]:
    event = harness.last_event(Event.FAULT)
    return Fault(event.detail), Trigger(event.cause)


def test_an_arm_that_moves_and_is_where_it_should_be_flies_on() -> None:
    harness = level()
    hover(harness, 5000)
    assert harness.state is State.CLOSED_LOOP


def test_without_counts_at_take_off_the_motors_are_cut_half_a_second_after_they_could_lift_the_arm() -> None:
    harness = Harness(tracked=True)
    harness.fly()
    harness.keep_flying(3000, elevation_deg=0.0)
    assert harness.motors_off
    assert tripped(harness) == (Fault.ELEVATION_MOTIONLESS, Trigger.TRIP)


def test_an_arm_on_the_table_may_rest_while_the_motors_push_too_little() -> None:
    harness = Harness(tracked=True)
    harness.set("elevation_motion_V", 1.2)
    harness.set("elevation_ki", 0.0)
    harness.set("elevation_kp", 0.05)
    harness.fly()
    harness.keep_flying(3000, elevation_deg=-24.0)
    assert harness.state is State.CLOSED_LOOP


@pytest.mark.parametrize("still", [(), (PITCH,)], ids=["counting", "silent"])
def test_a_pitch_that_is_driven_and_does_not_count_cuts_the_motors(still: tuple[int, ...]) -> None:
    harness = level(axes=3)
    hover(harness, 1000)
    hover(harness, 1500, still=still, pitch_deg=12.0)
    assert harness.motors_off == bool(still)
    if still:
        assert tripped(harness) == (Fault.PITCH_MOTIONLESS, Trigger.TRIP)


@pytest.mark.parametrize("step_counts", [1, 2])
def test_a_single_count_to_and_fro_is_no_motion(step_counts: int) -> None:
    harness = level(axes=3)
    hover(harness, 1000)
    for k in range(1500):
        if k % 20 == 0:
            harness.setpoint(pitch_deg=12.0)
        swing = 4 * COUNT_DEG * (k // 10 % 2)
        harness.move(elevation_deg=swing, pitch_deg=COUNT_DEG * step_counts * (k // 3 % 2))
        harness.tick()
    assert harness.motors_off == (step_counts == 1)


def test_a_travel_that_does_not_count_while_the_arm_tilts_is_landed_without_it_and_latched() -> None:
    harness = level()
    hover(harness, 1000)
    harness.glide(PITCH, 12.0, 60.0)
    hover(harness, 900, still=(TRAVEL,))
    assert harness.state is State.CLOSED_LOOP
    hover(harness, 400, still=(TRAVEL,))
    assert harness.state is State.EMERGENCY_LANDING
    assert tripped(harness) == (Fault.TRAVEL_MOTIONLESS, Trigger.TRAVEL_LOST)
    assert harness.motors[2]
    assert harness.close_loops().result == Result.BAD_STATE
    harness.move(pitch_deg=0.0)
    harness.glide(ELEVATION, -25.0, 20.0)
    harness.tick(1000)
    assert harness.state is State.FAULT and harness.motors_off
    assert harness.arm().result == Result.BAD_STATE
    assert harness.ask(d.ClearFaultMessage(0)).result == Result.OK


@pytest.mark.parametrize(
    ("axis", "away_deg", "fault", "ends"),
    [
        (ELEVATION, -16.0, Fault.ELEVATION_FOLLOWING, State.FAULT),
        (PITCH, 25.0, Fault.PITCH_FOLLOWING, State.FAULT),
        (TRAVEL, 35.0, Fault.TRAVEL_FOLLOWING, State.EMERGENCY_LANDING),
    ],
)
def test_an_axis_that_stays_away_from_its_setpoint_is_a_following_error(
    axis: int, away_deg: float, fault: Fault, ends: State
) -> None:
    harness = level(axes=3 if axis == PITCH else 7)
    # Else pitch, which the test holds, would not be where travel asks for it.
    for gain in ("travel_kp", "travel_ki", "travel_kd"):
        harness.set(gain, 0.0)
    hover(harness, 1000)
    harness.glide(axis, away_deg, 100.0)
    hover(harness, 900)
    assert harness.state is State.CLOSED_LOOP
    hover(harness, 600)
    assert harness.state is ends
    assert tripped(harness)[0] is fault


def test_nothing_of_this_applies_to_a_bench_in_open_loop_nor_to_an_axis_that_is_open() -> None:
    bench = Harness(tracked=True)
    bench.arm()
    bench.ask(d.ControlMessage(0, 0, 6.0, 4.0))
    for _ in range(30):
        bench.ping()
        bench.tick(100)
    assert bench.state is State.OPEN_LOOP
    tilted = level(axes=3)
    tilted.glide(PITCH, 10.0, 60.0)
    hover(tilted, 3000, still=(TRAVEL,), pitch_deg=10.0)
    assert tilted.state is State.CLOSED_LOOP


def test_a_law_on_the_host_is_watched_for_motion_too() -> None:
    harness = Harness(tracked=True)
    harness.arm()
    harness.ask(d.StreamMessage(0))
    for _ in range(80):
        harness.send(d.VoltagesMessage(6.0, 6.0, 50))
        harness.tick(20)
    assert tripped(harness)[0] is Fault.ELEVATION_MOTIONLESS
