"""Which drives must move an axis: on the table, across zero, on a bench, on another board."""

from collections.abc import Iterable

import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.declaration import Event, Fault, ParamsSource, Result, State, Trigger
from heli_test_native import link

from tests.flight.harness import (
    DUTY_FULL,
    ELEVATION,
    NO_AXES,
    PAGE_BYTES,
    PITCH,
    REST_DEG,
    TRAVEL,
    WITHOUT_TRAVEL,
    Harness,
)
from tests.flight.test_tracking import COUNT_DEG, board_in_level_flight, hover, tripped

HOVER_V, DEAD_V, MOTION_V = (
    next(spec.default for spec in d.PARAMS if spec.name == name)
    for name in ("hover_V", "dead_zone_V", "pitch_motion_V")
)


def streamed(front_V: float = 0.0, back_V: float = 0.0, **parameters: float) -> Harness:
    """A board on the table that a host's law drives from the first tick on."""
    harness = Harness(tracked=True)
    for name, value in ({"elevation_motion_V": 10.0} | parameters).items():
        harness.set(name, value)
    harness.arm()
    harness.ask(d.StreamMessage(0))
    drive(harness, 20, front_V, back_V)
    return harness


def drive(
    harness: Harness, ticks: int, front_V: float, back_V: float, pitches_deg: Iterable[float] = ()
) -> None:
    places_deg = iter(pitches_deg)
    for k in range(ticks):
        if k % 20 == 0:
            harness.send(d.VoltagesMessage(front_V=front_V, back_V=back_V, valid_ms=50))
        harness.move(pitch_deg=next(places_deg, harness.angles_deg[PITCH]))
        harness.tick()


@pytest.mark.parametrize(("low", "high", "moves"), [(-1, 0, False), (-2, 2, True), (-1, 1, True)])
def test_motion_is_more_than_a_count_on_either_side_of_zero(low: int, high: int, moves: bool) -> None:
    harness = board_in_level_flight(axes=WITHOUT_TRAVEL)
    hover(harness, 1000)
    for k in range(1500):
        if k % 20 == 0:
            harness.setpoint(pitch_deg=12.0)
        harness.move(
            elevation_deg=4 * COUNT_DEG * (k // 10 % 2), pitch_deg=COUNT_DEG * (low, high)[k // 10 % 2]
        )
        harness.tick()
    assert (harness.state is State.CLOSED_LOOP) == moves


def test_an_arm_on_the_table_need_not_turn_when_it_is_tilted() -> None:
    lift_V = DEAD_V + 0.5 * HOVER_V
    harness = streamed(lift_V, lift_V)
    drive(harness, 3000, lift_V, lift_V, (min(0.1 * k, 12.0) for k in range(3000)))
    assert harness.state is State.STREAMED


def test_a_pitch_that_does_not_count_is_noticed_on_the_table_too() -> None:
    harness = streamed()
    drive(harness, 1500, front_V=DEAD_V + 1.0, back_V=0.0)
    assert tripped(harness) == (Fault.PITCH_MOTIONLESS, Trigger.TRIP)


def test_a_motor_that_is_driven_backwards_has_a_dead_zone_too() -> None:
    """A pitch must move by what its dead zone leaves of a voltage, and by no more."""
    harness = streamed(motor_min_V=-12.0)
    drive(harness, 1500, front_V=0.0, back_V=-(DEAD_V + 0.5 * MOTION_V))
    assert harness.state is State.STREAMED
    drive(harness, 1500, front_V=0.0, back_V=-(DEAD_V + 2.0 * MOTION_V))
    assert tripped(harness) == (Fault.PITCH_MOTIONLESS, Trigger.TRIP)


def test_what_a_bench_drove_already_is_no_change_of_drive() -> None:
    harness = Harness(tracked=True)
    harness.set("elevation_motion_V", 10.0)
    harness.arm()
    harness.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=DEAD_V + 1.0, back_V=0.0))
    for _ in range(10):
        harness.ping()
        harness.tick(100)
    harness.ask(d.StreamMessage(0))
    drive(harness, 1500, front_V=DEAD_V + 1.0, back_V=0.0)
    assert harness.state is State.STREAMED


