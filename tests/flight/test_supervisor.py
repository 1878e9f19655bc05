"""Who may start the motors, what stops them, when, and what a fault states."""

import dataclasses
import itertools
import math
from typing import Any

import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.declaration import Channel, Event, Fault, Result, State, Trigger
from heli_host.link.channels import physical
from heli_test_native import flight
from heli_test_native.flight import ToldLaw, fault_before_arming

from tests.flight.harness import (
    ALL_AXES,
    DUTY_FULL,
    ELEVATION,
    NO_AXES,
    PITCH,
    REST_DEG,
    TRAVEL,
    WITHOUT_TRAVEL,
    Harness,
)

# The table as docs and README promise it, written a second time: (from, trigger) -> to.
PROMISED = {
    (State.IDLE, Trigger.ARM): State.ARMED,
    (State.ARMED, Trigger.CLOSE_LOOP): State.CLOSED_LOOP,
    (State.ARMED, Trigger.OPEN_LOOP): State.OPEN_LOOP,
    (State.ARMED, Trigger.STREAM): State.STREAMED,
    (State.ARMED, Trigger.LAND): State.IDLE,
    (State.ARMED, Trigger.STALE_LAND): State.IDLE,
    (State.CLOSED_LOOP, Trigger.STALE_HOLD): State.HOLD,
    (State.STREAMED, Trigger.STALE_HOLD): State.HOLD,
    (State.OPEN_LOOP, Trigger.STALE_HOLD): State.IDLE,
    (State.HOLD, Trigger.SETPOINT_FRESH): State.CLOSED_LOOP,
    (State.HOLD, Trigger.STALE_LAND): State.LANDING,
    (State.HOLD, Trigger.CLOSE_LOOP): State.CLOSED_LOOP,
    (State.HOLD, Trigger.STREAM): State.STREAMED,
    (State.HOLD, Trigger.LAND): State.LANDING,
    (State.LANDING, Trigger.TOUCHDOWN): State.IDLE,
    (State.LANDING, Trigger.CLOSE_LOOP): State.CLOSED_LOOP,
    (State.LANDING, Trigger.LAND): State.LANDING,
    (State.FAULT, Trigger.CLEAR): State.IDLE,
    (State.FAULT, Trigger.STOP): State.FAULT,
}
PROMISED |= {
    (State.EMERGENCY_LANDING, Trigger.TOUCHDOWN): State.FAULT,
    (State.EMERGENCY_LANDING, Trigger.LAND): State.EMERGENCY_LANDING,
    (State.EMERGENCY_LANDING, Trigger.AXIS_LOST): State.EMERGENCY_LANDING,
}
for controlled in (State.CLOSED_LOOP, State.STREAMED, State.HOLD, State.LANDING):
    PROMISED[controlled, Trigger.AXIS_LOST] = State.EMERGENCY_LANDING
PROMISED |= {(s, Trigger.STOP): State.IDLE for s in State if s is not State.FAULT}
PROMISED |= {(s, Trigger.TRIP): State.FAULT for s in State}
for flying in (State.CLOSED_LOOP, State.OPEN_LOOP, State.STREAMED):
    PROMISED |= {
        (flying, Trigger.CLOSE_LOOP): State.CLOSED_LOOP,
        (flying, Trigger.OPEN_LOOP): State.OPEN_LOOP,
        (flying, Trigger.STREAM): State.STREAMED,
        (flying, Trigger.LAND): State.LANDING,
    }


@pytest.mark.parametrize(
    "state, trigger", list(itertools.product(State, Trigger)), ids=lambda x: x.name.lower()
)
def test_every_cell_of_the_state_table_is_as_promised(state: State, trigger: Trigger) -> None:
    assert flight.next_state(state, trigger) == PROMISED.get((state, trigger))


def test_power_up_is_idle_with_the_bridges_off_and_the_arm_at_rest() -> None:
    harness = Harness(session=False)
    assert harness.state is State.IDLE
    assert harness.motors_off


def test_nothing_is_obeyed_before_a_handshake() -> None:
    harness = Harness(session=False)
    assert harness.arm().result == Result.NO_HANDSHAKE
    assert harness.state is State.IDLE


def test_armed_drives_are_enabled_at_zero_voltage(harness: Harness) -> None:
    assert harness.arm().result == Result.OK
    assert harness.state is State.ARMED
    assert harness.motors == (0, 0, True)


def refused_with(harness: Harness, fault: Fault) -> None:
    reply = harness.arm()
    assert (reply.result, reply.detail) == (Result.CHECK_FAILED, fault)
    assert harness.motors_off


