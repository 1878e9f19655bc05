"""An axis that does not follow, or does not count when it is driven, is a fault by its own name."""

import math
from itertools import pairwise
from typing import Any, NamedTuple

import heli_host.declaration as d
import pytest
from heli_host.declaration import CHANNELS, Channel, Event, Fault, Probe, Result, State, Trigger
from heli_host.link.telemetry import TelemetryDecoder

from tests.flight.harness import (
    ALL_AXES,
    DUTY_FULL,
    ELEVATION,
    NO_AXES,
    PITCH,
    TRAVEL,
    WITHOUT_TRAVEL,
    Harness,
)

COUNT_DEG = 360.0 / 4096.0
SUPPLY_V, DEAD_ZONE_V = 12.0, 1.0


def board_in_level_flight(*, axes: int = ALL_AXES, **parameters: float) -> Harness:
    """A board that flies level, its arm moving a little all the time on every axis."""
    harness = Harness(tracked=True)
    for name, value in parameters.items():
        harness.set(name, value)
    assert harness.arm().result == Result.OK
    harness.glide(ELEVATION, to_deg=0.0, deg_s=100.0)
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


class Trip(NamedTuple):
    """The last fault, and what it made the board do."""

    fault: Fault
    cause: Trigger


def tripped(harness: Harness) -> Trip:
    event = harness.last_event(Event.FAULT)
    return Trip(Fault(event.detail), Trigger(event.cause))


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
    harness.glide(ELEVATION, to_deg=-23.5, deg_s=5.0)
    harness.tick(300)
    harness.ping()
    assert harness.arm().result == Result.OK
    assert harness.ask(d.StreamMessage(0)).result == Result.OK
    for volts_V in (*[0.3] * 50, *[1.7] * 100):
        harness.send(d.VoltagesMessage(front_V=volts_V, back_V=volts_V, valid_ms=40))
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
    harness = board_in_level_flight(axes=WITHOUT_TRAVEL)
    hover(harness, 1000)
    hover(harness, 1500, still=still, pitch_deg=12.0)
    assert harness.state is (State.EMERGENCY_LANDING if still else State.CLOSED_LOOP)
    if still:
        assert tripped(harness) == (Fault.PITCH_MOTIONLESS, Trigger.AXIS_LOST)
        front, back, _ = harness.motors
        harness.move(pitch_deg=harness.angles_deg[PITCH] + 5 * COUNT_DEG)
        harness.tick()
        assert harness.motors.front_duty - harness.motors.back_duty == pytest.approx(front - back, abs=1)


@pytest.mark.parametrize("step_counts", [1, 2])
def test_a_single_count_to_and_fro_is_no_motion(step_counts: int) -> None:
    harness = board_in_level_flight(axes=WITHOUT_TRAVEL)
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
    harness.glide(PITCH, to_deg=12.0, deg_s=60.0)
    hover(harness, 900, still=(TRAVEL,))
    assert harness.state is State.CLOSED_LOOP
    hover(harness, 400, still=(TRAVEL,))
    assert harness.state is State.EMERGENCY_LANDING
    assert tripped(harness) == (Fault.TRAVEL_MOTIONLESS, Trigger.AXIS_LOST)
    assert harness.motors.are_enabled
    assert harness.close_loops().result == Result.BAD_STATE
    harness.glide(PITCH, to_deg=0.0, deg_s=100.0)
    harness.glide(ELEVATION, to_deg=-25.0, deg_s=20.0)
    harness.tick(1000)
    assert harness.state is State.FAULT and harness.motors_off
    assert harness.arm().result == Result.BAD_STATE
    assert harness.ask(d.ClearFaultMessage(0)).result == Result.OK


def balanced() -> Harness:
    """A board that flies level, in a test that holds elevation and pitch itself: only travel is watched."""
    # Pitch, which the test holds, cannot tilt to ask travel.
    return board_in_level_flight(travel_silence_s=0.0, elevation_motion_V=48.0, pitch_motion_V=48.0)


