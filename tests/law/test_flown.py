"""Laws fly on the board, and a flight's log says bit for bit what they did."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.declaration import Channel, Event
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


def hostile(name: str, volts: Callable[[Any, Any], Any]) -> Law:
    """A law that holds level well for three seconds, then does what ``volts(now, level)`` says."""

    @control_law(states={"t_s": 0.0}, name=name)
    def law(now: Any, state: Any, parameter: Any) -> Command:
        collective_V = HOVER_V - 16.0 * now.elevation_rad - 12.0 * now.elevation_rad_s
        pitch_rad = -0.5 * now.travel_rad - 2.5 * now.travel_rad_s
        good = motor_volts(collective_V, 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s)
        bad = volts(now, good)
        late = state.t_s > 3.0
        mixed = [if_else(late, one, other) for one, other in zip(bad, good, strict=True)]
        return Command(mixed[0], mixed[1], states={"t_s": state.t_s + 1e-3})

    return law


HOSTILE = {
    "not_a_number": (
        lambda now, good: (sqrt(-1.0 - now.elevation_rad * now.elevation_rad), good[1]),
        "not_finite",
    ),
    "bang_bang": (lambda now, good: (if_else(now.elevation_rad < 0.0, 10.0, 0.0),) * 2, "voltage_jump"),
    "sign_error": (lambda now, good: (2.8 - good[1], 2.8 - good[0]), ""),
    "constant": (lambda now, good: (4.0, 4.0), ""),
    # An integral that was never limited lets go at once.
    "wind_up": (lambda now, good: (good[0] + 0.6, good[1] + 0.6), ""),
    "drift": (lambda now, good: (good[0] + 0.12, good[1] + 0.12), ""),
}


# What a law may do without anybody taking over: the arm stays where it may be.
HARMLESS = ("drift", "wind_up")
RIGS = ("", "&effect=rotor_lag=0.12", "&effect=thrust_step.front=-0.1@0.001;thrust_step.back=-0.1@0.001")


@pytest.mark.slow
@pytest.mark.parametrize("rig", RIGS if LONG else RIGS[1:2])
@pytest.mark.parametrize("name", HOSTILE)
def test_the_board_takes_over_from_a_hostile_law_and_the_arm_hits_no_stop(name: str, rig: str) -> None:
    volts, reason = HOSTILE[name]
    law = hostile(name, volts)
    for seed in range(1, samples(31, 2)):
        with heli_host.connect(f"sil://?seed={seed}{rig}") as heli:
            heli.take_off()
            heli.setpoint(elevation_deg=0.0, travel_deg=0.0)
            start = heli.latest.tick
            report = heli.fly_law(law.tape, duration_s=10.0)
            heli.wait(3.0)
            after = heli.samples(last_s=30.0)
            flown_deg = np.degrees(after.elevation_rad[after.tick > start])
            assert heli.state is heli_host.State.CLOSED_LOOP, f"{name} {rig} {seed}: {report}"
            assert name in HARMLESS or report.taken_over, "nobody took over"
            assert not reason or report.taken_over == reason, f"{rig} {seed}: {report}"
            assert flown_deg.max() < 24.0
            assert flown_deg.min() > -24.0
            assert abs(heli.latest.elevation_deg) < 5.0
            heli.stop()
            heli.wait(0.1)
            assert heli.latest.front_V == 0.0
            kinds = [event.message.kind for event in heli.session.events if event.message]
            assert Event.LAW_TAKEN_OVER in kinds


@pytest.mark.medium
@pytest.mark.parametrize(
    ("name", "volts", "reason"),
    [
        # More lift on both sides, until elevation could not be braked any more before its limit.
        ("climbs", lambda now, good: (good[0] + 2.0, good[1] + 2.0), "elevation_envelope"),
        # One rotor pulls, the other does not: the arm rolls over.
        ("rolls", lambda now, good: (2.6, 0.6), "pitch_envelope"),
    ],
)
def test_the_reason_for_a_takeover_is_the_one_that_was_provoked(
    name: str, volts: Callable[[Any, Any], Any], reason: str
) -> None:
    law = hostile(name, volts)
    with heli_host.connect("sil://") as heli:
        heli.params["law_jump_max_V"] = 12.0
        heli.take_off()
        report = heli.fly_law(law.tape, duration_s=10.0)
        assert report.taken_over == reason, str(report)
        heli.wait(3.0)
        assert heli.state is heli_host.State.CLOSED_LOOP
        assert abs(heli.latest.elevation_deg) < 5.0


@pytest.mark.medium
@pytest.mark.parametrize(("axis", "wanted_deg"), [("elevation", 15.0), ("travel", 35.0)])
def test_an_axis_that_stays_away_from_its_setpoint_is_taken_over(axis: str, wanted_deg: float) -> None:
    law = hostile("stays", lambda now, good: good)
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        heli.setpoint(**{f"{axis}_deg": wanted_deg})
        report = heli.fly_law(law.tape, duration_s=15.0)
        assert report.taken_over == f"{axis}_following", str(report)
        # Of the board's own limit, the share that law_envelope says.
        assert abs(report.value) > 0.8 * heli.params[f"{axis}_following_max_deg"]


@pytest.mark.medium
def test_the_board_takes_over_without_a_bump() -> None:
    flown = fly(law_of(LAWS / "lqi.py").tape, seconds=3.0)
    last = int(np.flatnonzero(flown.flying)[-1])
    motors = flown.raw[last - 5 : last + 6][:, [Channel.FRONT, Channel.BACK]].astype(int)
    assert np.abs(np.diff(motors, axis=0)).max() < 60, "more than 60 mV from one tick to the next"