@pytest.mark.parametrize(
    "axis, angle_deg, rate_deg_s, wait_ticks, fault",
    [
        (ELEVATION, REST_DEG + 4, 1.0, 500, Fault.NOT_AT_REST),
        (ELEVATION, REST_DEG - 4, 1.0, 500, Fault.NOT_AT_REST),
        (PITCH, 12, 20.0, 400, Fault.PITCH_NOT_LEVEL),
        (TRAVEL, 20, 30.0, 0, Fault.MOVING),
    ],
)
def test_arming_is_refused_away_from_rest_tilted_or_while_moving(
    harness: Harness, axis: int, angle_deg: float, rate_deg_s: float, wait_ticks: int, fault: Fault
) -> None:
    harness.glide(axis, to_deg=angle_deg, deg_s=rate_deg_s)
    harness.tick(wait_ticks)
    harness.ping()
    refused_with(harness, fault)


def test_arming_is_refused_when_parameters_contradict_each_other(harness: Harness) -> None:
    assert harness.set("motor_max_V", 24).result == Result.OK  # above the supply of 12 V
    refused_with(harness, Fault.PARAMETERS_INVALID)


def test_arming_is_refused_while_the_hardware_stop_is_pressed(harness: Harness) -> None:
    harness.core.stop_input(True)
    refused_with(harness, Fault.HARDWARE_STOP)


def test_arming_is_refused_in_flight(flying: Harness) -> None:
    reply = flying.arm()
    assert (reply.result, reply.detail) == (Result.BAD_STATE, State.CLOSED_LOOP)


@pytest.mark.parametrize(
    "axis, angle_deg, rate_deg_s, fault, value",
    [
        (ELEVATION, 25, 60, Fault.ELEVATION_LIMIT, 25),
        (PITCH, 46, 200, Fault.PITCH_LIMIT, 46),
        (PITCH, -46, 200, Fault.PITCH_LIMIT, -46),
        (TRAVEL, 176, 100, Fault.TRAVEL_LIMIT, 176),
        (TRAVEL, -176, 100, Fault.TRAVEL_LIMIT, -176),
        (ELEVATION, 0, 140, Fault.ELEVATION_RATE, 120),
        (PITCH, 40, 440, Fault.PITCH_RATE, 400),
        (TRAVEL, 90, 180, Fault.TRAVEL_RATE, 150),
    ],
)
def test_each_limit_ends_the_flight_and_names_itself_and_the_value(
    harness: Harness, axis: int, angle_deg: float, rate_deg_s: float, fault: Fault, value: float
) -> None:
    harness.set("setpoint_hold_s", 5)
    harness.set("setpoint_land_s", 30)
    harness.fly()
    harness.glide(axis, to_deg=angle_deg, deg_s=rate_deg_s)
    harness.tick(30)
    assert harness.state is (State.EMERGENCY_LANDING if axis == ELEVATION else State.FAULT)
    assert harness.motors_off == (axis != ELEVATION)
    event = harness.last_event(Event.FAULT)
    assert event.detail == fault
    assert event.value == pytest.approx(value, abs=2)


@pytest.mark.parametrize(
    "axis, fault", [(0, Fault.ENCODER_ELEVATION), (1, Fault.ENCODER_PITCH), (2, Fault.ENCODER_TRAVEL)]
)
def test_illegal_encoder_transitions_are_tolerated_up_to_the_parameter_then_cut(
    harness: Harness, axis: int, fault: Fault
) -> None:
    harness.break_encoder(axis, 100)  # before arming they do not count
    harness.tick()
    harness.fly()
    harness.break_encoder(axis, 5)
    harness.tick()
    assert harness.state is State.CLOSED_LOOP
    harness.break_encoder(axis, 1)
    harness.tick(5)
    assert harness.motors_off
    assert harness.last_event(Event.FAULT).detail == fault


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("before", [0xFFFA, 0xFFFF, 0x10000, 0xFFFF_FFFA, 0xFFFF_FFFF])
def test_illegal_transitions_before_arming_hide_none_in_flight(
    harness: Harness, axis: int, before: int
) -> None:
    harness.break_encoder(axis, before)
    harness.tick()
    harness.fly()
    harness.break_encoder(axis, 6)
    harness.tick(5)
    assert harness.last_event(Event.FAULT).detail == Fault.ENCODER_ELEVATION + axis


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("deg", [0.0, 300.0])
def test_an_overloaded_encoder_cuts_in_its_own_name_whatever_it_counted(
    flying: Harness, axis: int, deg: float
) -> None:
    flying.angles_deg[axis] += deg
    flying.break_encoder(axis, 100 if deg else 0)
    flying.core.overload(400)
    flying.tick(2)
    assert flying.state is State.FAULT
    assert flying.motors_off
    fault = flying.last_event(Event.FAULT)
    assert (fault.detail, fault.value) == (Fault.ENCODER_OVERLOAD, 400.0)


