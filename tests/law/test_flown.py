"""Laws fly on the board, and a flight's log says bit for bit what they did."""

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.board.law_flight import engage, loaded, takeover_since
from heli_host.board.law_program import LawProgram
from heli_host.data.response import responses
from heli_host.link.telemetry import Ticks
from heli_host.ui.cli.flight import FlightOptions
from heli_lab.apps.classroom.grade import FlightScore, LawGrade, score_of_trial
from heli_lab.control.law_flight import LawTrial, fly_trial, trial_plan
from heli_lab.control.linear_law import linearised
from heli_lab.control.tune.loops import linear_plant
from heli_lab.law import Command, Law, control_law, from_gain
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport

from tests.cli.terminal import Terminal
from tests.law.flown import LAWS, fly, law_of, replayed, upload_messages
from tests.law.hostile import HOSTILE, RIGS, CALM_s, Good, MAX_deg, Volts, follows, hostile, motors, tries
from tests.link.core_harness import Harness, open_harness, payloads_of
from tests.running.long import LONG, samples

pytestmark = pytest.mark.medium

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
        heli.session.command(d.LawFlyMessage(request=0, on=1))
    heli.wait(0.5)
    motors = np.concatenate([part.raw for part in ticks])[:, [d.Channel.FRONT, d.Channel.BACK]]
    assert len(motors) > 400
    assert not motors.any(), which


@pytest.mark.slow
@pytest.mark.parametrize("name", HOSTILE)
def test_the_board_takes_over_from_a_hostile_law_and_holds_the_arm(name: str) -> None:
    reasons = HOSTILE[name].reasons
    for rig in RIGS if LONG else [list(RIGS)[list(HOSTILE).index(name) % len(RIGS)]]:
        for seed in range(1, samples(31, 1) + 1):
            tried = tries(name, rig, seed, lambda heli: stays_off(heli, name))
            assert not tried.problem(), f"{tried.which}: {tried.problem()}"
            assert tried.taken_over in reasons or "immediately" in tried.taken_over, tried.which


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
        # The next law is not taken over for the same reason only because its own event is late.
        assert takeover_since(heli, 0) == (reason, report.value)
        assert takeover_since(heli, heli.latest.tick) is None
        assert heli.state is heli_host.State.CLOSED_LOOP
        assert abs(heli.latest.elevation_deg) < 1.0


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


def test_a_good_law_flies_at_the_highest_setpoint_there_is() -> None:
    law = hostile("well", lambda now, good, _: motors(good))
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        heli.setpoint(elevation_deg=MAX_deg)
        heli.wait(4.0)
        assert not heli.fly_law(law.program, duration_s=5.0).taken_over
        assert abs(heli.latest.elevation_deg - MAX_deg) < 1.0


@pytest.mark.parametrize("end", ["the host ends it", "it lands"])
@pytest.mark.parametrize("rig", ["nominal", "slow rotors"])
def test_a_law_may_be_ended_far_below_a_high_setpoint(end: str, rig: str) -> None:
    with heli_host.connect(f"sil://?seed=1{RIGS[rig]}") as heli:
        heli.take_off()
        heli.setpoint(elevation_deg=21.0)
        heli.wait(4.0)
        engage(heli, HOSTILE["drift_down"].law.program)
        heli.wait_until(lambda sample: sample.elevation_deg < 9.5, 40.0)
        start = heli.latest.tick
        if end == "it lands":
            heli.land()
        else:
            heli.session.command(d.LawFlyMessage(request=0, on=0))
            heli.wait(20.0)
        since = heli.samples(last_s=30.0)
        # One degree over: what any step does on slow rotors.
        assert np.degrees(since.elevation_rad[since.tick > start]).max() < 22.5
        assert heli.latest.fault is d.Fault.NONE
        if end != "it lands":
            assert abs(heli.latest.elevation_deg - 21.0) < 1.0


def test_the_board_takes_over_without_a_bump() -> None:
    flown = fly(hostile("well", lambda now, good, _: motors(good)).program, seconds=2.5)
    last = int(np.flatnonzero(flown.flying)[-1])
    volts = flown.raw[last - 5 : last + 6][:, [d.Channel.FRONT, d.Channel.BACK]].astype(int)
    assert np.abs(np.diff(volts, axis=0)).max() < 60, "more than 60 mV from one tick to the next"


