"""Laws fly on the board, and a flight's log says bit for bit what they did."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.board.law_flight import engage
from heli_host.declaration import Channel, Fault, LawFlyMessage
from heli_host.link.telemetry import Ticks

from tests.law.flown import fly, law_of, replayed
from tests.law.hostile import HOSTILE, RIGS, CALM_s, Good, MAX_deg, Volts, follows, hostile, motors, tries
from tests.running.long import LONG, samples

LAWS = Path(__file__).resolve().parents[2] / "docs" / "laws"
NAMES = ("cascade", "feedback_linearisation", "gain_scheduled", "input_shaping", "lqg", "lqi", "lqr", "mpc",
         "sliding_mode")  # fmt: skip
SECONDS = 60.0 if LONG else 6.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_tick_of_a_shipped_law_is_replayed_bit_for_bit(name: str) -> None:
    program = law_of(LAWS / f"{name}.py").program
    flown = fly(program, seconds=SECONDS)
    assert not flown.report.taken_over
    assert replayed(flown, program) > 990 * SECONDS


@pytest.mark.emulated
@pytest.mark.parametrize("name", NAMES if LONG else ("input_shaping",))
def test_every_tick_on_the_emulated_due_is_replayed_bit_for_bit(name: str) -> None:
    pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
    program = law_of(LAWS / f"{name}.py").program
    seconds = 60.0 if LONG else 4.0
    assert replayed(fly(program, "due", seconds=seconds), program, "due") > 990 * seconds


@pytest.mark.medium
def test_a_law_is_flown_without_asking_for_its_tape() -> None:
    law = law_of(LAWS / "lqi.py")
    with heli_host.connect("sil://") as heli:
        heli.load_law(law)
        heli.take_off()
        report = heli.fly_law(law, duration_s=0.5, parameters={"hover_V": 1.45})
        assert (report.hash, report.taken_over) == (law.program.hash, "")
        assert heli.set_law_parameter(law, "hover_V", 1.5) == 1.5
        for wrong in (law.function, "lqi.py", None):
            with pytest.raises(
                heli_host.HeliError, match="is not a control law; give the result of @control_law"
            ):
                heli.fly_law(wrong, duration_s=0.5)  # type: ignore[arg-type]


@pytest.mark.medium
def test_parameters_of_a_law_are_set_by_name() -> None:
    law = law_of(LAWS / "lqi.py")
    with heli_host.connect("sil://") as heli:
        heli.load_law(law.program)
        heli.set_law_parameter(law.program, "hover_V", 1.5)
        with pytest.raises(heli_host.HeliError, match="has no parameter hover; choose from: hover_V"):
            heli.set_law_parameter(law.program, "hover", 1.5)


def stays_off(heli: heli_host.Heli, which: str) -> None:
    """Stop, ask for the law again, and see that the motors stay off."""
    ticks: list[Ticks] = []
    heli.stop()
    heli.wait(0.1)
    heli.session.subscribe_ticks(ticks.append)
    with pytest.raises(heli_host.HeliError):
        heli.session.command(LawFlyMessage(0, 1))
    heli.wait(0.5)
    motors = np.concatenate([part.raw for part in ticks])[:, [Channel.FRONT, Channel.BACK]]
    assert len(motors) > 400
    assert not motors.any(), which


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_the_board_takes_over_from_a_hostile_law_and_holds_the_arm(name: str) -> None:
    _, reasons = HOSTILE[name]
    for rig in RIGS if LONG else [list(RIGS)[list(HOSTILE).index(name) % len(RIGS)]]:
        for seed in range(1, samples(31, 2)):
            tried = tries(name, rig, seed, lambda heli: stays_off(heli, name))
            assert not tried.problem(), f"{tried.which}: {tried.problem()}"
            assert tried.taken_over in reasons or "immediately" in tried.taken_over, tried.which


@pytest.mark.medium
@pytest.mark.parametrize(
    ("name", "volts", "reason"),
    [
        # More lift on both sides, until elevation could not be braked any more before its limit.
        ("climbs", lambda now, good, _: (good.front_V + 4.0, good.back_V + 4.0), "elevation_envelope"),
        # One rotor pulls, the other does not: the arm rolls over.
        ("rolls", lambda now, good, _: (2.6, 0.6), "pitch_envelope"),
    ],
)
def test_the_reason_for_a_takeover_is_the_one_that_was_provoked(
    name: str, volts: Callable[[Any, Good, Any], Volts], reason: str
) -> None:
    law = hostile(name, volts)
    with heli_host.connect("sil://") as heli:
        heli.params["law_jump_max_V"] = 12.0
        heli.take_off()
        report = heli.fly_law(law.program, duration_s=10.0)
        assert report.taken_over == reason, str(report)
        heli.wait(CALM_s)
        assert heli.state is heli_host.State.CLOSED_LOOP
        assert abs(heli.latest.elevation_deg) < 1.0


@pytest.mark.medium
@pytest.mark.parametrize(("axis", "wanted_deg"), [("elevation", 15.0), ("travel", 35.0)])
def test_an_axis_that_stays_away_from_its_setpoint_is_taken_over(axis: str, wanted_deg: float) -> None:
    law = hostile("stays", lambda now, good, _: motors(follows(now, share=0.0)))
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        heli.setpoint(**{f"{axis}_deg": wanted_deg})
        report = heli.fly_law(law.program, duration_s=15.0)
        assert report.taken_over == f"{axis}_following", str(report)
        # The share of the board's limit that law_envelope states.
        assert abs(report.value) > 0.8 * heli.params[f"{axis}_following_max_deg"]


@pytest.mark.medium
def test_a_good_law_flies_at_the_highest_setpoint_there_is() -> None:
    law = hostile("well", lambda now, good, _: motors(good))
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        heli.setpoint(elevation_deg=MAX_deg)
        heli.wait(4.0)
        assert not heli.fly_law(law.program, duration_s=5.0).taken_over
        assert abs(heli.latest.elevation_deg - MAX_deg) < 1.0


@pytest.mark.medium
@pytest.mark.parametrize("end", ["the host ends it", "it lands"])
@pytest.mark.parametrize("rig", ["nominal", "slow rotors"])
def test_a_law_may_be_ended_far_below_a_high_setpoint(end: str, rig: str) -> None:
    with heli_host.connect(f"sil://?seed=1{RIGS[rig]}") as heli:
        heli.take_off()
        heli.setpoint(elevation_deg=21.0)
        heli.wait(4.0)
        engage(heli, HOSTILE["drift_down"][0].program)
        heli.wait_until(lambda sample: sample.elevation_deg < 9.5, 40.0)
        start = heli.latest.tick
        if end == "it lands":
            heli.land()
        else:
            heli.session.command(LawFlyMessage(0, 0))
            heli.wait(20.0)
        since = heli.samples(last_s=30.0)
        # One degree over: what any step does on slow rotors.
        assert np.degrees(since.elevation_rad[since.tick > start]).max() < 22.5
        assert heli.latest.fault is Fault.NONE
        if end != "it lands":
            assert abs(heli.latest.elevation_deg - 21.0) < 1.0


@pytest.mark.medium
def test_the_board_takes_over_without_a_bump() -> None:
    flown = fly(hostile("well", lambda now, good, _: motors(good)).program, seconds=2.5)
    last = int(np.flatnonzero(flown.flying)[-1])
    volts = flown.raw[last - 5 : last + 6][:, [Channel.FRONT, Channel.BACK]].astype(int)
    assert np.abs(np.diff(volts, axis=0)).max() < 60, "more than 60 mV from one tick to the next"