def test_arming_is_refused_while_an_encoder_is_overloaded(harness: Harness) -> None:
    harness.core.overload(400)
    harness.tick()
    refused_with(harness, Fault.ENCODER_OVERLOAD)
    harness.core.overload(0)
    harness.tick()
    assert harness.arm().result == d.Result.OK


def test_a_fault_stays_until_it_is_cleared_and_not_while_its_cause_is_pressed(flying: Harness) -> None:
    flying.core.stop_input(True)
    flying.tick(2)
    assert flying.state is State.FAULT
    assert flying.arm().result == Result.BAD_STATE
    assert flying.ask(d.ClearFaultMessage(0)).detail == Fault.HARDWARE_STOP
    flying.core.stop_input(False)
    flying.tick()
    assert flying.ask(d.ClearFaultMessage(0)).result == Result.OK
    assert flying.state is State.IDLE


def test_setpoint_loss_holds_level_after_half_a_second_then_lands_after_two_then_cuts(
    flying: Harness,
) -> None:
    flying.glide(ELEVATION, to_deg=0, deg_s=20)
    flying.keep_flying(2000)
    # The last setpoint was taken 20 ticks before keep_flying ended. Without another one the board holds after
    # setpoint_hold_s, 0.5 s, and lands after setpoint_land_s, 2 s.
    flying.tick(470)
    assert flying.state is State.CLOSED_LOOP
    flying.tick(20)
    assert flying.state is State.HOLD
    assert flying.last_event(Event.SETPOINT_STALE).value == pytest.approx(50, abs=2)
    flying.tick(1470)
    assert flying.state is State.HOLD
    flying.tick(40)
    assert flying.state is State.LANDING
    flying.glide(ELEVATION, to_deg=REST_DEG, deg_s=10)
    flying.tick(250)
    assert flying.state is State.LANDING
    flying.tick(400)
    assert flying.state is State.IDLE
    assert flying.motors_off


def states_in_telemetry(harness: Harness) -> list[tuple[State, Trigger]]:
    """States with what led to them, as the samples have them, each once."""
    raw = harness.telemetry().raw
    pairs = [(State(row[Channel.STATE]), Trigger(row[Channel.TRIGGER])) for row in raw]
    return [pair for pair, _ in itertools.groupby(pairs)]


def test_telemetry_states_the_cause_of_a_state_also_after_touchdown(flying: Harness) -> None:
    flying.tick(600)
    flying.keep_flying(40, elevation_deg=REST_DEG)
    flying.tick(2900)
    assert flying.state is State.IDLE
    flying.tick(40)
    reported = states_in_telemetry(flying)
    assert reported == [
        (State.IDLE, Trigger.START),
        (State.ARMED, Trigger.ARM),
        (State.CLOSED_LOOP, Trigger.CLOSE_LOOP),
        (State.HOLD, Trigger.STALE_HOLD),
        (State.CLOSED_LOOP, Trigger.SETPOINT_FRESH),
        (State.HOLD, Trigger.STALE_HOLD),
        (State.LANDING, Trigger.STALE_LAND),
        (State.IDLE, Trigger.STALE_LAND),
    ]
    events = [(e.detail, e.cause) for e in flying.events if e.kind == Event.STATE]
    assert events == [*reported[1:-1], (State.IDLE, Trigger.TOUCHDOWN)]


def test_telemetry_reports_a_trip_and_its_clearing(flying: Harness) -> None:
    flying.move(pitch_deg=60)
    flying.tick(40)
    flying.ask(d.ClearFaultMessage(0))
    flying.tick(40)
    assert states_in_telemetry(flying)[-2:] == [(State.FAULT, Trigger.TRIP), (State.IDLE, Trigger.CLEAR)]


def test_a_setpoint_that_comes_back_ends_the_hold_but_not_a_landing(flying: Harness) -> None:
    flying.tick(600)  # longer than setpoint_hold_s
    assert flying.state is State.HOLD
    flying.keep_flying(40, elevation_deg=REST_DEG)
    assert flying.state is State.CLOSED_LOOP
    flying.glide(ELEVATION, to_deg=-10, deg_s=20)
    flying.tick(2100)  # longer than setpoint_land_s
    assert flying.state is State.LANDING
    flying.keep_flying(40)
    assert flying.state is State.LANDING