def test_the_drive_of_the_single_tick_in_which_a_swing_turns_round_is_none_to_compare_with() -> None:
    lift_V = DEAD_V + 0.5
    harness = streamed(lift_V, lift_V)
    swing_deg = [2 * COUNT_DEG * (k // 2 % 2) for k in range(600)]
    drive(harness, 600, lift_V, lift_V, swing_deg)
    harness.send(d.VoltagesMessage(front_V=lift_V + 0.5, back_V=lift_V - 0.5, valid_ms=50))
    for deg in (8.0, 4.0, 8.0):
        harness.move(pitch_deg=deg * COUNT_DEG)
        harness.tick()
    drive(harness, 1500, lift_V, lift_V)
    assert harness.state is State.STREAMED


def test_a_landing_has_its_own_time_and_no_following_error_of_the_elevation() -> None:
    harness = board_in_level_flight()
    hover(harness, 200)
    harness.ask(d.LandMessage(0))
    hover_deg = list(harness.angles_deg)
    # Eight seconds of a small swing, in which the arm does not descend.
    for k in range(8000):
        swing_deg = (0, 2, 4, 2)[k // 10 % 4] * COUNT_DEG
        harness.move(*(angle_deg + swing_deg for angle_deg in hover_deg))
        harness.tick()
    assert harness.state is State.LANDING


def test_how_far_travel_must_have_turned_is_given_in_degrees() -> None:
    harness = board_in_level_flight()
    hover(harness, 1000)
    harness.glide(PITCH, to_deg=12.0, deg_s=60.0)
    hover(harness, 1300, still=(TRAVEL,))
    # 8 degrees of tilt for 1 s, at half a degree of acceleration per degree of tilt.
    assert harness.last_event(Event.FAULT).value == pytest.approx(2.0, abs=0.1)
    assert harness.angles_deg[ELEVATION] > REST_DEG


def test_lift_that_barely_carries_the_arm_need_not_raise_it() -> None:
    # Half a volt of lift more than hovering takes; the fault begins at 1.2 V more.
    each_V = DEAD_V + 0.5 * (HOVER_V + 0.5)
    harness = Harness(tracked=True)
    harness.arm()
    harness.ask(d.StreamMessage(0))
    drive(harness, 2000, each_V, each_V)
    assert harness.state is State.STREAMED


@pytest.mark.parametrize("count", [-1, 1])
def test_a_single_count_either_way_does_not_give_a_still_axis_more_time(count: int) -> None:
    harness = streamed()
    drive(harness, 340, front_V=DEAD_V + 1.0, back_V=0.0)
    assert harness.state is State.STREAMED
    drive(harness, 260, front_V=DEAD_V + 1.0, back_V=0.0, pitches_deg=[count * COUNT_DEG])
    assert harness.motors_off


SUPPLY_V = 12.0
FRONT_V, BACK_V = 3.0, 1.5
SET_BYTES = 512
HOVER = next(spec.index for spec in d.PARAMS if spec.name == "hover_V")


def driven(duty_full: int, front_V: float = FRONT_V, back_V: float = BACK_V) -> Harness:
    """A board of which the host streams voltages to the motors."""
    harness = Harness(duty_full=duty_full)
    assert harness.set("motor_max_V", SUPPLY_V).result == Result.OK
    harness.arm()
    harness.ask(d.StreamMessage(0))
    for _ in range(200):
        harness.send(d.VoltagesMessage(front_V=front_V, back_V=back_V, valid_ms=50))
        harness.tick(10)
    return harness


@pytest.mark.parametrize("duty_full", [255, 1000, DUTY_FULL, 4095, 10000])
def test_a_voltage_is_its_share_of_the_boards_own_full_duty(duty_full: int) -> None:
    harness = driven(duty_full)
    front, back, enabled = harness.motors
    assert enabled
    assert front == pytest.approx(duty_full * FRONT_V / SUPPLY_V, abs=0.5)
    assert back == pytest.approx(duty_full * BACK_V / SUPPLY_V, abs=0.5)


@pytest.mark.parametrize("duty_full", [255, 1000, 10000])
def test_the_voltage_logged_is_the_one_that_the_duty_makes(duty_full: int) -> None:
    harness = driven(duty_full)
    front, back, _ = harness.motors
    acted_mV = harness.telemetry().raw[-1, [d.Channel.FRONT, d.Channel.BACK]]
    assert np.abs(acted_mV - 1000 * SUPPLY_V * np.array([front, back]) / duty_full).max() <= 0.5


@pytest.mark.parametrize("duty_full", [255, 1000])
def test_no_duty_is_beyond_full(duty_full: int) -> None:
    assert driven(duty_full, SUPPLY_V, SUPPLY_V).motors == (duty_full, duty_full, True)


def saved(board: link.Board, hover_V: float) -> bool:
    params = link.Params()
    params.set(HOVER, hover_V, idle=True)
    return link.Store(board).save(params)


@pytest.mark.parametrize("page_bytes", [PAGE_BYTES, 1024, 4096])
def test_parameters_are_kept_in_pages_of_any_length(page_bytes: int) -> None:
    board = link.Board(DUTY_FULL, page_bytes)
    assert len(board.flash) == 2 * page_bytes
    for hover_V in (2.0, 3.0, 4.0):
        assert saved(board, hover_V)
        params = link.Params()
        assert link.Store(board).load(params) == ParamsSource.STORED
        assert params.get(HOVER) == hover_V
    for page in (0, 1):
        behind = board.flash[page * page_bytes + SET_BYTES : (page + 1) * page_bytes]
        assert behind == b"\xff" * (page_bytes - SET_BYTES)