def turn(harness: Harness, ticks: int, *, pitch_deg: float, rate_deg_s: float = 0.0) -> None:
    """Tilt the arm, and let travel turn at a rate."""
    harness.glide(PITCH, to_deg=pitch_deg, deg_s=100.0)
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
    harness = board_in_level_flight(axes=WITHOUT_TRAVEL if axis == PITCH else 7, pitch_motion_V=48.0)
    # Else pitch, which the test holds, would not be where travel asks for it.
    for gain in ("travel_kp", "travel_ki", "travel_kd"):
        harness.set(gain, 0.0)
    hover(harness, 1000)
    harness.glide(axis, to_deg=away_deg, deg_s=100.0)
    hover(harness, 900)
    assert harness.state is State.CLOSED_LOOP
    hover(harness, 600)
    assert harness.state is ends
    assert tripped(harness).fault is fault


def test_nothing_of_this_applies_to_a_bench_in_open_loop_nor_to_an_axis_that_is_open() -> None:
    bench = Harness(tracked=True)
    bench.arm()
    bench.ask(d.ControlMessage(request=0, axes=NO_AXES, front_V=6.0, back_V=4.0))
    for _ in range(30):
        bench.ping()
        bench.tick(100)
    assert bench.state is State.OPEN_LOOP
    tilted = board_in_level_flight(axes=WITHOUT_TRAVEL, pitch_motion_V=48.0)
    tilted.glide(PITCH, to_deg=10.0, deg_s=60.0)
    hover(tilted, 3000, still=(TRAVEL,), pitch_deg=10.0)
    assert tilted.state is State.CLOSED_LOOP


def test_a_law_on_the_host_is_watched_for_motion_too() -> None:
    harness = Harness(tracked=True)
    harness.arm()
    harness.ask(d.StreamMessage(0))
    for _ in range(80):
        harness.send(d.VoltagesMessage(front_V=6.0, back_V=6.0, valid_ms=50))
        harness.tick(20)
    assert tripped(harness).fault is Fault.ELEVATION_MOTIONLESS


GAIN_1_s2 = 0.5
"""Acceleration of travel per radian of pitch: the board's default."""
FRICTION_20_mNm_DEG = 2.8
"""Tilt that 20 mN m of dry friction hold on the paper's rig."""
STEP_ms = 4
PITCH_LAG_s = 0.2


class Answer(NamedTuple):
    """A step of the check of a silent travel encoder: the board tilts the arm and looks whether it turns."""

    tick: int
    probe: Probe