@pytest.mark.parametrize("rest_deg", [REST_DEG - 2.5, REST_DEG + 2.0, -10.0])
def test_an_arm_that_rests_elsewhere_than_before_take_off_has_not_landed(
    flying: Harness, rest_deg: float
) -> None:
    """Its encoder has lost counts, or it floats without voltage."""
    flying.glide(ELEVATION, to_deg=0, deg_s=60)
    flying.ask(d.LandMessage(0))
    flying.glide(ELEVATION, to_deg=rest_deg, deg_s=10)
    flying.tick(1500)
    assert flying.state is State.FAULT
    assert flying.last_event(Event.FAULT).detail == Fault.ELEVATION_REST


def test_an_elevation_below_the_table_is_landed_without_its_encoder(flying: Harness) -> None:
    flying.glide(ELEVATION, to_deg=-5, deg_s=60)
    flying.keep_flying(600, elevation_deg=-5.0)
    # The limit is 3 degrees below the rest: the tolerance of arming, and one for the table.
    flying.glide(ELEVATION, to_deg=REST_DEG - 2.9, deg_s=60)
    assert flying.state is State.CLOSED_LOOP
    flying.glide(ELEVATION, to_deg=REST_DEG - 3.2, deg_s=60)
    assert flying.last_event(Event.FAULT).detail == Fault.ELEVATION_BELOW_TABLE
    assert flying.state is State.EMERGENCY_LANDING
    flying.tick(18_100)  # longer than the blind descent, 18 s
    assert flying.state is State.FAULT and flying.motors_off


def test_on_a_bench_a_person_may_move_the_arm_anywhere(harness: Harness) -> None:
    harness.arm()
    harness.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=1.5, back_V=1.5))
    for k in range(50):
        harness.glide(ELEVATION, to_deg=REST_DEG - 0.1 * k, deg_s=20)
        harness.ping()
    assert harness.state is State.OPEN_LOOP


@pytest.mark.parametrize("armed_deg", [REST_DEG, REST_DEG + 1.5])
def test_an_elevation_that_decreases_at_take_off_has_the_wrong_sign(
    harness: Harness, armed_deg: float
) -> None:
    """The voltage stays at that of a hover meanwhile. Then the motors are cut: the arm is on the table."""
    harness.glide(ELEVATION, to_deg=armed_deg, deg_s=1.0)
    harness.tick(300)
    harness.ping()
    harness.fly()
    harness.keep_flying(250, elevation_deg=0.0)
    duty_at_take_off = harness.motors.front_duty
    # Half of hover_V and the dead zone, of 12 V.
    hover_duty = round((0.5 * 1.4 + 1.0) / 12.0 * DUTY_FULL)
    most_duty = 0
    for _ in range(200):
        if harness.motors_off:
            break
        # The arm, which should rise, is read to sink count by count.
        harness.glide(ELEVATION, to_deg=harness.angles_deg[ELEVATION] - 360 / 4096, deg_s=30.0)
        most_duty = max(most_duty, harness.motors.front_duty)
    assert duty_at_take_off > hover_duty
    assert most_duty <= hover_duty + 1
    assert harness.last_event(Event.FAULT).detail == Fault.ELEVATION_SIGN
    assert harness.state is State.FAULT
    assert harness.angles_deg[ELEVATION] > REST_DEG - 0.5


STEPS = (Fault.ELEVATION_STEP, Fault.PITCH_STEP, Fault.TRAVEL_STEP)
STEP_MAX_COUNTS = (7, 21, 9)
"""Turn of each axis at its highest rate in the 4 ms between two looks, a tenth more, and a count."""


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_step_that_no_arm_makes_is_landed_without_its_axis(flying: Harness, axis: int, sign: int) -> None:
    flying.glide(ELEVATION, to_deg=-5, deg_s=60)
    flying.keep_flying(600, elevation_deg=-5.0)
    count_deg = 360 / 4096
    allowed = STEP_MAX_COUNTS[axis]
    for counts, state in ((allowed, State.CLOSED_LOOP), (allowed + 1, State.EMERGENCY_LANDING)):
        flying.angles_deg[axis] += sign * counts * count_deg
        flying.move(flying.angles_deg[ELEVATION])
        flying.tick(4)
        assert flying.state is state
        flying.keep_flying(100, elevation_deg=-5.0)
    assert flying.last_event(Event.FAULT).detail == STEPS[axis]


