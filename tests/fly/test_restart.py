"""A board that restarts in flight ends that flight, and the two are never taken for one."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import State
from heli_host.fly.plan import Plan
from heli_host.fly.runner import Progress, fly
from heli_host.link.events import BOARD_RESTARTED
from heli_sim.due import firmware
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.transport import SilProcess
from heli_sim.sil.world import SilWorld

pytestmark = pytest.mark.medium

PLAN = Plan.parse('[start]\nsettle_s = 1\n[[segment]]\nkind = "hold"\nduration_s = 6\n', "hover.toml")


def world_of(heli: Heli) -> SilWorld:
    transport = heli.session.transport
    assert isinstance(transport, InProcessTransport)
    return transport.world


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
        summary = fly(heli, PLAN, log_path=path, on_progress=call_once_at(at_s, cut))
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


@pytest.mark.parametrize("at_s", [1.0, 3.0, 6.5])
def test_a_board_that_lost_its_power_in_flight_ends_the_flight(tmp_path: Path, at_s: float) -> None:
    path = tmp_path / "a.mcap"
    summary, landing_timeout_s = flown("sil://?seed=3", path, at_s)
    assert_restart_reported(summary, path)
    assert landing_timeout_s == 12.0


TILTED = Plan.parse(
    'axes = ["elevation", "pitch"]\n[[segment]]\nkind = "step"\npitch_deg = 20\nduration_s = 4\n',
    "tilted.toml",
)


@pytest.mark.parametrize("delay_s", [0.0, 0.3, 1.2, 3.5])
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

        summary = fly(heli, PLAN, on_progress=call_once_at(6.5, cut_at_landing))
    assert summary.outcome.startswith("aborted: the board restarted (power_up) in flight")
    assert "link lost" not in summary.outcome and "lands by itself" not in summary.outcome


@pytest.mark.slow
def test_two_processes_with_the_same_seed_are_two_boards() -> None:
    ids = []
    for _ in range(2):
        with SilProcess(seed=5) as board, heli_host.connect(board.url) as heli:
            ids.append(heli.info.boot_id)
    assert ids[0] != ids[1]