def small(name: str, gain: float) -> Law:
    @control_law(name=name)
    def law(now, state, parameter):  # type: ignore[no-untyped-def]
        return Command(gain * now.pitch_rad + 1.0, 1.0)

    return law


def upload_frames(harness: Harness, program: LawProgram, request: int) -> list[bytes]:
    """Frames of an upload, in order."""
    return [harness.frame(message) for message in upload_messages(program, request)]


def law_on(harness: Harness) -> d.LawMessage:
    """The board's report of its law to a host that has just reconnected."""
    # Half a frame swallows what follows it, as on a line; a host greets until it is answered.
    hello = d.HelloMessage(request=240, link_hash=d.LINK_HASH, session=2)
    greeted = any(
        payloads_of(harness.turn(harness.frame(hello), ticks=2), d.MessageId.WELCOME) for _ in range(9)
    )
    assert greeted
    (payload,) = payloads_of(harness.ask(d.LawReadMessage(241)), d.MessageId.LAW)
    return d.LawMessage.unpack(payload)


def test_an_upload_cut_at_every_byte_leaves_the_old_law_or_none() -> None:
    old, new = small("old", 0.5).program, small("new", 0.25).program
    byte_count = len(b"".join(upload_frames(open_harness(), new, 50)))
    observed = set()
    for cut in range(byte_count + 1):
        harness = open_harness()
        for frame in upload_frames(harness, old, 1):
            harness.turn(frame, ticks=2)
        remaining_bytes = cut
        for frame in upload_frames(harness, new, 50):
            harness.turn(frame[:remaining_bytes], ticks=2)
            remaining_bytes = max(0, remaining_bytes - len(frame))
        law = law_on(harness)
        if law.state == d.LawState.READY:
            assert law.hash == (new.hash if cut == byte_count else old.hash), cut
        else:
            assert law.state in (d.LawState.NONE, d.LawState.RECEIVING), cut
            assert cut < byte_count
        observed.add((law.state, law.hash if law.state == d.LawState.READY else 0))
    assert observed >= {(d.LawState.READY, old.hash), (d.LawState.READY, new.hash), (d.LawState.RECEIVING, 0)}


def test_a_board_that_was_reset_gets_its_law_again_when_it_is_armed() -> None:
    law = law_of(LAWS / "lqr.py")
    with heli_host.connect("sil://") as heli:
        heli.load_law(law.program)
        transport = heli.session.transport
        assert isinstance(transport, InProcessTransport)
        transport.world.cycle_power()
        assert heli.session.wait_for(lambda: heli.counters.restarts > 0, 8.0)
        assert loaded(heli.session).state == d.LawState.NONE
        heli.take_off()
        assert loaded(heli.session).hash == law.program.hash
        assert loaded(heli.session).state == d.LawState.READY


def test_a_cable_that_was_out_costs_no_law() -> None:
    law = law_of(LAWS / "lqr.py")
    with heli_host.connect("sil://?unplug=2:1") as heli:
        heli.load_law(law.program)
        heli.session.wait_for(lambda: heli.counters.reconnects > 0, 8.0)
        assert heli.counters.reconnects == 1
        assert loaded(heli.session).hash == law.program.hash


def test_from_the_beginning_of_an_upload_to_a_voltage_of_the_law_it_takes_half_a_second_at_most() -> None:
    law = law_of(LAWS / "lqg.py")
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        start = heli.latest.tick
        acting: list[int] = []

        def look(new: Ticks) -> None:
            flown = new.raw[:, d.Channel.FLAGS] & d.Flags.LAW
            acting.extend(new.tick[flown != 0].tolist())

        heli.session.subscribe_ticks(look)
        heli.fly_law(law.program, duration_s=0.1)
        assert 0 < acting[0] - start <= 500


PLANT = linear_plant(load_rig("makki2024"))
GAINS = np.array([[12.0, 0, 0, 5.0, 0, 0], [0, 6.0, 1.5, 0, 2.0, 2.5]])
FILE = """
from heli_lab.law import from_gain

LAW = from_gain({gains}, hover_V={hover_V})
"""


def test_a_law_that_leaves_an_axis_free_is_not_stable() -> None:
    """Without feedback, travel has a pole at 0, and no margin limits anything."""
    linear = linearised(from_gain(0.0 * GAINS, hover_V=1.41), PLANT)
    assert not linear.stable
    assert np.isnan([*linear.gain_up, *linear.phase_deg]).all()