@pytest.mark.parametrize("axis", range(3))
def test_after_a_step_nothing_is_armed_until_the_axis_is_zeroed(harness: Harness, axis: int) -> None:
    """A plug that was loose before the flight: its reading is wrong by what it missed."""
    harness.angles_deg[axis] += 1.9 if axis != 1 else 4.0
    harness.move(harness.angles_deg[ELEVATION])
    harness.tick(500)
    harness.ping()
    refused_with(harness, STEPS[axis])
    assert harness.ask(d.ZeroMessage(request=0, axes=ALL_AXES & ~(1 << axis))).result == Result.OK
    refused_with(harness, STEPS[axis])
    assert harness.ask(d.ZeroMessage(request=0, axes=1 << axis)).result == Result.OK
    harness.tick(500)
    harness.ping()
    assert harness.arm().result == Result.OK


def test_a_new_sign_a_new_rest_and_a_new_zero_are_no_steps(harness: Harness) -> None:
    harness.glide(TRAVEL, to_deg=60, deg_s=100.0)
    harness.set("travel_counts_per_rev", -4096)
    harness.set("elevation_rest_deg", -20)
    harness.ask(d.ZeroMessage(request=0, axes=ALL_AXES))
    harness.tick(500)
    harness.ping()
    assert harness.arm().result == Result.OK


def test_a_second_lost_axis_is_left_out_of_the_same_landing_and_the_first_fault_is_its_reason(
    flying: Harness,
) -> None:
    flying.glide(ELEVATION, to_deg=-5, deg_s=60)
    flying.keep_flying(600, elevation_deg=-5.0)
    flying.move(travel_deg=3.0)
    flying.tick(4)
    flying.move(elevation_deg=0.0)
    flying.tick(4)
    assert [e.detail for e in flying.events if e.kind == Event.FAULT] == [
        Fault.TRAVEL_STEP,
        Fault.ELEVATION_STEP,
    ]
    assert flying.state is State.EMERGENCY_LANDING
    flying.tick(18_100)
    assert flying.state is State.FAULT


def test_stop_works_from_every_state_that_has_motors() -> None:
    def streamed(harness: Harness) -> None:
        harness.arm()
        harness.ask(d.StreamMessage(0))

    def open_loop(harness: Harness) -> None:
        harness.arm()
        harness.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=1.5, back_V=1.5))

    def hold(harness: Harness) -> None:
        harness.fly()
        harness.tick(600)

    def landing(harness: Harness) -> None:
        harness.fly()
        harness.glide(ELEVATION, to_deg=0, deg_s=60)
        harness.ask(d.LandMessage(0))

    reached = set()
    for prepare in (Harness.arm, Harness.fly, streamed, open_loop, hold, landing, land_without_travel):
        harness = Harness()
        prepare(harness)
        reached.add(harness.state)
        assert harness.ask(d.StopMessage(0)).result == Result.OK
        assert harness.motors_off
    assert reached == set(State) - {State.IDLE, State.FAULT}


def test_streamed_voltage_acts_for_its_time_only_then_the_board_holds_by_itself(harness: Harness) -> None:
    harness.arm()
    harness.ask(d.StreamMessage(0))
    for _ in range(100):
        harness.send(d.VoltagesMessage(front_V=2.0, back_V=1.5, valid_ms=50))
        harness.tick(10)
    assert harness.motors[:2] == (350, 263)  # counts: 2.0 V and 1.5 V of 12 V, times 2100
    harness.send(d.VoltagesMessage(front_V=2.0, back_V=1.5, valid_ms=50))
    harness.tick(48)
    assert harness.state is State.STREAMED
    harness.tick(5)
    assert harness.state is State.HOLD


@pytest.mark.parametrize(("named_ms", "valid_ms"), [(20, 20), (60_000, 100)])
def test_a_streamed_voltage_acts_for_its_time_or_the_longest_allowed(
    harness: Harness, named_ms: int, valid_ms: int
) -> None:
    harness.arm()
    harness.ask(d.StreamMessage(0))
    harness.send(d.VoltagesMessage(front_V=1.0, back_V=1.0, valid_ms=named_ms))
    harness.tick(valid_ms - 1)
    assert harness.state is State.STREAMED
    harness.tick(4)
    assert harness.state is State.HOLD


def test_open_loop_without_a_living_link_cuts_the_motors(harness: Harness) -> None:
    harness.arm()
    harness.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=1.5, back_V=1.5))
    harness.tick(480)
    assert harness.state is State.OPEN_LOOP
    harness.tick(40)
    assert harness.state is State.IDLE
    assert harness.motors_off


