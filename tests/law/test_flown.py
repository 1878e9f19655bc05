"""Laws fly on the board, and a flight's log says bit for bit what they did."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.declaration import Channel, Fault, LawFlyMessage
from heli_host.link.telemetry import Ticks
from heli_lab.law import Command, Law, control_law, if_else, motor_volts, sqrt

from tests.law.flown import fly, law_of, replayed
from tests.running.long import LONG, samples

LAWS = Path(__file__).resolve().parents[2] / "docs" / "laws"
NAMES = ("cascade", "feedback_linearisation", "gain_scheduled", "input_shaping", "lqg", "lqi", "lqr", "mpc",
         "sliding_mode")  # fmt: skip
SECONDS = 60.0 if LONG else 6.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_tick_of_a_shipped_law_is_replayed_bit_for_bit(name: str) -> None:
    tape = law_of(LAWS / f"{name}.py").tape
    flown = fly(tape, seconds=SECONDS)
    assert not flown.report.taken_over
    assert replayed(flown, tape) > 990 * SECONDS


@pytest.mark.emulated
@pytest.mark.parametrize("name", NAMES if LONG else ("input_shaping",))
def test_every_tick_on_the_emulated_due_is_replayed_bit_for_bit(name: str) -> None:
    pytest.importorskip("heli_sim.due._due", reason="the emulated Due is not built: make setup")
    tape = law_of(LAWS / f"{name}.py").tape
    seconds = 60.0 if LONG else 4.0
    assert replayed(fly(tape, "due", seconds=seconds), tape, "due") > 990 * seconds


@pytest.mark.medium
def test_parameters_of_a_law_are_set_by_name() -> None:
    law = law_of(LAWS / "lqi.py")
    with heli_host.connect("sil://") as heli:
        heli.load_law(law.tape)
        heli.set_law_parameter(law.tape, "hover_V", 1.5)
        with pytest.raises(heli_host.HeliError, match="has no parameter hover; it has: hover_V"):
            heli.set_law_parameter(law.tape, "hover", 1.5)


HOVER_V = 1.4
HOSTILE_AFTER_s = 3.0
Volts = tuple[Any, Any]


def follows(now: Any, more_V: Any = 0.0, share: float = 1.0) -> Volts:
    """A law that follows a share of the setpoints of elevation and travel."""
    elevation_rad = share * now.elevation_setpoint_rad - now.elevation_rad
    collective_V = HOVER_V + more_V + 16.0 * elevation_rad - 12.0 * now.elevation_rad_s
    pitch_rad = 0.5 * (share * now.travel_setpoint_rad - now.travel_rad) - 2.5 * now.travel_rad_s
    front_V, back_V = motor_volts(collective_V, 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s)
    return front_V, back_V


def hostile(
    name: str, volts: Callable[[Any, Volts, Any], Volts], grows: Callable[[Any], Any] = lambda now: 0.0
) -> Law:
    """A law that follows well for three seconds, then does what ``volts(now, well, grown)`` says.

    ``grown`` is then the integral of ``grows(now)``.
    """

    @control_law(states={"t_s": 0.0, "grown": 0.0}, name=name)
    def law(now: Any, state: Any, parameter: Any) -> Command:
        good = follows(now)
        bad = volts(now, good, state.grown)
        late = state.t_s > HOSTILE_AFTER_s
        mixed = [if_else(late, one, other) for one, other in zip(bad, good, strict=True)]
        grown = if_else(late, state.grown + 1e-3 * grows(now), 0.0)
        return Command(mixed[0], mixed[1], states={"t_s": state.t_s + 1e-3, "grown": grown})

    return law


UNREACHABLE_rad = 0.7
HOSTILE: dict[str, tuple[Law, tuple[str, ...]]] = {
    "not_a_number": (
        hostile("not_a_number", lambda now, well, _: (sqrt(-1.0 - now.pitch_rad * now.pitch_rad), well[1])),
        ("not_finite",),
    ),
    "bang_bang": (
        hostile(
            "bang_bang",
            lambda now, well, _: (if_else(now.elevation_rad < now.elevation_setpoint_rad, 12.0, 0.0),) * 2,
        ),
        ("voltage_jump",),
    ),
    # Within what a voltage may jump by, so that only the arm's motion tells.
    "small_bang_bang": (
        hostile(
            "small_bang_bang",
            lambda now, well, _: (if_else(now.elevation_rad < now.elevation_setpoint_rad, 2.9, 1.0),) * 2,
        ),
        (),
    ),
    "sign_error": (
        hostile("sign_error", lambda now, well, _: (2.0 + HOVER_V - well[1], 2.0 + HOVER_V - well[0])),
        ("elevation_envelope", "elevation_following"),
    ),
    "sign_error_of_pitch": (
        hostile("sign_error_of_pitch", lambda now, well, _: (well[1], well[0])),
        ("pitch_envelope", "travel_envelope", "travel_following", "elevation_envelope"),
    ),
    "full_voltage": (hostile("full_voltage", lambda now, well, _: (12.0, 12.0)), ("voltage_jump",)),
    # Climbs to full voltage in a quarter of a second: no jump from call to call.
    "full_voltage_by_a_ramp": (
        hostile("full_voltage_by_a_ramp", lambda now, well, v: (well[0] + v, well[1] + v), lambda now: 40.0),
        ("elevation_envelope", "elevation_following"),
    ),
    "motors_off": (
        hostile("motors_off", lambda now, well, v: (well[0] - v, well[1] - v), lambda now: 40.0),
        ("elevation_envelope", "elevation_following"),
    ),
    # An integral that nothing limits, of an error that nothing can answer.
    "wind_up": (
        hostile(
            "wind_up",
            lambda now, well, v: follows(now, v),
            lambda now: 15.0 * (UNREACHABLE_rad - now.elevation_rad),
        ),
        ("elevation_envelope", "elevation_following"),
    ),
    "drift_up": (
        hostile("drift_up", lambda now, well, v: (well[0] + v, well[1] + v), lambda now: 0.1),
        ("elevation_envelope", "elevation_following"),
    ),
    "drift_down": (
        hostile("drift_down", lambda now, well, v: (well[0] - v, well[1] - v), lambda now: 0.1),
        ("elevation_envelope", "elevation_following"),
    ),
    "drift_aside": (
        hostile("drift_aside", lambda now, well, v: (well[0] + v, well[1] - v), lambda now: 0.05),
        ("pitch_envelope", "travel_envelope", "travel_following"),
    ),
}  # fmt: skip
RIGS = ("", "&effect=rotor_lag=0.12", "&effect=thrust_step.front=-0.1@0.001;thrust_step.back=-0.1@0.001")
# Chatter within what a voltage may jump by, about what carries the arm: rotors and arm hardly move. Nobody
# need take over while it stays near its setpoint, as each flight is asked.
HARMLESS = ("small_bang_bang",)
NEAR_deg = 3.0
# A pitch of -24 degrees that runs away at 80 deg/s is turned round by 2.4 V of difference and rotors that lag
# by 0.12 s in 0.7 s. Until then up to 40 degrees of tilt throw travel 38 degrees away from its setpoint;
# beyond 30 for a second the supervisor gives travel up, and lands on elevation and pitch.
# Lift of the wrong sign throws the arm from its setpoint, in one seed of 30 farther than 15 degrees for a
# second: the supervisor cuts the motors.
NOT_HELD = {
    ("sign_error_of_pitch", RIGS[1]): Fault.TRAVEL_FOLLOWING,
    ("sign_error", RIGS[1]): Fault.ELEVATION_FOLLOWING,
}
# The table is at -25 degrees, the upper stop at +25 (makki2024.toml); where they are is known to a degree.
STOP_deg = 24.0
PITCH_STOP_deg = 50.0
# The slowest of the cascade's loops, travel's integral, takes as long to let go: 20 s after a takeover that
# left travel 25 degrees away, 6 are left of them, after 40 s none.
CALM_s = 40.0
LONGEST_s = 40.0


def tries(name: str, rig: str, seed: int) -> heli_host.guest_law.LawReport:
    """Fly a hostile law towards setpoints that the seed draws; how it was taken over."""
    law, _ = HOSTILE[name]
    chance = np.random.default_rng(seed)
    with heli_host.connect(f"sil://?seed={seed}{rig}") as heli:
        heli.take_off()
        start = heli.latest.tick
        heli.setpoint(elevation_deg=chance.uniform(-6.0, 6.0), travel_deg=chance.uniform(-10.0, 10.0))
        report = heli.fly_law(law.tape, duration_s=LONGEST_s)
        heli.wait(CALM_s)
        since = heli.samples(last_s=LONGEST_s + 2 * CALM_s)
        rows = since.tick > start
        elevation_deg = np.degrees(since.elevation_rad[rows])
        which = f"{rig} {seed}: {report}"
        assert np.degrees(np.abs(since.pitch_rad[rows])).max() < PITCH_STOP_deg, which
        assert elevation_deg.max() < STOP_deg, which
        if (name, rig) in NOT_HELD and heli.state is not heli_host.State.CLOSED_LOOP:
            assert heli.latest.fault is NOT_HELD[name, rig], which
            flying = since.state[rows] == heli_host.State.CLOSED_LOOP
            assert elevation_deg[flying].min() > -STOP_deg, which
            return report
        assert heli.state is heli_host.State.CLOSED_LOOP, which
        assert elevation_deg.min() > -STOP_deg, which
        if not report.taken_over:
            late = elevation_deg[since.t_s[rows] > since.t_s[rows][0] + 10.0]
            wanted_deg = np.degrees(heli.latest.elevation_setpoint_rad)
            assert np.abs(late - wanted_deg).max() < NEAR_deg, which
        sample = heli.latest
        assert abs(sample.elevation_deg - np.degrees(sample.elevation_setpoint_rad)) < 1.0, f"{rig} {seed}"
        assert abs(sample.travel_deg - np.degrees(sample.travel_setpoint_rad)) < 2.0, f"{rig} {seed}"
        stays_off(heli, f"{rig} {seed}")
    return report


def stays_off(heli: heli_host.Heli, which: str) -> None:
    """Stop, ask for the law again, and see that the motors stay off."""
    ticks: list[Ticks] = []
    heli.stop()
    heli.wait(0.1)
    heli.session.subscribe_ticks(ticks.append)
    with pytest.raises(heli_host.HeliError):
        heli.session.command(LawFlyMessage(0, 1))
    heli.wait(0.5)
    motors = np.concatenate([one.raw for one in ticks])[:, [Channel.FRONT, Channel.BACK]]
    assert len(motors) > 400
    assert not motors.any(), which


@pytest.mark.slow
@pytest.mark.parametrize("rig", RIGS if LONG else RIGS[1:2])
@pytest.mark.parametrize("name", HOSTILE)
def test_the_board_takes_over_from_a_hostile_law_before_the_arm_hits_a_stop(name: str, rig: str) -> None:
    _, reasons = HOSTILE[name]
    for seed in range(1, samples(31, 2)):
        report = tries(name, rig, seed)
        assert report.taken_over or name in HARMLESS, f"{rig} {seed}: nobody took over"
        assert not reasons or report.taken_over in reasons, f"{rig} {seed}: {report}"


@pytest.mark.medium
@pytest.mark.parametrize(
    ("name", "volts", "reason"),
    [
        # More lift on both sides, until elevation could not be braked any more before its limit.
        ("climbs", lambda now, good, _: (good[0] + 4.0, good[1] + 4.0), "elevation_envelope"),
        # One rotor pulls, the other does not: the arm rolls over.
        ("rolls", lambda now, good, _: (2.6, 0.6), "pitch_envelope"),
    ],
)
def test_the_reason_for_a_takeover_is_the_one_that_was_provoked(
    name: str, volts: Callable[[Any, Volts, Any], Volts], reason: str
) -> None:
    law = hostile(name, volts)
    with heli_host.connect("sil://") as heli:
        heli.params["law_jump_max_V"] = 12.0
        heli.take_off()
        report = heli.fly_law(law.tape, duration_s=10.0)
        assert report.taken_over == reason, str(report)
        heli.wait(CALM_s)
        assert heli.state is heli_host.State.CLOSED_LOOP
        assert abs(heli.latest.elevation_deg) < 1.0


@pytest.mark.medium
@pytest.mark.parametrize(("axis", "wanted_deg"), [("elevation", 15.0), ("travel", 35.0)])
def test_an_axis_that_stays_away_from_its_setpoint_is_taken_over(axis: str, wanted_deg: float) -> None:
    law = hostile("stays", lambda now, good, _: follows(now, share=0.0))
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        heli.setpoint(**{f"{axis}_deg": wanted_deg})
        report = heli.fly_law(law.tape, duration_s=15.0)
        assert report.taken_over == f"{axis}_following", str(report)
        # Of the board's own limit, the share that law_envelope says.
        assert abs(report.value) > 0.8 * heli.params[f"{axis}_following_max_deg"]


@pytest.mark.medium
def test_the_board_takes_over_without_a_bump() -> None:
    flown = fly(hostile("well", lambda now, well, _: well).tape, seconds=2.5)
    last = int(np.flatnonzero(flown.flying)[-1])
    motors = flown.raw[last - 5 : last + 6][:, [Channel.FRONT, Channel.BACK]].astype(int)
    assert np.abs(np.diff(motors, axis=0)).max() < 60, "more than 60 mV from one tick to the next"
