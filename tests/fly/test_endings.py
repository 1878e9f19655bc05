"""How a flight ends: landed from any state, complete only as planned, at rest as before, or restarted."""

import signal
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.board.law_flight import engage
from heli_host.board.rest_check import ANGLE_SHIFTED, HoverTilt, RestAngles
from heli_host.board.samples import Samples
from heli_host.data.log.figure import draw
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import FlightSummary, summarise
from heli_host.declaration import State, Trigger
from heli_host.errors import FlightAborted, HeliError, WaitTimeout
from heli_host.fly.pilot import LAW_TAKEN_OVER
from heli_host.fly.plan import Plan
from heli_host.fly.runner import Progress, fly
from heli_host.link.events import BOARD_RESTARTED
from heli_lab.control.law import from_gain
from heli_sim.due import firmware
from heli_sim.model.linear import rig_findings
from heli_sim.rig import Rig, load_rig, write_rig
from heli_sim.sil.transport import SilProcess

from tests.identify.made import flown_by_plan, perturbed
from tests.running.long import samples
from tests.sil.harness import turn_unseen, world_of

pytestmark = pytest.mark.medium

FREE = 'axes = ["elevation", "pitch"]\n[start]\nsettle_s = 2\n'
HOLD = '[start]\nsettle_s = 2\n[[segment]]\nkind = "hold"\nduration_s = 6\n'


def outcome_of(text: str, address: str = "sil://?seed=1") -> str:
    with heli_host.connect(address) as heli:
        return fly(heli, Plan.parse(text, "plan.toml")).outcome


def step(travel_deg: float, duration_s: float) -> str:
    return f'[[segment]]\nkind = "step"\ntravel_deg = {travel_deg}\nduration_s = {duration_s}\n'


@pytest.mark.parametrize(
    "segments",
    [step(150, 2), step(40, 2), step(150, 2) + step(0, 12)],
    ids=["the setpoint is on its way", "the arm is on its way", "the next step goes back"],
)
def test_a_step_that_is_not_reached_is_not_tracked(segments: str) -> None:
    outcome = outcome_of("[start]\nsettle_s = 2\n" + segments)
    assert outcome.startswith("not_tracked: travel was at ")
    assert "give the segment more time" in outcome


def test_a_step_with_enough_time_is_completed() -> None:
    assert outcome_of("[start]\nsettle_s = 2\n" + step(60, 12) + step(0, 12)) == "completed"


def test_a_law_that_the_board_takes_over_is_the_outcome_and_in_the_figure(tmp_path: Path) -> None:
    falls = from_gain([[0.0] * 6] * 2, hover_V=3.5)
    with heli_host.connect("sil://?seed=1") as heli:
        log = tmp_path / "flight.mcap"
        summary = fly(
            heli,
            Plan.parse(HOLD, "plan.toml"),
            log_path=log,
            on_taken_off=lambda: engage(heli, falls.program),
        )
    assert summary.outcome.startswith(f"{LAW_TAKEN_OVER}: elevation_")
    assert not summary.completed
    read = read_log(log)
    assert read.metadata["result"]["outcome"] == summary.outcome
    figure = draw(read.flight(), summarise(read))
    texts = [text.get_text() for panel in figure.axes for text in panel.texts]
    assert texts.count("law taken over") == 1


