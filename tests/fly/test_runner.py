"""A flight follows its plan, always comes down, and always leaves a log that says what happened."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.data.log.reader import Log, read_flight, read_log
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import Axes, Flags, State
from heli_host.errors import LogWriteError, PlanError
from heli_host.fly.connection import connect
from heli_host.fly.pilot import RouteStream
from heli_host.fly.plan import Plan, load_plan
from heli_host.fly.recorder import Recorder
from heli_host.fly.runner import Progress, fly
from heli_host.fly.tracking import TrackingMonitor
from heli_host.link.telemetry import Ticks

from tests.running.pixels import coloured_share
from tests.sil.harness import SOON_LANDING, world_of

pytestmark = pytest.mark.medium

pytest.importorskip("heli_sim._native", reason="skipped: the simulation is not built")

SHORT = """
title = "Short"
[start]
settle_s = 2
[[segment]]
kind = "ramp"
travel_deg = 6
elevation_deg = 3
duration_s = 4
[[segment]]
kind = "hold"
duration_s = 2
"""


def short(text: str = SHORT, name: str = "short") -> Plan:
    return Plan.parse(text, f"{name}.toml")


def flown(
    path: Path,
    *plans: Plan,
    options: str = "",
    on_progress: Callable[[Progress], None] | None = None,
    prepare: Callable[[Heli], None] | None = None,
    reconnect_timeout_s: float = 30.0,
) -> tuple[FlightSummary, Log, State | None]:
    """Fly in lockstep; return summary, log, and the state that the board is left in."""
    url = f"sil://?rig=makki2024&seed=3&speed=max{options}"
    with connect(url, reconnect_timeout_s=reconnect_timeout_s) as heli:
        if prepare is not None:
            prepare(heli)
        summary = fly(heli, plans or short(), log_path=path, on_progress=on_progress, rig_name="makki2024")
        state = heli.session.state
    return summary, read_log(path), state


def raising(error: BaseException, *at_s: float) -> Callable[[Progress], None]:
    """Return a progress callback that raises at a time, and again at later ones."""

    def fail() -> None:
        raise error

    return calling(fail, *at_s)


def signalling(*at_s: float) -> Callable[[Progress], None]:
    """Return a progress callback that is interrupted by signals."""
    return calling(lambda: signal.raise_signal(signal.SIGINT), *at_s)


def calling(action: Callable[[], None], *at_s: float) -> Callable[[Progress], None]:
    """Return a progress callback that calls `action` at each of these times."""
    due_s = list(at_s)

    def call(progress: Progress) -> None:
        if due_s and progress.t_s >= due_s[0]:
            due_s.pop(0)
            action()

    return call


@pytest.mark.slow
def test_a_plan_is_flown_landed_and_logged(heli: Heli, tmp_path: Path) -> None:
    summary = fly(
        heli,
        short(),
        log_path=tmp_path / "a.mcap",
        json_path=tmp_path / "summary.json",
        figure_path=tmp_path / "figure.png",
        rig_name="makki2024",
    )
    assert heli.state is State.IDLE
    assert summary.completed and summary.ticks_lost == 0
    assert summary.plans == ("short",)
    for axis in ("elevation", "travel"):
        error_deg = summary.rms_error_deg[axis]
        assert error_deg is not None and error_deg < 1.0
    content = json.loads((tmp_path / "summary.json").read_text())
    assert content["link"]["frames_bad"] == 0 and content["link"]["reconnects"] == 0
    assert content["ticks_logged"] == summary.ticks_logged > 12_000
    assert coloured_share(tmp_path / "figure.png") > 0.001
    log = read_log(tmp_path / "a.mcap")
    assert log.complete and log.metadata["result"]["outcome"] == "completed"
    assert log.metadata["plan"]["short"] == SHORT
    assert log.metadata["session"]["rig"] == "makki2024" and log.metadata["session"]["firmware"]
    assert len(log.metadata["session"]["link_hash"]) == 8 and log.metadata["session"]["host_link_hash"]
    assert len(log.parameters) > 40
    assert {"armed", "closed_loop", "landing", "idle"} <= {
        event["message"].split()[1].rstrip(",") for event in log.events if event["name"] == "state"
    }
    assert len(log.link) >= 10 and log.link[-1]["board_frames_bad"] == 0


@pytest.mark.slow
def test_the_boards_setpoint_is_the_plan_on_device_time(tmp_path: Path) -> None:
    plan = load_plan("sine")
    _, log, _ = flown(tmp_path / "a.mcap", plan)
    flight = log.flight()
    start_s = next(event.t_s for event in flight.events if event.text == "sine")
    flying = (flight.t_s > start_s) & (flight.t_s < start_s + plan.duration_s)
    elevation_deg, _, travel_deg = plan.evaluate(flight.t_s[flying] - start_s)
    setpoints = flight.setpoints_rad
    assert setpoints is not None
    # The board may lag its own slew and acceleration limits for a moment, never by a setpoint's interval.
    assert np.max(np.abs(np.rad2deg(setpoints[flying, 0]) - elevation_deg)) < 0.25
    assert np.max(np.abs(np.rad2deg(setpoints[flying, 2]) - travel_deg)) < 0.8
    assert np.median(np.abs(np.rad2deg(setpoints[flying, 2]) - travel_deg)) < 0.1


def test_plans_are_flown_one_after_the_other_in_one_flight(tmp_path: Path) -> None:
    second = short(SHORT.replace("travel_deg = 6", "travel_deg = -6"), "back")
    summary, log, _ = flown(tmp_path / "a.mcap", short(), second, short())
    assert summary.completed and summary.plans == ("short", "back", "short (2)")
    phases = [event["message"] for event in log.events if event["name"] == "phase"]
    assert phases == ["take-off", "short", "back", "short", "landing"]
    assert sum(event["message"].startswith("state armed") for event in log.events) == 1


def test_an_excitation_acts_in_its_segment_and_nowhere_else(tmp_path: Path) -> None:
    text = SHORT + (
        '[[segment]]\nkind = "excite"\nsignal = "multisine"\nfront_V = 0.3\nback_V = 0.2\n'
        "start_Hz = 0.5\nstop_Hz = 4\nduration_s = 3\n[[segment]]\nkind = 'hold'\nduration_s = 1\n"
    )
    summary, log, _ = flown(tmp_path / "a.mcap", short(text))
    assert summary.completed
    excited = (log.ticks["flags"] & int(Flags.EXCITATION)) > 0
    phase_s = next(event["t_s"] for event in log.events if event["message"] == "short")
    during_s = log.ticks["t_s"][excited]
    assert during_s[0] == pytest.approx(phase_s + 6.0, abs=0.15)
    assert during_s[-1] - during_s[0] == pytest.approx(3.0, abs=0.05)


BEYOND_ITS_LIMITS = short(SHORT.replace("travel_deg = 6", "travel_deg = 172"))


def test_a_plan_that_leaves_the_limits_moves_nothing(heli: Heli, tmp_path: Path) -> None:
    with pytest.raises(PlanError, match=r"short\.toml, segment 1 \(ramp\).*travel_max_deg - 5"):
        fly(heli, BEYOND_ITS_LIMITS, log_path=tmp_path / "a.mcap")
    with pytest.raises(PlanError, match="did you mean hover"):
        fly(heli, "hoover", log_path=tmp_path / "a.mcap")
    assert heli.state is State.IDLE
    assert not (tmp_path / "a.mcap").exists()


def test_a_log_that_cannot_be_created_moves_nothing(heli: Heli, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogWriteError):
        fly(heli, short(), log_path=tmp_path / "file" / "a.mcap")
    assert heli.state is State.IDLE


def test_a_refused_plan_leaves_the_log_that_it_was_to_write_over(heli: Heli, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"an older flight")
    with pytest.raises(PlanError):
        heli.fly(BEYOND_ITS_LIMITS, log=path, overwrite=True)
    with pytest.raises(LogWriteError, match="exists already, and heli-host never replaces a log"):
        heli.fly(short(), log=path)
    assert heli.state is State.IDLE
    assert path.read_bytes() == b"an older flight"
    assert heli.fly(short(), log=path, overwrite=True).completed
    assert len(read_log(path).ticks) > 5000


def test_a_fault_ends_the_flight_with_its_name_and_parameter(tmp_path: Path) -> None:
    def tighten(heli: Heli) -> None:
        heli.params["elevation_rate_max_deg_s"] = 10.0

    fast = short(
        SHORT.replace("elevation_deg = 3", "elevation_deg = 18").replace("duration_s = 4", "duration_s = 1.3")
    )
    summary, log, state = flown(tmp_path / "a.mcap", fast, prepare=tighten)
    assert summary.outcome.startswith("aborted: fault elevation_rate")
    assert "elevation_rate_max_deg_s" in summary.outcome and "\n" not in summary.outcome
    assert state is State.FAULT and log.complete
    assert log.metadata["result"]["outcome"] == summary.outcome
    assert any(event["name"] == "fault" and event["level"] == 4 for event in log.events)


def test_a_refused_arming_is_reported_and_nothing_moves(tmp_path: Path) -> None:
    summary, log, state = flown(tmp_path / "a.mcap", prepare=lambda heli: heli.arm())
    assert summary.outcome.startswith("aborted: the board refused arm")
    assert state is State.IDLE and not log.ticks["front_volt"].any()


def test_ctrl_c_lands(tmp_path: Path) -> None:
    summary, log, state = flown(tmp_path / "a.mcap", on_progress=raising(KeyboardInterrupt(), 4.0))
    assert summary.outcome == "aborted: Ctrl-C"
    assert state is State.IDLE and log.complete
    assert any("touchdown" in event["message"] for event in log.events)


def test_a_second_ctrl_c_stops_the_motors_at_once(tmp_path: Path) -> None:
    summary, log, state = flown(tmp_path / "a.mcap", on_progress=raising(KeyboardInterrupt(), 4.0, 4.5))
    assert summary.outcome == "aborted: Ctrl-C; Ctrl-C again, motors stopped in the air"
    assert state is State.IDLE and log.complete
    assert any("because of stop" in event["message"] for event in log.events)
    assert log.ticks["t_s"][-1] < 6.5


def interrupts(log: Log) -> list[str]:
    return [event["message"] for event in log.events if event["name"] == "interrupt"]


def test_a_third_ctrl_c_neither_keeps_the_motors_running_nor_is_it_forgotten(tmp_path: Path) -> None:
    def interrupted_stop(heli: Heli) -> None:
        stop = heli.flying.stop

        def stop_between_two() -> None:
            signal.raise_signal(signal.SIGINT)
            stop()
            signal.raise_signal(signal.SIGINT)

        heli.flying.stop = stop_between_two  # type: ignore[method-assign]

    before = signal.getsignal(signal.SIGINT)
    summary, log, state = flown(
        tmp_path / "a.mcap", on_progress=signalling(4.0, 4.5), prepare=interrupted_stop
    )
    assert signal.getsignal(signal.SIGINT) == before
    assert summary.outcome == "aborted: Ctrl-C; Ctrl-C again, motors stopped in the air"
    assert state is State.IDLE and log.complete
    assert interrupts(log) == [
        "Ctrl-C: the flight ends in a landing",
        "Ctrl-C again, motors stopped in the air",
        "Ctrl-C again, after the stop of the motors was sent",
        "Ctrl-C again, after the stop of the motors was sent",
    ]
    assert log.ticks["t_s"][-1] < 6.5


def test_a_ctrl_c_while_the_plan_lands_stops_the_motors_and_says_when(tmp_path: Path) -> None:
    duration_s = short().route.duration_s
    summary, log, state = flown(tmp_path / "a.mcap", on_progress=signalling(duration_s + 7.0))
    assert summary.outcome == "aborted: Ctrl-C while landing, motors stopped in the air"
    assert interrupts(log) == ["Ctrl-C while landing, motors stopped in the air"]
    assert state is State.IDLE and log.complete


@pytest.mark.parametrize(
    ("at_s", "outcome"), [(4.0, "ZeroDivisionError"), (short().route.duration_s + 7.0, "completed")]
)
def test_an_error_of_the_callers_own_comes_back_when_the_arm_is_down(
    heli: Heli, tmp_path: Path, at_s: float, outcome: str
) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(ZeroDivisionError):
        fly(heli, short(), log_path=path, on_progress=raising(ZeroDivisionError(), at_s))
    assert heli.state is State.IDLE
    assert heli.latest.elevation_deg < -20.0
    log = read_log(path)
    assert log.complete and outcome in log.metadata["result"]["outcome"]
    assert any("touchdown" in event["message"] for event in log.events)


def test_a_short_unplug_is_flown_through(tmp_path: Path) -> None:
    summary, log, _ = flown(tmp_path / "a.mcap", options="&unplug=7:0.3")
    assert summary.completed and summary.link["reconnects"] == 1
    assert 200 < summary.ticks_lost < 1000
    assert summary.ticks_lost == log.ticks_lost
    assert {"link_lost", "link_restored"} <= {event["name"] for event in log.events}
    assert np.all(np.diff(log.ticks["t_s"]) > 0)


def test_after_a_long_unplug_the_board_has_landed_and_the_log_goes_on(tmp_path: Path) -> None:
    summary, log, state = flown(tmp_path / "a.mcap", options="&unplug=7:9")
    assert summary.outcome.startswith("aborted: the board went to state")
    assert "after the link was lost" in summary.outcome
    assert state is State.IDLE and log.ticks["t_s"][-1] > 16.0


def test_a_host_suspended_while_it_closes_the_loops_reports_the_landing(tmp_path: Path) -> None:
    def suspended(heli: Heli) -> None:
        control = heli.control

        def control_then_nothing(axes: Axes) -> None:
            control(axes)
            heli.session.permit_streams(lambda: False)
            heli.session.wait_for(lambda: False, 4.0)
            heli.session.permit_streams(lambda: True)

        heli.control = control_then_nothing  # type: ignore[method-assign, assignment]

    summary, _, _ = flown(tmp_path / "a.mcap", prepare=suspended)
    assert "because of stale_land" in summary.outcome


def test_a_host_suspended_between_arming_and_control_reports_the_boards_reason(tmp_path: Path) -> None:
    def suspended(heli: Heli) -> None:
        arm = heli.arm

        def arm_then_nothing() -> None:
            arm()
            world_of(heli).advance(4000)

        heli.arm = arm_then_nothing  # type: ignore[method-assign]

    summary, _, _ = flown(tmp_path / "a.mcap", prepare=suspended)
    assert summary.outcome.startswith("aborted: the board went to state idle, because of stale_land")


def test_a_landing_whose_event_is_lost_is_not_said_to_come_from_its_touchdown(
    heli: Heli, tmp_path: Path
) -> None:
    was_suspended = False

    def suspended(progress: Progress) -> None:
        nonlocal was_suspended
        if progress.t_s > 5.0 and not was_suspended:
            was_suspended = True
            world_of(heli).advance(7000)

    heli.session.permit_streams(lambda: not was_suspended)
    summary = fly(heli, short(), log_path=tmp_path / "a.mcap", on_progress=suspended)
    assert "because of stale_land" in summary.outcome and "touchdown" not in summary.outcome


def test_a_host_suspended_behind_the_plans_end_reports_the_boards_landing(
    heli: Heli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def suspended(monitor: TrackingMonitor) -> str:
        heli.session.permit_streams(lambda: False)
        heli.session.wait_for(lambda: False, 4.0)
        return ""

    monkeypatch.setattr(TrackingMonitor, "verdict", suspended)
    summary = fly(heli, short(), log_path=tmp_path / "a.mcap")
    assert summary.outcome == "aborted: the board went to state idle (state landing, because of stale_land)"


def test_a_link_that_stays_lost_is_the_outcome_and_the_log_is_closed(tmp_path: Path) -> None:
    summary, log, _ = flown(tmp_path / "a.mcap", options="&unplug=7:900", reconnect_timeout_s=3.0)
    assert summary.outcome.startswith("link lost:") and "lands by itself" in summary.outcome
    assert log.complete and 6.0 < log.ticks["t_s"][-1] < 8.0


def test_a_noisy_line_costs_ticks_that_are_all_counted(tmp_path: Path) -> None:
    summary, log, _ = flown(tmp_path / "a.mcap", options="&flip=3e-5")
    assert summary.completed
    assert summary.link["frames_bad"] > 0 and summary.ticks_lost > 0
    ticks = log.ticks["tick"].astype(np.int64)
    assert summary.ticks_lost == ticks[-1] - ticks[0] + 1 - len(ticks)
    with pytest.raises(Exception, match="gaps"):
        read_flight(tmp_path / "a.mcap")


def test_setpoints_go_on_by_the_clock_while_samples_do_not_come(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = RouteStream.take_ticks

    def deaf(self: RouteStream, ticks: Ticks) -> None:
        if not 6000 < int(ticks.tick[-1]) < 9000:
            take(self, ticks)

    monkeypatch.setattr(RouteStream, "take_ticks", deaf)
    with connect("sil://?seed=3", keep_alive=False) as heli:
        summary = fly(heli, short(), log_path=tmp_path / "a.mcap")
    assert summary.completed
    assert not [event for event in summary.events if event["name"] == "setpoint_stale"]


def test_without_a_log_path_nothing_is_left(
    heli: Heli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    summary = fly(heli, short())
    assert summary.completed and summary.ticks_logged > 10_000 and summary.log == ""
    assert list(tmp_path.iterdir()) == []


def test_a_recorder_without_a_plan_takes_what_comes(heli: Heli, tmp_path: Path) -> None:
    with Recorder(heli, tmp_path / "a.mcap", rig_name="bench") as recorder:
        heli.take_off()
        recorder.note("remark", "by hand")
        heli.params["hover_V"] = 1.5
        heli.land()
    assert recorder.counters.ticks_lost == 0
    log = read_log(tmp_path / "a.mcap")
    assert log.complete and log.metadata["result"]["outcome"] == "recorded"
    assert log.metadata["parameters_changed"] == {"hover_V": "1.5"}
    assert len(log.ticks) == recorder.counters.ticks_logged
    assert "by hand" in [event["message"] for event in log.events]


def test_over_a_pseudo_terminal_it_flies_the_same(heli_at_a_port: Heli, tmp_path: Path) -> None:
    received: list[Progress] = []
    summary = fly(heli_at_a_port, short(), log_path=tmp_path / "a.mcap", on_progress=received.append)
    assert heli_at_a_port.state is State.IDLE
    assert summary.completed and summary.ticks_lost == 0
    assert {"take-off", "short", "landing"} <= {progress.phase for progress in received}


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="skipped: kill -9 is POSIX")
def test_after_kill_9_of_the_host_the_board_lands_and_the_log_opens(tmp_path: Path) -> None:
    process = pytest.importorskip("heli_sim.sil.transport", reason="skipped: no simulation")
    path = tmp_path / "killed.mcap"
    script = (
        "import sys\n"
        "from heli_host.fly.connection import connect\n"
        "from heli_host.fly.runner import fly\n"
        "with connect(sys.argv[1]) as heli:\n"
        f"    heli.params.restore({SOON_LANDING})\n"
        "    fly(heli, 'hover', log_path=sys.argv[2], on_progress=lambda p: print(p.t_s, flush=True))\n"
    )
    with process.SilProcess(speed=None) as sil:
        host = subprocess.Popen(
            [sys.executable, "-c", script, sil.url, str(path)], stdout=subprocess.PIPE, text=True
        )
        assert host.stdout is not None
        while float(host.stdout.readline()) < 8.0:
            pass
        host.send_signal(signal.SIGKILL)
        host.wait()
        with connect(sil.url) as heli:
            # Each answer lets some simulated time pass: this is faster than to wait in real time.
            while heli.state is not State.IDLE:
                assert heli.session.status().tick < 120_000, heli.state
            assert heli.latest.elevation_deg < -20.0
    log = read_log(path)
    assert not log.complete and log.notes
    assert log.ticks["t_s"][-1] > 7.0 and log.ticks_lost == 0