@pytest.mark.parametrize("signs", [(-1, 1), (1, -1)])
def test_a_law_with_a_wrong_sign_is_not_stable(signs: tuple[int, int]) -> None:
    linear = linearised(from_gain(np.array(signs)[:, None] * GAINS, hover_V=1.41), PLANT)
    assert not linear.stable
    assert np.isnan(linear.gain_up).all()


def test_a_law_that_is_stable_keeps_its_margins() -> None:
    linear = linearised(from_gain(GAINS, hover_V=1.41), PLANT)
    assert linear.stable
    assert min(linear.phase_deg) > 10.0
    assert linear.nonlinearity_V < 1e-6


def test_a_law_that_switches_is_not_linear() -> None:
    @control_law(rate_Hz=500)
    def switches(now: object, state: object, parameter: object) -> Command:
        pushed_V = (now.elevation_rad < -0.001) * 3.0  # type: ignore[attr-defined]
        return Command(1.7 + pushed_V, 1.7 + pushed_V)

    assert linearised(switches, PLANT).nonlinearity_V == pytest.approx(3.0)


def test_the_check_of_a_law_that_fails_ends_with_1_and_its_flight_with_4(
    terminal: Terminal, tmp_path: Path
) -> None:
    (tmp_path / "falls.py").write_text(FILE.format(gains=(0.0 * GAINS).tolist(), hover_V=3.5))
    checked = terminal("law", "check", tmp_path / "falls.py", "--rigs", 1, "--json", tmp_path / "check.json")
    assert checked.code == 1
    assert "NOT STABLE" in checked.out
    assert "margin" not in checked.out
    assert "the board's own law had to take over on 1 of 1 rigs" in checked.out
    assert json.loads((tmp_path / "check.json").read_text())["stable"] is False
    files = ("--log", tmp_path / "a.mcap", "--json", tmp_path / "fly.json")
    flown = terminal("law", "fly", tmp_path / "falls.py", "--duration", 4, "--sil", "--speed", "max", *files)
    assert flown.code == 4
    assert "law_taken_over: elevation_" in flown.err
    assert "nan" not in flown.out
    assert json.loads((tmp_path / "fly.json").read_text())["outcome"].startswith("law_taken_over")


def test_a_comparison_with_a_law_that_fails_says_so_in_its_labels(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "falls.py").write_text(FILE.format(gains=(0.0 * GAINS).tolist(), hover_V=3.5))
    where = ("--figure", tmp_path / "a.png", "--json", tmp_path / "a.json")
    compared = terminal(
        "law", "compare", tmp_path / "falls.py", "--duration", 4, "--sil", "--speed", "max", *where
    )
    assert compared.code == 4
    labels = [flight["flight"] for flight in json.loads((tmp_path / "a.json").read_text())["flights"]]
    assert sum("taken over" in label for label in labels) == 1


@pytest.mark.parametrize(
    ("settling_s", "text"),
    [((3.66,), "3.66"), ((3.0, 4.0), "3.50"), ((3.66, math.inf), "3.66 in 1 of 2"), ((math.inf,), "never")],
)
def test_the_settling_of_a_grade_is_that_of_the_flights_that_settled(
    settling_s: tuple[float, ...], text: str
) -> None:
    grade = LawGrade("lqr", scores=tuple(FlightScore(settling_s=time_s) for time_s in settling_s))
    assert grade.row()[1] == text


def test_a_grade_and_its_figure_measure_the_same(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "holds.py").write_text(FILE.format(gains=GAINS.tolist(), hover_V=1.41))
    log = tmp_path / "a.mcap"
    assert terminal("law", "fly", tmp_path / "holds.py", "--sil", "--speed", "max", "--log", log).code == 0
    trial = LawTrial.of_log(log)
    travel = responses(trial.flight)[2]
    settling_s = score_of_trial(trial).settling_s
    assert settling_s == (math.inf if math.isnan(travel.settling_s) else travel.settling_s)


def test_the_boards_own_law_is_measured_without_its_checks_of_the_travel_encoder() -> None:
    # The board tilts the arm after a few seconds at the end of the step; it does not while a law flies.
    trial = fly_trial(None, FlightOptions(sil=True, speed="max"), trial_plan(12.0))
    assert not [event for event in trial.flight.events if event.name == "travel_probe"]
    assert responses(trial.flight)[2].settling_s < 5.0