class Arm:
    """An arm that flies level: pitch lags its setpoint, and turns travel against dry friction."""

    def __init__(
        self,
        *,
        dead: bool = False,
        friction_deg: float = FRICTION_20_mNm_DEG,
        calm: bool = False,
        **parameters: float,
    ) -> None:
        parameters = {"elevation_motion_V": 48.0, "pitch_motion_V": 48.0} | parameters
        self.harness = board_in_level_flight(**parameters)  # type: ignore[arg-type]
        self.dead = dead
        self.friction_deg = friction_deg
        # Enough motion of pitch that its own encoder does not count as silent.
        self.stir_deg = 0.0 if calm else 0.8
        self.decoder = TelemetryDecoder()
        self.pitch_setpoint_deg = self.elevation_setpoint_deg = 0.0
        self.pitch_deg = self.travel_deg = self.travel_rate_deg_s = 0.0
        self.pitches_deg: list[float] = []
        self.pitch_follows = True
        self.encoder_travel_deg = 0.0

    def hover(self, seconds: float, *, swing_deg: float = 0.0) -> None:
        """Send setpoints of level flight; with a swing, something moves travel to and fro all the time."""
        harness = self.harness
        for k in range(round(1000 * seconds / STEP_ms)):
            if k % 5 == 0:
                harness.setpoint(travel_deg=0.0)
            self._turn(0.001 * STEP_ms)
            if not self.dead:
                self.encoder_travel_deg = self.travel_deg + swing_deg * (k // 50 % 2)
            stir_deg = self.stir_deg * (k // 75 % 2)
            harness.move(pitch_deg=self.pitch_deg + stir_deg, travel_deg=self.encoder_travel_deg)
            before = len(harness.frames)
            harness.tick(STEP_ms)
            batches = [f.payload for f in harness.frames[before:] if f.id == d.MessageId.TELEMETRY]
            if batches:
                raw = self.decoder.decode(batches).raw[-1]
                self.pitch_setpoint_deg, self.elevation_setpoint_deg = (
                    math.degrees(raw[channel] * CHANNELS[channel].scale)
                    for channel in (Channel.PITCH_SETPOINT, Channel.ELEVATION_SETPOINT)
                )
            self.pitches_deg.append(self.pitch_deg)

    def _turn(self, step_s: float) -> None:
        """Let pitch follow its setpoint and travel turn, against dry friction in tilts that it holds."""
        if not self.pitch_follows:
            return
        self.pitch_deg += (self.pitch_setpoint_deg - self.pitch_deg) * step_s / PITCH_LAG_s
        is_turning = self.travel_rate_deg_s != 0.0
        is_positive = (self.travel_rate_deg_s if is_turning else self.pitch_deg) > 0.0
        if not is_turning and abs(self.pitch_deg) <= self.friction_deg:
            return
        drive_deg = self.pitch_deg - (self.friction_deg if is_positive else -self.friction_deg)
        rate_deg_s = self.travel_rate_deg_s + GAIN_1_s2 * step_s * drive_deg
        # Friction stops the turn, and does not reverse it.
        self.travel_rate_deg_s = 0.0 if (rate_deg_s > 0.0) != is_positive else rate_deg_s
        self.travel_deg += self.travel_rate_deg_s * step_s

    @property
    def answers(self) -> list[Answer]:
        """Events of the check of travel, oldest first."""
        return [Answer(e.tick, Probe(e.detail)) for e in self.harness.events if e.kind == Event.TRAVEL_PROBE]


def asked_s(arm: Arm) -> list[float]:
    """Times at which the board began to ask."""
    return [1e-3 * answer.tick for answer in arm.answers if answer.probe is Probe.ASKED]


@pytest.mark.parametrize("friction_deg", [0.0, FRICTION_20_mNm_DEG, 4.0], ids=str)
def test_a_dead_travel_encoder_is_named_by_tilts_to_both_sides(friction_deg: float) -> None:
    arm = Arm(dead=True, friction_deg=friction_deg)
    arm.hover(6.0)
    assert arm.answers[-1].probe is Probe.SILENT
    assert arm.harness.state is State.EMERGENCY_LANDING
    assert tripped(arm.harness) == (Fault.TRAVEL_MOTIONLESS, Trigger.AXIS_LOST)
    assert max(arm.pitches_deg) > 8.0 and min(arm.pitches_deg) < -8.0
    # Without friction it drifts, but the tilts leave it little speed.
    assert abs(arm.travel_deg) < 15.0
    arm.hover(1.0)
    assert abs(arm.travel_rate_deg_s) < 2.0


@pytest.mark.medium
@pytest.mark.parametrize("friction_deg", [0.0, FRICTION_20_mNm_DEG, 7.0], ids=str)
def test_an_arm_that_dry_friction_holds_counts_under_the_tilt_and_flies_on(friction_deg: float) -> None:
    arm = Arm(friction_deg=friction_deg)
    arm.hover(30.0)
    assert {answer.probe for answer in arm.answers} == {Probe.ASKED, Probe.COUNTS}
    assert arm.harness.state is State.CLOSED_LOOP
    assert max(abs(tilt) for tilt in arm.pitches_deg) < 13.0


@pytest.mark.medium
def test_an_arm_that_has_answered_is_asked_after_a_longer_silence() -> None:
    arm = Arm()
    arm.hover(50.0)
    waits_s = [after - before for before, after in pairwise(asked_s(arm))]
    assert asked_s(arm)[0] < 4.0
    # A doubt may ask sooner later on.
    assert waits_s[0] > 5.0


@pytest.mark.parametrize(
    ("arm", "seconds", "swing_deg"),
    [
        pytest.param({}, 10.0, 0.3, id="travel counts by itself"),
        pytest.param({"calm": True}, 30.0, 0.0, id="pitch is still"),
        pytest.param({"dead": True, "travel_silence_s": 0.0}, 12.0, 0.0, id="a silence of 0 s"),
    ],
)
def test_an_arm_is_not_asked(arm: dict[str, Any], seconds: float, swing_deg: float) -> None:
    hovering = Arm(**arm)
    hovering.hover(seconds, swing_deg=swing_deg)
    assert hovering.answers == []


def test_an_encoder_that_dies_after_it_has_answered_is_named_too() -> None:
    arm = Arm()
    arm.hover(6.0)
    assert arm.answers[-1].probe is Probe.COUNTS
    arm.dead = True
    arm.hover(12.0)
    assert arm.answers[-1].probe is Probe.SILENT


def test_a_pitch_that_does_not_follow_gives_no_answer_and_no_fault() -> None:
    arm = Arm(dead=True)
    arm.harness.set("pitch_following_max_deg", 180.0)
    arm.pitch_follows = False
    arm.hover(6.0)
    assert [answer.probe for answer in arm.answers][:2] == [Probe.ASKED, Probe.STOPPED]
    assert arm.harness.state is State.CLOSED_LOOP


def test_a_landing_without_an_answer_levels_pitch_and_does_not_close_travel() -> None:
    arm = Arm(dead=True)
    arm.hover(3.5)
    assert arm.answers[-1].probe is Probe.ASKED
    arm.harness.ask(d.LandMessage(0))
    arm.hover(1.5)
    assert arm.answers[-1].probe is Probe.STOPPED
    arm.harness.glide(TRAVEL, to_deg=10.0, deg_s=100.0)
    arm.encoder_travel_deg = 10.0
    arm.hover(1.0)
    assert arm.harness.state is State.LANDING
    assert abs(arm.pitch_setpoint_deg) < 0.2


def test_a_landing_that_does_not_come_down_levels_pitch_after_half_its_time() -> None:
    arm = Arm(friction_deg=90.0, travel_silence_s=0.0, travel_motion_deg=90.0)
    arm.harness.glide(TRAVEL, to_deg=3.0, deg_s=100.0)
    arm.travel_deg = 3.0
    arm.hover(4.0)
    arm.harness.ask(d.LandMessage(0))
    arm.hover(5.0)
    assert abs(arm.pitch_setpoint_deg) > 1.0
    arm.hover(2.5)
    assert abs(arm.pitch_setpoint_deg) < 0.2


@pytest.mark.parametrize("tilt_deg, sinks_deg", [(9.0, 8.0), (11.0, 0.0)])
def test_a_landing_waits_while_the_arm_brakes_its_turn(tilt_deg: float, sinks_deg: float) -> None:
    arm = Arm(travel_silence_s=0.0, travel_motion_deg=90.0)
    arm.hover(1.0)
    arm.pitch_follows = False
    arm.harness.glide(PITCH, to_deg=tilt_deg, deg_s=100.0)
    arm.pitch_deg = tilt_deg
    arm.harness.ask(d.LandMessage(0))
    arm.hover(1.5)
    # 8 degrees per second, after a ramp.
    assert -arm.elevation_setpoint_deg == pytest.approx(sinks_deg, abs=3.0)


def test_a_landing_begins_no_question() -> None:
    arm = Arm(dead=True)
    arm.hover(1.0)
    arm.harness.ask(d.LandMessage(0))
    arm.hover(6.0)
    assert arm.answers == []
