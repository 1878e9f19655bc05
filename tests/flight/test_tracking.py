"""An axis that does not follow, or does not count when it is driven, is a fault by its own name."""

from __future__ import annotations

from typing import Any

import heli_host.declaration as d
import pytest
from heli_host.declaration import Event, Fault, Result, State, Trigger

from tests.flight.harness import DUTY_FULL, Harness

COUNT_DEG = 360.0 / 4096.0
SUPPLY_V, DEAD_ZONE_V = 12.0, 1.0
ELEVATION, PITCH, TRAVEL = range(3)


def board_in_level_flight(axes: int = 7, **parameters: float) -> Harness:
    """A board that flies level, its arm moving a little all the time on every axis."""
    harness = Harness(tracked=True)
    for name, value in parameters.items():
        harness.set(name, value)
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
    harness = board_in_level_flight()
    hover(harness, 5000)
    assert harness.state is State.CLOSED_LOOP


def lift_V(harness: Harness) -> float:
    """Sum of both motors' voltages above the dead zone."""
    front, back, _ = harness.motors
    return sum(max(0.0, duty * SUPPLY_V / DUTY_FULL - DEAD_ZONE_V) for duty in (front, back))


def test_without_counts_at_take_off_the_lift_decreases_to_nothing() -> None:
    harness = Harness(tracked=True)
    harness.fly()
    harness.keep_flying(1000, elevation_deg=0.0)
    assert harness.state is State.EMERGENCY_LANDING
    assert tripped(harness) == (Fault.ELEVATION_MOTIONLESS, Trigger.AXIS_LOST)
    lifts_V = [lift_V(harness)]
    for _ in range(18):
        harness.tick(1000)
        lifts_V.append(lift_V(harness))
    assert lifts_V == sorted(lifts_V, reverse=True)
    assert lifts_V[0] > 1.0 and lifts_V[9] == 0.0
    assert harness.state is State.FAULT and harness.motors_off


def test_an_arm_within_two_degrees_of_its_rest_may_lie_on_the_table() -> None:
    """It lies 1.5 degrees above its rest, on a soft table; the motors push more, and still too little."""
    harness = Harness(tracked=True)
    harness.glide(ELEVATION, -23.5, 5.0)
    harness.tick(300)
    harness.ping()
    assert harness.arm().result == Result.OK
    assert harness.ask(d.StreamMessage(0)).result == Result.OK
    for volts_V in (*[0.3] * 50, *[1.7] * 100):
        harness.send(d.VoltagesMessage(volts_V, volts_V, 40))
        harness.tick(20)
    assert harness.state is State.STREAMED


def test_an_arm_on_the_table_may_rest_while_the_motors_push_too_little() -> None:
    harness = Harness(tracked=True)
    harness.set("elevation_motion_V", 1.2)
    harness.set("elevation_ki", 0.0)
    harness.set("elevation_kp", 0.05)
    harness.fly()
    harness.keep_flying(3000, elevation_deg=-24.0)
    assert harness.state is State.CLOSED_LOOP


@pytest.mark.parametrize("still", [(), (PITCH,)], ids=["counting", "silent"])
def test_a_pitch_that_is_driven_and_does_not_count_is_landed_without_it(still: tuple[int, ...]) -> None:
    harness = board_in_level_flight(axes=3)
    hover(harness, 1000)
    hover(harness, 1500, still=still, pitch_deg=12.0)
    assert harness.state is (State.EMERGENCY_LANDING if still else State.CLOSED_LOOP)
    if still:
        assert tripped(harness) == (Fault.PITCH_MOTIONLESS, Trigger.AXIS_LOST)
        front, back, _ = harness.motors
        harness.move(pitch_deg=harness.angles_deg[PITCH] + 5 * COUNT_DEG)
        harness.tick()
        assert harness.motors[0] - harness.motors[1] == pytest.approx(front - back, abs=1)


