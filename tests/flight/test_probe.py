"""A travel encoder that is silent in the air is asked by a tilt: a live one counts, a dead one is named."""

from __future__ import annotations

import math
from itertools import pairwise

import heli_host.declaration as d
import pytest
from heli_host.declaration import CHANNELS, Channel, Event, Fault, Probe, State, Trigger
from heli_host.link.telemetry import TelemetryDecoder

from tests.flight.harness import Harness

ELEVATION = 0
GAIN_1_s2 = 0.5
"""Acceleration of travel per radian of pitch: the board's default."""
FRICTION_20_mNm_DEG = 2.8
"""Tilt that 20 mN m of dry friction hold on the paper's rig."""
STEP_ms = 4
PITCH_s = 0.2


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
        self.harness = Harness(tracked=True)
        for name, value in ({"elevation_motion_V": 48.0, "pitch_motion_V": 48.0} | parameters).items():
            self.harness.set(name, value)
        self.harness.arm()
        self.harness.glide(ELEVATION, 0.0, 100.0)
        self.harness.close_loops()
        self.dead = dead
        self.friction_deg = friction_deg
        self.stir_deg = 0.0 if calm else 0.8
        self.decoder = TelemetryDecoder()
        self.pitch_setpoint_deg = 0.0
        self.pitch_deg = self.travel_deg = self.rate_deg_s = 0.0
        self.tilts_deg: list[float] = []
        self.follows = True
        self.shown_deg = 0.0
        self.elevation_setpoint_deg = 0.0

    def hover(self, seconds: float, *, swing_deg: float = 0.0) -> None:
        """Hold it there; with a swing, something moves travel to and fro all the time."""
        harness = self.harness
        for k in range(round(1000 * seconds / STEP_ms)):
            if k % 5 == 0:
                harness.setpoint(travel_deg=0.0)
            self._turn(0.001 * STEP_ms)
            if not self.dead:
                self.shown_deg = self.travel_deg + swing_deg * (k // 50 % 2)
            stir_deg = self.stir_deg * (k // 75 % 2)
            harness.move(pitch_deg=self.pitch_deg + stir_deg, travel_deg=self.shown_deg)
            before = len(harness.frames)
            harness.tick(STEP_ms)
            batches = [f.payload for f in harness.frames[before:] if f.id == d.MessageId.TELEMETRY]
            if batches:
                raw = self.decoder.decode(batches).raw[-1]
                self.pitch_setpoint_deg, self.elevation_setpoint_deg = (
                    math.degrees(raw[channel] * CHANNELS[channel].scale)
                    for channel in (Channel.PITCH_SETPOINT, Channel.ELEVATION_SETPOINT)
                )
            self.tilts_deg.append(self.pitch_deg)

    def _turn(self, step_s: float) -> None:
        if not self.follows:
            return
        self.pitch_deg += (self.pitch_setpoint_deg - self.pitch_deg) * step_s / PITCH_s
        turns = self.rate_deg_s != 0.0
        forth = (self.rate_deg_s if turns else self.pitch_deg) > 0.0
        if not turns and abs(self.pitch_deg) <= self.friction_deg:
            return
        drive_deg = self.pitch_deg - (self.friction_deg if forth else -self.friction_deg)
        rate_deg_s = self.rate_deg_s + GAIN_1_s2 * step_s * drive_deg
        self.rate_deg_s = 0.0 if (rate_deg_s > 0.0) != forth else rate_deg_s
        self.travel_deg += self.rate_deg_s * step_s

    @property
    def answers(self) -> list[tuple[int, Probe]]:
        return [(e.tick, Probe(e.detail)) for e in self.harness.events if e.kind == Event.TRAVEL_PROBE]


def asked_s(arm: Arm) -> list[float]:
    return [1e-3 * tick for tick, answer in arm.answers if answer is Probe.ASKED]


@pytest.mark.parametrize("friction_deg", [0.0, FRICTION_20_mNm_DEG, 4.0], ids=str)
def test_a_dead_travel_encoder_is_named_by_tilts_to_both_sides(friction_deg: float) -> None:
    arm = Arm(dead=True, friction_deg=friction_deg)
    arm.hover(6.0)
    assert arm.answers[-1][1] is Probe.SILENT
    assert arm.harness.state is State.EMERGENCY_LANDING
    event = arm.harness.last_event(Event.FAULT)
    assert (Fault(event.detail), Trigger(event.cause)) == (Fault.TRAVEL_MOTIONLESS, Trigger.AXIS_LOST)
    assert max(arm.tilts_deg) > 8.0 and min(arm.tilts_deg) < -8.0
    # Without friction it drifts, but the tilts leave it little speed.
    assert abs(arm.travel_deg) < 15.0
    arm.hover(1.0)
    assert abs(arm.rate_deg_s) < 2.0


@pytest.mark.medium
@pytest.mark.parametrize("friction_deg", [0.0, FRICTION_20_mNm_DEG, 7.0], ids=str)
def test_an_arm_that_dry_friction_holds_counts_under_the_tilt_and_flies_on(friction_deg: float) -> None:
    arm = Arm(friction_deg=friction_deg)
    arm.hover(30.0)
    assert {answer for _, answer in arm.answers} == {Probe.ASKED, Probe.COUNTS}
    assert arm.harness.state is State.CLOSED_LOOP
    assert max(abs(tilt) for tilt in arm.tilts_deg) < 13.0


@pytest.mark.medium
def test_an_arm_that_has_answered_is_asked_after_a_longer_silence() -> None:
    arm = Arm()
    arm.hover(50.0)
    waits_s = [after - before for before, after in pairwise(asked_s(arm))]
    assert asked_s(arm)[0] < 4.0
    # A doubt may ask sooner later on.
    assert waits_s[0] > 5.0


def test_travel_that_counts_by_itself_is_not_asked() -> None:
    arm = Arm()
    arm.hover(10.0, swing_deg=0.3)
    assert arm.answers == []


def test_an_arm_whose_pitch_is_still_is_not_asked() -> None:
    arm = Arm(calm=True)
    arm.hover(30.0)
    assert arm.answers == []


def test_an_encoder_that_dies_after_it_has_answered_is_named_too() -> None:
    arm = Arm()
    arm.hover(6.0)
    assert arm.answers[-1][1] is Probe.COUNTS
    arm.dead = True
    arm.hover(12.0)
    assert arm.answers[-1][1] is Probe.SILENT


def test_a_silence_of_0_s_never_asks() -> None:
    arm = Arm(dead=True, travel_silence_s=0.0)
    arm.hover(12.0)
    assert arm.answers == []


def test_a_pitch_that_does_not_follow_gives_no_answer_and_no_fault() -> None:
    arm = Arm(dead=True)
    arm.harness.set("pitch_following_max_deg", 180.0)
    arm.follows = False
    arm.hover(6.0)
    assert [answer for _, answer in arm.answers][:2] == [Probe.ASKED, Probe.STOPPED]
    assert arm.harness.state is State.CLOSED_LOOP


def test_a_landing_without_an_answer_levels_pitch_and_does_not_close_travel() -> None:
    arm = Arm(dead=True)
    arm.hover(3.5)
    assert arm.answers[-1][1] is Probe.ASKED
    arm.harness.ask(d.LandMessage(0))
    arm.hover(1.5)
    assert arm.answers[-1][1] is Probe.STOPPED
    arm.harness.glide(2, 10.0, 100.0)
    arm.shown_deg = 10.0
    arm.hover(1.0)
    assert arm.harness.state is State.LANDING
    assert abs(arm.pitch_setpoint_deg) < 0.2


def test_a_landing_that_does_not_come_down_levels_pitch_after_half_its_time() -> None:
    arm = Arm(friction_deg=90.0, travel_silence_s=0.0, travel_motion_deg=90.0)
    arm.harness.glide(2, 3.0, 100.0)
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
    arm.follows = False
    arm.harness.glide(1, tilt_deg, 100.0)
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