def test_armed_without_a_living_link_disarms(harness: Harness) -> None:
    harness.arm()
    harness.tick(1990)
    assert harness.state is State.ARMED
    harness.tick(40)
    assert harness.motors_off


@pytest.mark.parametrize(
    "setpoint",
    [
        {"elevation_deg": 22.5},
        {"elevation_deg": -27.0},
        {"pitch_deg": 30.5},
        {"travel_deg": 171.0},
        {"travel_deg": -171.0},
        {"at_tick": 10**6},
    ],
)
def test_a_setpoint_outside_the_limits_is_refused_and_reported(
    flying: Harness, setpoint: dict[str, float]
) -> None:
    flying.setpoint(**setpoint)  # type: ignore[arg-type]
    flying.tick(30)
    assert flying.last_event(Event.SETPOINT_REJECTED).detail == Result.BAD_VALUE
    flying.tick(480)
    assert flying.state is State.HOLD, "a refused setpoint must not count as fresh"


def test_a_host_that_streams_nonsense_gets_one_event_in_half_a_second(harness: Harness) -> None:
    for _ in range(100):
        harness.setpoint(elevation_deg=90)
        harness.tick(10)
    assert sum(e.kind == Event.SETPOINT_REJECTED for e in harness.events) <= 3


@pytest.mark.parametrize("axes", [4, 5, 8, 255])
def test_travel_cannot_be_closed_without_pitch_nor_unknown_axes(harness: Harness, axes: int) -> None:
    harness.arm()
    assert harness.close_loops(axes).result == Result.BAD_VALUE
    assert harness.state is State.ARMED


EXCITATION = d.ExciteMessage(
    request=0, kind=d.Excitation.STEP, front_V=1, back_V=1, start_Hz=1, stop_Hz=2, duration_s=1, seed=1
)
"""Accepted by a flying board."""


@pytest.mark.parametrize(
    "changes, refused",
    [
        ({"kind": d.Excitation.NONE}, "kind"),
        ({"kind": max(d.Excitation) + 1}, "kind"),
        ({"front_V": 2.5}, "front_V"),
        ({"back_V": -2.5}, "back_V"),
        ({"kind": d.Excitation.CHIRP, "start_Hz": -1}, "start_Hz"),
        ({"kind": d.Excitation.CHIRP, "start_Hz": 3}, "stop_Hz"),
        ({"kind": d.Excitation.MULTISINE, "stop_Hz": 600}, "stop_Hz"),
        ({"kind": d.Excitation.PRBS, "start_Hz": 0, "stop_Hz": 0}, "stop_Hz"),
        ({"duration_s": 121}, "duration_s"),
        ({"duration_s": 0}, "duration_s"),
        ({"kind": d.Excitation.PRBS, "start_Hz": 0, "stop_Hz": 5, "seed": 0}, "seed"),
    ],
)
def test_excitation_outside_its_bounds_is_refused_by_field(
    harness: Harness, changes: dict[str, Any], refused: str
) -> None:
    harness.arm()
    harness.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=1.5, back_V=1.5))
    reply = harness.ask(dataclasses.replace(EXCITATION, **changes))
    place_on_the_wire = [field.name for field in dataclasses.fields(EXCITATION)].index(refused)
    assert (reply.result, reply.detail) == (Result.BAD_VALUE, place_on_the_wire)


def test_excitation_adds_to_the_voltages_and_ends_by_itself(harness: Harness) -> None:
    harness.arm()
    harness.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=3.0, back_V=3.0))
    for _ in range(10):
        harness.tick(300)
        harness.ping()
    assert harness.motors[:2] == (525, 525)  # counts: 3 V of 12 V, times 2100
    harness.ask(
        d.ExciteMessage(
            request=0,
            kind=d.Excitation.STEP,
            front_V=1.0,
            back_V=-1.0,
            start_Hz=0,
            stop_Hz=0,
            duration_s=0.3,
            seed=1,
        )
    )
    harness.tick(20)
    assert harness.motors[:2] == (700, 350)
    harness.tick(300)
    assert harness.motors[:2] == (525, 525)
    assert harness.last_event(Event.EXCITATION_END).detail == d.Excitation.STEP


def test_excitation_ends_when_the_board_must_hold(flying: Harness) -> None:
    assert (
        flying.ask(
            d.ExciteMessage(
                request=0,
                kind=d.Excitation.MULTISINE,
                front_V=0.2,
                back_V=0.2,
                start_Hz=0.1,
                stop_Hz=5,
                duration_s=60,
                seed=1,
            )
        ).result
        == Result.OK
    )
    for _ in range(6):  # a host that reads later loses events: the buffer of the line is full of telemetry
        flying.tick(100)
    assert flying.state is State.HOLD
    assert flying.last_event(Event.EXCITATION_END).detail == d.Excitation.MULTISINE