@pytest.mark.parametrize("step_counts", [1, 2])
def test_a_single_count_to_and_fro_is_no_motion(step_counts: int) -> None:
    harness = board_in_level_flight(axes=3)
    hover(harness, 1000)
    for k in range(1500):
        if k % 20 == 0:
            harness.setpoint(pitch_deg=12.0)
        swing = 4 * COUNT_DEG * (k // 10 % 2)
        harness.move(elevation_deg=swing, pitch_deg=COUNT_DEG * step_counts * (k // 3 % 2))
        harness.tick()
    assert harness.state is (State.EMERGENCY_LANDING if step_counts == 1 else State.CLOSED_LOOP)


def test_a_travel_that_does_not_count_while_the_arm_tilts_is_landed_without_it_and_latched() -> None:
    harness = board_in_level_flight()
    hover(harness, 1000)
    harness.glide(PITCH, 12.0, 60.0)
    hover(harness, 900, still=(TRAVEL,))
    assert harness.state is State.CLOSED_LOOP
    hover(harness, 400, still=(TRAVEL,))
    assert harness.state is State.EMERGENCY_LANDING
    assert tripped(harness) == (Fault.TRAVEL_MOTIONLESS, Trigger.AXIS_LOST)
    assert harness.motors[2]
    assert harness.close_loops().result == Result.BAD_STATE
    harness.glide(PITCH, 0.0, 100.0)
    harness.glide(ELEVATION, -25.0, 20.0)
    harness.tick(1000)
    assert harness.state is State.FAULT and harness.motors_off
    assert harness.arm().result == Result.BAD_STATE
    assert harness.ask(d.ClearFaultMessage(0)).result == Result.OK


def balanced() -> Harness:
    """A board that flies level, in a test that holds elevation and pitch itself: only travel is watched.

    Pitch, which the test holds, cannot tilt to ask travel.
    """
    harness = Harness(tracked=True)
    harness.set("travel_silence_s", 0.0)
    for name in ("elevation_motion_V", "pitch_motion_V"):
        harness.set(name, 48.0)
    harness.arm()
    harness.glide(ELEVATION, 0.0, 100.0)
    harness.close_loops()
    return harness


def turn(harness: Harness, ticks: int, *, pitch_deg: float, rate_deg_s: float = 0.0) -> None:
    """Tilt the arm, and let travel turn at a rate."""
    harness.glide(PITCH, pitch_deg, 100.0)
    travel_deg = harness.angles_deg[TRAVEL]
    for k in range(ticks):
        if k % 20 == 0:
            harness.setpoint(travel_deg=harness.angles_deg[TRAVEL])
        harness.move(travel_deg=travel_deg + rate_deg_s * k / 1000.0)
        harness.tick()


def test_a_small_tilt_that_winds_up_slowly_must_turn_the_arm_too() -> None:
    harness = balanced()
    for step in range(18):
        turn(harness, 400, pitch_deg=0.4 * step)
    assert harness.state is State.EMERGENCY_LANDING
    assert tripped(harness) == (Fault.TRAVEL_MOTIONLESS, Trigger.AXIS_LOST)


@pytest.mark.parametrize("pitch_deg", [-12.0, 5.0])
def test_a_tilt_that_balances_a_constant_torque_is_no_fault(pitch_deg: float) -> None:
    harness = balanced()
    for rate_deg_s in (0.5, -0.5, 0.5, -0.5):
        turn(harness, 3000, pitch_deg=pitch_deg, rate_deg_s=rate_deg_s)
    turn(harness, 20_000, pitch_deg=pitch_deg)
    assert harness.state is State.CLOSED_LOOP


def test_an_arm_that_stops_by_its_tilt_and_is_level_then_is_no_fault() -> None:
    harness = balanced()
    for tenth in range(20):
        turn(harness, 100, pitch_deg=-13.0, rate_deg_s=5.0 - 0.25 * tenth)
    turn(harness, 5000, pitch_deg=0.0)
    assert harness.state is State.CLOSED_LOOP


@pytest.mark.parametrize("stops", ["at once", "evenly"])
def test_travel_that_stops_at_once_in_a_turn_is_landed_without_it(stops: str) -> None:
    harness = balanced()
    turn(harness, 1500, pitch_deg=0.0, rate_deg_s=8.0)
    for tenth in range(20 if stops == "evenly" else 0):
        turn(harness, 100, pitch_deg=-10.0, rate_deg_s=8.0 - 0.4 * tenth)
    turn(harness, 1000, pitch_deg=0.0)
    assert harness.state is (State.CLOSED_LOOP if stops == "evenly" else State.EMERGENCY_LANDING)


@pytest.mark.parametrize("doubtful", [False, True])
def test_a_landing_does_not_close_a_doubtful_travel(doubtful: bool) -> None:
    harness = balanced()
    turn(harness, 1000, pitch_deg=0.0)
    turn(harness, 1900, pitch_deg=5.0 if doubtful else 2.0)
    assert harness.state is State.CLOSED_LOOP
    harness.ask(d.LandMessage(0))
    harness.tick(10)
    assert harness.state is (State.EMERGENCY_LANDING if doubtful else State.LANDING)
    if doubtful:
        assert tripped(harness) == (Fault.TRAVEL_MOTIONLESS, Trigger.AXIS_LOST)


@pytest.mark.parametrize(
    ("axis", "away_deg", "fault", "ends"),
    [
        (ELEVATION, -16.0, Fault.ELEVATION_FOLLOWING, State.EMERGENCY_LANDING),
        (PITCH, 25.0, Fault.PITCH_FOLLOWING, State.FAULT),
        (TRAVEL, 35.0, Fault.TRAVEL_FOLLOWING, State.EMERGENCY_LANDING),
    ],
)
def test_an_axis_that_stays_away_from_its_setpoint_is_a_following_error(
    axis: int, away_deg: float, fault: Fault, ends: State
) -> None:
    # Else a pitch that the test turns against the voltages would have the wrong sign.
    harness = board_in_level_flight(axes=3 if axis == PITCH else 7, pitch_motion_V=48.0)
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
    tilted = board_in_level_flight(axes=3, pitch_motion_V=48.0)
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