def test_the_landing_of_a_law_is_no_takeover(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    with heli_host.connect("sil://?seed=1") as heli:
        holds = from_gain([[12.0, 0, 0, 5.0, 0, 0], [0, 6.0, 1.5, 0, 2.0, 2.5]], hover_V=1.41)
        summary = fly(
            heli,
            Plan.parse(HOLD, "plan.toml"),
            log_path=log,
            on_taken_off=lambda: engage(heli, holds.program),
        )
    assert summary.outcome == "completed"
    read = read_log(log)
    assert any(event["name"] == LAW_TAKEN_OVER for event in read.events)
    figure = draw(read.flight(), summarise(read))
    assert not any(text.get_text() == "law taken over" for panel in figure.axes for text in panel.texts)


def test_the_figure_says_which_part_of_the_flight_its_errors_count(tmp_path: Path) -> None:
    with heli_host.connect("sil://?seed=1") as heli:
        fly(heli, Plan.parse(HOLD, "plan.toml"), log_path=tmp_path / "flight.mcap")
    read = read_log(tmp_path / "flight.mcap")
    titles = [panel.get_title(loc="left") for panel in draw(read.flight(), summarise(read)).axes]
    assert sum(title.endswith("at most, without take-off and landing") for title in titles) == 3


@pytest.mark.parametrize(("pitch_deg", "duration_s"), [(5, 8), (10, 4), (-5, 8)][: samples(3, 2)])
def test_an_arm_that_turns_is_stopped_before_it_lands(pitch_deg: float, duration_s: float) -> None:
    turn = f'[[segment]]\nkind = "step"\npitch_deg = {pitch_deg}\nduration_s = {duration_s}\n'
    assert outcome_of(FREE + turn) == "completed"


def heavier_counterweight(more_kg: float) -> Rig:
    rig = load_rig("makki2024")
    return rig.replace(M_w=rig["M_w"].value + more_kg)


@pytest.mark.parametrize(("more_kg", "can_land"), [(0.015, True), (0.045, False)])
def test_a_rig_that_floats_high_without_voltage_cannot_land(
    tmp_path: Path, more_kg: float, can_land: bool
) -> None:
    rig = heavier_counterweight(more_kg)
    findings = rig_findings(rig)
    assert findings.can_fly is can_land
    assert any("floats without voltage at " in phrase for phrase in findings.phrases)
    write_rig(rig, tmp_path / "rig.toml")
    outcome = outcome_of(HOLD, f"sil://?rig={tmp_path / 'rig.toml'}&seed=1")
    assert (outcome == "completed") is can_land, outcome
    if not can_land:
        assert "although the motors gave no thrust: it floats" in outcome
        assert "hover_V" not in outcome


class Witness:
    """The states of the board in a flight, and its height when the motors went off."""

    def __init__(self, heli: Heli) -> None:
        self.world = world_of(heli)
        self.states: list[State] = []
        self.last_trigger = Trigger.START
        heli.on_ticks(self._take)

    def _take(self, samples: Samples) -> None:
        for state, trigger in zip(samples.state.tolist(), samples.trigger.tolist(), strict=True):
            if not self.states or self.states[-1] != state:
                self.states.append(State(state))
            self.last_trigger = Trigger(trigger)

    def assert_landed(self) -> None:
        assert self.states[-2:] == [State.LANDING, State.IDLE]
        assert self.last_trigger is Trigger.LAND
        assert not any(self.world.native.volts_V)


def time_out(heli: Heli) -> None:
    heli.wait_until(lambda _: False, 0.5)


def fail_in_a_callback(heli: Heli) -> None:
    def fail(_: Samples) -> None:
        raise ValueError("full")

    heli.on_ticks(fail)
    heli.wait(1.0)


def raising(error: BaseException) -> Callable[[Heli], None]:
    def raise_it(_: Heli) -> None:
        raise error

    return raise_it


@pytest.mark.parametrize(
    ("end", "error"),
    [
        (time_out, WaitTimeout),
        (fail_in_a_callback, HeliError),
        (raising(ValueError("bug")), ValueError),
        (raising(KeyboardInterrupt()), KeyboardInterrupt),
        (raising(SystemExit(1)), SystemExit),
    ],
)
def test_an_error_in_the_block_lands_the_arm(
    end: Callable[[Heli], None], error: type[BaseException], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(error), heli_host.connect("sil://?seed=2") as heli:
        witness = Witness(heli)
        heli.take_off()
        end(heli)
    witness.assert_landed()
    assert capsys.readouterr().err.endswith(": the board lands; Ctrl-C now switches the motors off\nlanded\n")


@pytest.mark.parametrize("after", ["stream", "hold", "open_loop"])
def test_the_arm_lands_from_every_state_in_the_air(after: str) -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        witness = Witness(heli)
        heli.take_off()
        if after == "stream":
            heli.stream()
        elif after == "hold":
            heli.keep_alive = False
            heli.wait(1.0)
            assert heli.state is State.HOLD
        else:
            sample = heli.latest
            heli.control(heli_host.Axes(0), sample.front_V, sample.back_V)
    witness.assert_landed()


def test_a_closed_vehicle_has_landed() -> None:
    heli = heli_host.connect("sil://?seed=2")
    witness = Witness(heli)
    heli.take_off()
    heli.close()
    witness.assert_landed()
    with pytest.raises(HeliError, match="the session is closed; connect again"):
        heli.setpoint(elevation_deg=1.0)


def test_an_interrupt_during_the_landing_stops_the_motors_and_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(ValueError), heli_host.connect("sil://?seed=2") as heli:
        heli.take_off()
        heli.on_ticks(
            lambda samples: (
                signal.raise_signal(signal.SIGINT) if State.LANDING in samples.state.tolist() else None
            )
        )
        raise ValueError("bug")
    assert "Ctrl-C while landing, motors stopped in the air" in capsys.readouterr().err


def test_a_motor_on_the_bench_is_switched_off_and_not_landed() -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        witness = Witness(heli)
        heli.arm()
        heli.control(heli_host.Axes(0), 0.5, 0.5)
        heli.wait(0.2)
    assert State.LANDING not in witness.states


def test_the_climb_of_a_slow_setpoint_is_waited_for() -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        heli.params["elevation_slew_deg_s"] = 1.0
        sample = heli.take_off()
        assert abs(sample.elevation_deg) < 2.0


def test_no_wait_is_of_zero_ticks() -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        for duration_s in (0.0, 1e-9, 4e-4, 0.3, 0.0125):
            tick = heli.latest.tick
            heli.wait(duration_s)
            assert heli.latest.tick > tick
        for impossible_s in (-1.0, float("nan"), float("inf"), cast(float, "1")):
            for duration_of in (heli.wait, heli.samples):
                with pytest.raises(HeliError, match="give a number of seconds"):
                    duration_of(impossible_s)


@pytest.mark.parametrize("duration_s", [0.1, 0.3, 0.6, 0.7, 0.9, 1.1, 1.3, 0.0301])
def test_a_paced_loop_ends_in_time(duration_s: float) -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        start_s = heli.latest.t_s
        looks = list(heli.pace(0.1, duration_s))
        assert 0.0 <= heli.latest.t_s - start_s - duration_s < 0.1
        assert len(looks) <= duration_s / 0.1 + 2


PLAN = Plan.parse('[start]\nsettle_s = 2\n[[segment]]\nkind = "hold"\nduration_s = 9\n', "hold.toml")
COUNT_DEG = 0.1


def after(elevation_deg: object, pitch_deg: object, length_s: float = 20.0) -> Samples:
    """The samples since a landing, with constant angles or functions of the time in s."""
    tick = np.arange(round(length_s * 1e3))
    columns: dict[str, Any] = {field: np.zeros(len(tick)) for field in Samples.__dataclass_fields__}
    for name, value in (("elevation_rad", elevation_deg), ("pitch_rad", pitch_deg)):
        columns[name] = np.radians(value(tick * 1e-3) if callable(value) else np.full(len(tick), value))
    return Samples(**{**columns, "tick": tick})


BEFORE = RestAngles(-25.0, 0.0, COUNT_DEG, HoverTilt(COUNT_DEG))


@pytest.mark.parametrize(
    ("elevation_deg", "pitch_deg", "axes"),
    [
        (-24.8, 0.9, ()),
        (-26.1, 0.0, ("elevation",)),
        (-23.9, 0.0, ("elevation",)),
        (-25.0, 1.1, ("pitch",)),
        (-26.5, -4.0, ("elevation", "pitch")),
    ],
)
def test_an_axis_that_rests_more_than_a_degree_off_is_named(
    elevation_deg: float, pitch_deg: float, axes: tuple[str, ...]
) -> None:
    text = BEFORE.shift_after(after(elevation_deg, pitch_deg))
    assert text is not None
    assert bool(text) == bool(axes)
    for axis in ("elevation", "pitch"):
        assert (f"{axis} at rest was" in text) == (axis in axes)


@pytest.mark.parametrize(("hover_deg", "is_shifted"), [(-8.0, False), (0.0, True)])
def test_a_tilt_of_the_hover_that_friction_holds_is_not_accused(hover_deg: float, is_shifted: bool) -> None:
    hover = HoverTilt(COUNT_DEG)
    hover.mean_deg = hover_deg
    text = replace(BEFORE, hover=hover).shift_after(after(elevation_deg=-25.0, pitch_deg=-8.9))
    assert text is not None
    assert bool(text) is is_shifted


def test_a_short_arm_that_drifts_before_the_take_off_has_no_rest_to_compare_with() -> None:
    # On a healthy rig whose friction hides that nothing holds its short arm, half a second shows one count.
    flown_by_plan(perturbed(9342), 9342, PLAN, parameters={"travel_following_max_deg": 180.0})
    with heli_host.connect("sil://") as heli:
        drift, still = (
            after(elevation_deg=-25.0, pitch_deg=lambda t_s, w=rate: w * t_s, length_s=2.0)
            for rate in (-0.18, 0.0)
        )
        for seen, is_moving in ((drift, True), (still, False)):
            assert np.isnan(RestAngles.of(heli.latest, seen, COUNT_DEG).pitch_deg) == is_moving


def test_a_short_arm_that_drifts_is_armed_at_any_time() -> None:
    with heli_host.connect("sil://?rig=makki2024-identified&speed=max") as heli:
        heli.wait(2.2)
        # A count comes every 0.14 s, and looks like the highest rate with which the board arms.
        for _ in range(40):
            heli.arm()
            heli.stop()
            heli.wait(0.009)


def test_an_arm_that_floats_up_without_voltage_is_not_accused() -> None:
    floating = after(elevation_deg=lambda t_s: -23.7 + np.minimum(5.0, 3.0 * t_s), pitch_deg=0.0)
    assert BEFORE.shift_after(floating) == ""


def test_a_swing_about_the_old_angle_is_waited_for_and_not_accused() -> None:
    swing = lambda t_s: 3.0 * np.exp(-t_s / 2.0) * np.cos(2.0 * t_s)  # noqa: E731
    assert BEFORE.shift_after(after(elevation_deg=-25.0, pitch_deg=swing, length_s=1.0)) is None
    assert BEFORE.shift_after(after(elevation_deg=-25.0, pitch_deg=swing)) == ""


def test_a_swing_about_another_angle_is_found_although_it_begins_at_the_old_one() -> None:
    swing = lambda t_s: 3.0 - 3.0 * np.exp(-t_s / 2.0) * np.cos(2.0 * t_s)  # noqa: E731
    assert BEFORE.shift_after(after(elevation_deg=-25.0, pitch_deg=swing, length_s=1.0)) is None
    text = BEFORE.shift_after(after(elevation_deg=-25.0, pitch_deg=swing))
    assert text and "pitch" in text


def test_an_endless_swing_is_judged_by_its_middle() -> None:
    for middle_deg, shifted in ((0.5, False), (5.0, True)):
        text = BEFORE.shift_after(
            after(elevation_deg=-25.0, pitch_deg=lambda t_s, m=middle_deg: m + 2.0 * np.sin(3.0 * t_s))
        )
        assert text is not None
        assert bool(text) is shifted


PITCH = 1
SLIP_DEG = 0.25


def slipping(heli: Heli, axis: int, shift_deg: float) -> Callable[[], None]:
    """Return a function that shifts a measured angle a little in each call, as a loose coupling does: no step
    that a board could notice.
    """
    world = world_of(heli)
    steps = [float(np.sign(shift_deg)) * SLIP_DEG] * round(abs(shift_deg) / SLIP_DEG)

    def slip() -> None:
        if not steps:
            return
        step_deg = steps.pop()
        # Without its plug the encoder does not see the arm turn back, and then counts the way there.
        for unseen, turn_deg in ((True, -step_deg), (False, step_deg)):
            turn_unseen(world, axis, turn_deg, unseen=unseen)
            heli.wait(0.001)

    return slip


def test_a_flight_whose_pitch_encoder_slipped_is_not_completed(tmp_path: Path) -> None:
    with heli_host.connect("sil://?seed=3") as heli:
        heli.wait(0.6)
        slip = slipping(heli, PITCH, 4.0)
        summary = fly(heli, PLAN, on_progress=lambda progress: slip() if progress.t_s > 6.0 else None)
    assert summary.outcome.startswith(f"{ANGLE_SHIFTED}: pitch at rest was 0.0 degrees")
    assert not summary.completed


def test_a_flight_by_hand_ends_with_the_same_error() -> None:
    with heli_host.connect("sil://?seed=3") as heli:
        heli.wait(0.6)
        heli.take_off()
        slip = slipping(heli, PITCH, -4.0)
        heli.wait(3.0)
        for _ in heli.pace(0.05, 3.0):
            slip()
        with pytest.raises(FlightAborted, match=f"{ANGLE_SHIFTED}: pitch at rest"):
            heli.land()
        assert heli.state is State.IDLE


@pytest.mark.parametrize(
    "effects",
    [
        "coulomb_friction.travel;coulomb_friction.pitch;backlash.pitch",
        "counterweight_shift;random_torque.pitch",
    ],
)
def test_a_flight_of_a_healthy_rig_with_effects_is_completed(effects: str) -> None:
    with heli_host.connect(f"sil://?seed=1&effect={effects}") as heli:
        assert fly(heli, PLAN).outcome == "completed"


RESTART_PLAN = Plan.parse('[start]\nsettle_s = 1\n[[segment]]\nkind = "hold"\nduration_s = 6\n', "hover.toml")


def call_once_at(at_s: float, action: Callable[[], None]) -> Callable[[Progress], None]:
    waiting = [action]

    def call(progress: Progress) -> None:
        if progress.t_s >= at_s and waiting:
            waiting.pop()()

    return call


def flown(url: str, path: Path, at_s: float = 3.0) -> tuple[FlightSummary, float]:
    """A flight whose board loses its power; its summary, and a parameter that was set and not saved."""
    with heli_host.connect(url) as heli:
        heli.params["landing_timeout_s"] = 15.0
        cut = world_of(heli).cycle_power
        summary = fly(heli, RESTART_PLAN, log_path=path, on_progress=call_once_at(at_s, cut))
        assert heli.session.state is State.IDLE
        assert heli.counters.restarts == 1
        # One that finds the link, not a pair for every batch.
        assert heli.counters.reconnects == 1
        return summary, heli.params["landing_timeout_s"]


def assert_restart_reported(summary: FlightSummary, path: Path) -> None:
    assert not summary.completed
    assert summary.outcome.startswith("aborted: the board restarted (power_up) in flight")
    assert "link lost" not in summary.outcome
    log = read_log(path)
    assert log.metadata["result"]["outcome"] == summary.outcome
    assert [event["name"] for event in log.events].count(BOARD_RESTARTED) == 1
    assert log.metadata["parameters"]["landing_timeout_s"] == "15.0"
    assert log.metadata["parameters_changed"]["landing_timeout_s"] == "12.0"
    # The counters that the new start takes for rest are no movement of the arm: a gap lies between.
    jump = int(np.argmax(np.abs(np.diff(log.ticks["elevation_rad"]))))
    assert log.ticks["t_s"][jump + 1] - log.ticks["t_s"][jump] > 0.1


@pytest.mark.parametrize("at_s", [3.0, 1.0, 6.5][: samples(3, 1)])
def test_a_board_that_lost_its_power_in_flight_ends_the_flight(tmp_path: Path, at_s: float) -> None:
    path = tmp_path / "a.mcap"
    summary, landing_timeout_s = flown("sil://?seed=3", path, at_s)
    assert_restart_reported(summary, path)
    assert landing_timeout_s == 12.0


TILTED = Plan.parse(
    'axes = ["elevation", "pitch"]\n[[segment]]\nkind = "step"\npitch_deg = 20\nduration_s = 4\n',
    "tilted.toml",
)


@pytest.mark.parametrize("delay_s", [0.0, 1.2, 0.3, 3.5][: samples(4, 2)])
def test_a_board_that_restarts_while_it_lands_after_a_fault_names_both(
    tmp_path: Path, delay_s: float
) -> None:
    """The arm turns on in the landing, so that the board begins an emergency landing."""
    with heli_host.connect("sil://?seed=5") as heli:
        fault_s: list[float] = []
        heli.on_event(lambda event: fault_s.append(heli.latest.t_s) if event.kind == "fault" else None)
        cut = [world_of(heli).cycle_power]

        def cycle_power(progress: Progress) -> None:
            if fault_s and cut and progress.sample.t_s >= fault_s[0] + delay_s:
                cut.pop()()

        summary = fly(heli, TILTED, log_path=tmp_path / "a.mcap", on_progress=cycle_power)
    assert fault_s, summary.outcome
    assert summary.outcome.startswith("aborted: fault travel_"), summary.outcome
    assert ("the board restarted" in summary.outcome) == (not cut)


@pytest.mark.emulated
def test_the_emulated_due_that_lost_its_power_in_flight_ends_the_flight(tmp_path: Path) -> None:
    if not firmware.candidates():
        pytest.skip("no firmware is built: install the cross-compiler, then make setup or make firmware")
    path = tmp_path / "a.mcap"
    summary, landing_timeout_s = flown("sil://?seed=3&board=due", path)
    assert_restart_reported(summary, path)
    assert landing_timeout_s == 12.0


def test_power_lost_while_a_command_waits_is_a_restart_and_no_lost_link(tmp_path: Path) -> None:
    with heli_host.connect("sil://?seed=3") as heli:
        world, command = world_of(heli), heli.session.command

        def cut_first(*arguments: object, **options: object) -> object:
            heli.session.command = command  # type: ignore[method-assign]
            world.cycle_power()
            return command(*arguments, **options)  # type: ignore[arg-type]

        def cut_at_landing() -> None:
            heli.session.command = cut_first  # type: ignore[method-assign, assignment]

        summary = fly(heli, RESTART_PLAN, on_progress=call_once_at(6.5, cut_at_landing))
    assert summary.outcome.startswith("aborted: the board restarted (power_up) in flight")
    assert "link lost" not in summary.outcome and "lands by itself" not in summary.outcome


@pytest.mark.slow
def test_two_processes_with_the_same_seed_are_two_boards() -> None:
    ids = []
    for _ in range(2):
        with SilProcess(seed=5) as board, heli_host.connect(board.url) as heli:
            ids.append(heli.info.boot_id)
    assert ids[0] != ids[1]