def test_unsafe_parameters_are_refused_in_flight_and_gains_are_not(flying: Harness) -> None:
    assert flying.set("supply_V", 11).result == Result.UNSAFE_NOW
    assert flying.set("elevation_kp", 0.6).result == Result.OK
    assert flying.set("elevation_kp", 21).result == Result.OUT_OF_RANGE


def test_zero_and_save_are_refused_in_flight(flying: Harness) -> None:
    for message in (
        d.ZeroMessage(request=0, axes=ALL_AXES),
        d.ParamsSaveMessage(0),
        d.ParamsDefaultMessage(0),
    ):
        assert flying.ask(message).result == Result.BAD_STATE


def test_gain_changes_act_in_the_next_tick(flying: Harness) -> None:
    flying.set("hover_V", 2.4)
    flying.keep_flying(3000, elevation_deg=REST_DEG)
    before = flying.motors
    flying.set("hover_V", 3.4)
    flying.keep_flying(3, elevation_deg=REST_DEG)
    assert flying.motors.front_duty - before.front_duty == pytest.approx(0.5 / 12 * DUTY_FULL, abs=3)


def elevation_setpoints(harness: Harness) -> tuple[np.ndarray, np.ndarray]:
    """Ticks and elevation setpoints in degrees, each (n,)."""
    ticks = harness.telemetry()
    return ticks.tick, np.degrees(physical(ticks.raw, d.Channel.ELEVATION_SETPOINT))


def test_a_smooth_path_is_followed_on_its_device_ticks(flying: Harness) -> None:
    start = flying.ask(d.PingMessage(0, 0)).tick

    def path(tick: Any) -> Any:
        return REST_DEG + 3 * (1 - np.cos(2 * np.pi * (tick - start) / 4000))

    for k in range(0, 6000, 20):
        flying.setpoint(elevation_deg=path(start + k + 40), at_tick=start + k + 40)
        flying.tick(20)
    tick, setpoint_deg = elevation_setpoints(flying)
    flown = (tick > start + 500) & (tick < start + 5900)
    # 20 ms pieces of this path lie within 0.0004 degrees of it; following its bends costs a little.
    assert np.abs(setpoint_deg - path(tick))[flown].max() < 0.1


def test_a_step_becomes_a_ramp_within_slew_and_acceleration_that_does_not_overshoot(flying: Harness) -> None:
    flying.keep_flying(4000, elevation_deg=0.0)
    _, setpoint_deg = elevation_setpoints(flying)
    rate_deg_s = np.convolve(np.diff(setpoint_deg) * 1000, np.ones(20) / 20, "valid")  # over 20 ms
    acceleration_deg_s2 = (rate_deg_s[20:] - rate_deg_s[:-20]) / 0.02
    assert rate_deg_s.max() == pytest.approx(15, abs=0.1)
    assert np.abs(acceleration_deg_s2).max() <= 30 * 1.1
    assert setpoint_deg.max() <= 0.001
    assert setpoint_deg[-1] == pytest.approx(0, abs=0.01)
    # 25 degrees at 15 deg/s and 30 deg/s2 take 2.17 s, and the last hundredth of a degree its own time.
    first = np.flatnonzero(setpoint_deg > REST_DEG + 0.01)[0]
    arrived = np.flatnonzero(setpoint_deg > -0.1)[0]
    assert arrived - first == pytest.approx(2170, abs=250)


def land_without_travel(harness: Harness) -> None:
    harness.set("travel_motion_deg", 4.0)
    harness.arm()
    harness.glide(ELEVATION, to_deg=0, deg_s=60)
    harness.close_loops()
    harness.glide(PITCH, to_deg=10.0, deg_s=60)
    harness.keep_flying(1500)


def test_more_late_ticks_since_arming_than_allowed_cut_the_motors(harness: Harness) -> None:
    harness.tick(7, late=True)  # before arming, where they do not count
    harness.fly()
    harness.tick(10, late=True)  # overrun_max
    assert harness.state is State.CLOSED_LOOP
    harness.tick(10, late=True)
    harness.tick(2)
    assert harness.motors_off
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


def test_a_landing_that_is_asked_for_once_more_does_not_erase_why_the_board_lands(harness: Harness) -> None:
    land_without_travel(harness)
    assert harness.ask(d.LandMessage(0)).result == Result.OK
    harness.tick(40)
    assert harness.state is State.EMERGENCY_LANDING
    assert harness.telemetry().raw[-1, Channel.FAULT] == Fault.TRAVEL_MOTIONLESS


def test_an_axis_that_is_held_already_keeps_its_setpoint_when_its_loop_is_asked_for() -> None:
    law = ToldLaw()
    harness = Harness(law=law)
    harness.arm()
    harness.close_loops(WITHOUT_TRAVEL)
    harness.tick(600)
    assert harness.state is State.HOLD
    harness.glide(TRAVEL, to_deg=5.0, deg_s=20.0)
    harness.close_loops(ALL_AXES)
    harness.tick(2)
    assert harness.state is State.CLOSED_LOOP
    assert math.degrees(law.setpoint_rad[TRAVEL]) == pytest.approx(0.0, abs=0.1)


def test_a_setpoint_too_late_for_a_landing_is_no_fault(flying: Harness) -> None:
    flying.glide(ELEVATION, to_deg=0, deg_s=60)
    flying.ask(d.LandMessage(0))
    before = sum(event.kind == Event.SETPOINT_REJECTED for event in flying.events)
    flying.keep_flying(1000)
    assert flying.state is State.LANDING
    assert sum(event.kind == Event.SETPOINT_REJECTED for event in flying.events) == before


def test_a_landing_that_never_reaches_the_table_times_out_counted_from_its_beginning(
    harness: Harness,
) -> None:
    harness.tick(5000)
    harness.ping()
    harness.fly()
    harness.glide(ELEVATION, to_deg=0, deg_s=60)
    assert harness.ask(d.LandMessage(0)).result == Result.OK
    # A swing takes 80 ms: the landing must last 149 of them (11.9 s), and end within 157 (12.6 s).
    for swing in range(157):
        assert harness.state is State.LANDING or swing >= 149
        harness.glide(ELEVATION, to_deg=2.0, deg_s=50.0)
        harness.glide(ELEVATION, to_deg=0.0, deg_s=50.0)
    assert harness.motors_off
    fault = harness.last_event(Event.FAULT)
    assert fault.detail == Fault.LANDING_TIMEOUT
    assert fault.value == pytest.approx(12.0, abs=0.1)


def test_an_arm_must_lie_still_at_a_stretch_to_have_landed(flying: Harness) -> None:
    flying.glide(ELEVATION, to_deg=REST_DEG + 3, deg_s=60)
    flying.ask(d.LandMessage(0))
    for _ in range(4):
        flying.glide(ELEVATION, to_deg=REST_DEG, deg_s=30)
        flying.tick(200)
        flying.glide(ELEVATION, to_deg=REST_DEG + 3, deg_s=30)
        flying.tick(50)
    assert flying.state is State.LANDING


@pytest.mark.parametrize(("above_deg", "landed"), [(1.3, True), (1.7, False)])
def test_an_arm_has_landed_within_a_degree_and_a_half_of_its_rest(
    flying: Harness, above_deg: float, landed: bool
) -> None:
    flying.glide(ELEVATION, to_deg=REST_DEG + 8, deg_s=60)
    flying.ask(d.LandMessage(0))
    flying.glide(ELEVATION, to_deg=REST_DEG + above_deg, deg_s=30)
    flying.tick(2000)
    assert flying.state is (State.IDLE if landed else State.FAULT)
    assert landed or flying.last_event(Event.FAULT).detail == Fault.ELEVATION_REST


def test_a_host_that_has_been_silent_for_half_a_second_cannot_arm() -> None:
    hold_ticks = round(1e3 * {p.name: p.default for p in d.PARAMS}["setpoint_hold_s"])
    assert fault_before_arming(hold_ticks) == (Fault.NONE, 0.0)
    fault, age_s = fault_before_arming(hold_ticks + 1)
    assert fault == Fault.LINK_NOT_ALIVE
    assert age_s == pytest.approx(0.501)


@pytest.mark.parametrize(
    "counts, reported", [((3, 5, 7), (3, 5, 7)), ((65_535, 65_536, 70_000), (65_535,) * 3)]
)
def test_the_status_counts_the_illegal_transitions_of_each_encoder_up_to_its_end(
    harness: Harness, counts: tuple[int, ...], reported: tuple[int, ...]
) -> None:
    for axis, transitions in enumerate(counts):
        harness.break_encoder(axis, transitions)
    harness.tick(300)
    status = harness.ask(d.StatusReadMessage(0))
    assert (status.illegal_elevation, status.illegal_pitch, status.illegal_travel) == reported
