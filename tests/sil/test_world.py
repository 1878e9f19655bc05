"""The simulated board behaves like a board; clocks, transport in process, and in a process of its own."""

import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.errors import LinkLost, PortError
from heli_host.link.clock import ClockEstimate, ClockFit
from heli_host.link.frames import FrameParser
from heli_host.link.telemetry import TelemetryDecoder
from heli_host.link.transport import Transport, open_transport
from heli_sim import _native
from heli_sim.errors import EndpointError, OptionError, RigError
from heli_sim.model import PaperModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.server import Clock, LockstepClock, TimedClock, make_clock
from heli_sim.sil.transport import SilProcess
from heli_sim.sil.world import SilWorld

from tests.channels.groups import COUNTS
from tests.sil.harness import Host, hello_frame, world, world_of


@pytest.mark.medium
@pytest.mark.parametrize(
    ("asked_V", "acts_V"),
    [
        (0.0, 0.0),
        (0.6, 0.0),  # 5 % duty: swallowed by the switching delays
        (0.8, 0.8),
        (1.7, 1.7),
        (10.0, 10.0),
    ],
)
def test_drivers_swallow_duties_below_their_dead_band(asked_V: float, acts_V: float) -> None:
    host = Host()
    host.drive(asked_V, 1.2)
    # Steps of the duty are 12 V / 2100.
    assert host.world.native.volts_V == pytest.approx([acts_V, 1.2], abs=0.006)


@pytest.mark.medium
def test_a_duty_near_one_is_simply_on() -> None:
    rig = load_rig("makki2024").replace(driver_dead_band=0.2)
    host = Host(SilWorld(SilOptions(), Plant(PaperModel(), rig)))
    host.drive(9.8, 9.4)
    assert host.world.native.volts_V == pytest.approx([12.0, 9.4], abs=0.006)


@pytest.mark.medium
def test_the_supply_of_the_rig_scales_what_acts() -> None:
    rig = load_rig("makki2024").replace(supply=6.0)
    host = Host(SilWorld(SilOptions(), Plant(PaperModel(), rig)))
    host.hello()
    # The board starts with the supply of its rig; this one is set to another.
    assert host.order(d.ParamSetMessage, d.Param.SUPPLY_V, 12.0).result == d.Result.OK
    host.drive(3.0, 2.0)
    assert host.world.native.volts_V == pytest.approx([1.5, 1.0], abs=0.003)


@pytest.mark.medium
def test_the_rest_position_is_the_table_and_encoders_start_anywhere() -> None:
    counts = [world(seed=str(seed)).native.counts for seed in (1, 2)]
    assert counts[0] != counts[1]
    assert world(seed="1").native.counts == counts[0]
    assert world().state[:3] == pytest.approx([np.deg2rad(-25.0), 0.0, 0.0])


@pytest.mark.medium
def test_a_reset_in_flight_stops_the_motors_at_once_and_the_board_is_back_after_205_ms() -> None:
    host = Host()
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V == pytest.approx([1.9, 1.9], abs=0.006)
    before = host.hello()
    host.world.reset_board()
    assert host.world.board.sim.in_reset
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]
    host.wait(203)
    assert host.world.board.sim.in_reset
    host.wait(2)
    assert not host.world.board.sim.in_reset
    welcome = Host(host.world).hello()
    assert welcome.reset == d.Reset.USER
    assert welcome.boot_id != before.boot_id


@pytest.mark.medium
def test_bytes_sent_to_a_board_in_reset_are_not_heard() -> None:
    host = Host()
    host.world.reset_board()
    with pytest.raises(AssertionError, match="no answer"):
        host.hello()
    host.wait(150)
    assert host.hello().reset == d.Reset.USER


@pytest.mark.medium
def test_encoder_counters_restart_at_a_reset() -> None:
    pushed = world()
    board = pushed.board.sim
    assert isinstance(board, _native.NativeBoard)
    pushed.state = np.array([0.1, 0.05, 0.3, 0, 0, 0])
    pushed.native.locked = [True] * 3
    pushed.advance(1)
    assert board.counts == pushed.native.counts
    pushed.reset_board()
    pushed.advance(300)
    assert board.counts == [0, 0, 0]


@pytest.mark.medium
def test_a_pinned_axis_does_not_move_while_the_others_fly() -> None:
    host = Host()
    host.drive(2.6, 2.1)
    host.world.native.locked = [False, True, False]
    host.wait(450)
    state = host.world.state
    assert (state[1], state[4]) == (0.0, 0.0)
    assert state[0] > np.deg2rad(-24.0)


@pytest.mark.medium
def test_what_the_board_reports_are_the_true_angles_to_one_count() -> None:
    host = Host()
    host.hello()
    angles_rad = np.array([0.2, -0.3, 1.1])
    host.world.state = np.concatenate([angles_rad, np.zeros(3)])
    host.world.native.locked = [True] * 3
    host.wait(100)
    host.frames.clear()
    host.wait(100)
    batches = [frame.payload for frame in host.frames if frame.id == d.MessageId.TELEMETRY]
    raw = TelemetryDecoder().decode(batches).raw[:, COUNTS]
    assert np.abs(raw - angles_rad * 4096 / (2 * np.pi)).max() <= 1.0


@pytest.mark.medium
def test_flash_can_be_taken_out_and_put_back() -> None:
    first, second = Host(), Host()
    first.hello()
    first.order(d.ParamSetMessage, d.Param.HOVER_V, 1.25)
    first.order(d.ParamsSaveMessage)
    board, other = first.world.board.sim, second.world.board.sim
    assert isinstance(board, _native.NativeBoard)
    assert isinstance(other, _native.NativeBoard)
    other.flash = board.flash
    assert second.hello().params_source == d.ParamsSource.STORED
    with pytest.raises(ValueError, match="flash holds"):
        other.flash = b""


@pytest.mark.medium
def test_a_board_that_counts_edges_agrees_with_the_encoders_every_millisecond() -> None:
    plant = Plant(PaperModel(), load_rig("makki2024"))
    swinging = [0.3, 0.6, 0.1, 0.2, -1.0, 0.8]
    board = _native.NativeBoard(from_edges=True)
    native = _native.World(
        plant.native_step(),
        swinging,
        plant.parameters.tolist(),
        supply_V=12.0,
        dead_band=0.06,
        counts_per_rad=[4096 / (2 * np.pi)] * 3,
        offset_count=[123.4, -55.5, 0.9],
        board=board,
    )
    start = np.array(native.counts)
    moved = 0
    for _ in range(3000):
        native.advance(1, b"")
        turned = np.array(native.counts) - start
        assert board.counts == turned.tolist()
        moved = max(moved, int(np.abs(turned).max()))
    assert moved > 300


def run(clock: Clock, until_s: float, tick: int = 0, start_s: float = 0.0, late_s: float = 0.0) -> int:
    """Ask as a server does, waking up late each time; the tick reached."""
    now_s = start_s
    while now_s < until_s:
        ticks = clock.ticks_due(now_s, tick)
        tick += ticks
        if ticks == 0:
            now_s += max(clock.wait_s(now_s, tick), 1e-9) + late_s
    return tick


@pytest.mark.medium
@pytest.mark.parametrize("speed", [0.5, 1.0, 3.0, 50.0])
@pytest.mark.parametrize("late_s", [0.0, 0.0013])
def test_a_timed_clock_does_not_drift_however_late_it_wakes(speed: float, late_s: float) -> None:
    slice_ticks = max(4, min(20, round(4 * speed)))
    assert run(TimedClock(speed), 60.0, late_s=late_s) == pytest.approx(
        60_000 * speed, abs=2 * slice_ticks + 1300 * speed * 1e-3
    )


def test_real_time_wakes_up_every_4_ms() -> None:
    clock = TimedClock(1.0)
    assert clock.ticks_due(10.0, 0) == 0
    assert clock.wait_s(10.0, 0) == pytest.approx(0.004)
    assert clock.ticks_due(10.0041, 0) == 4
    assert clock.wait_s(10.0041, 4) == pytest.approx(0.0039)


def test_a_short_hold_up_is_caught_up_and_a_long_one_is_given_up() -> None:
    clock = TimedClock(1.0)
    tick = run(clock, 1.0)
    tick = run(clock, 2.0, tick, start_s=1.3)
    assert tick == pytest.approx(2000, abs=8)
    assert clock.slipped_s == 0.0
    tick = run(clock, 102.0, tick, start_s=101.0)
    assert tick == pytest.approx(3000, abs=8)
    assert clock.slipped_s == pytest.approx(99.0, abs=0.01)


def test_lockstep_runs_40_ms_ahead_of_the_host_and_no_further() -> None:
    clock = LockstepClock()
    tick = 0
    while ticks := clock.ticks_due(5.0, tick):
        tick += ticks
    assert tick == 40
    assert clock.ticks_due(5.0, tick) == 0
    clock.heard(5.0, tick)
    while ticks := clock.ticks_due(5.0, tick):
        tick += ticks
    assert tick == 80


def test_lockstep_simulates_at_most_20_ms_in_one_slice() -> None:
    clock = LockstepClock()
    assert [clock.ticks_due(5.0, tick) for tick in (0, 20, 37)] == [20, 20, 0]
    assert clock.ticks_due(7.0, 20) == 20


def test_lockstep_never_runs_slower_than_real_time() -> None:
    clock = LockstepClock()
    assert run(clock, 5.0) == pytest.approx(5040, abs=4)


def test_lockstep_waits_no_longer_than_real_time_needs() -> None:
    clock = LockstepClock()
    tick = 0
    while ticks := clock.ticks_due(0.0, tick):
        tick += ticks
    assert clock.wait_s(0.0, tick) == pytest.approx(0.004)


def test_after_a_silence_the_window_counts_from_the_next_byte() -> None:
    clock = LockstepClock()
    tick = run(clock, 3.0)
    clock.heard(3.0, tick)
    assert run(clock, 3.0 + 1e-6, tick, start_s=3.0) == tick + 40


def test_only_lockstep_follows_the_host() -> None:
    assert make_clock(None).follows_host
    assert not make_clock(2.0).follows_host


def conversation(url: str, step_s: float = 0.02, until_s: float = 2.0) -> bytes:
    transport = open_transport(url)
    transport.write(hello_frame())
    received = b""
    while transport.now_s() < until_s:
        received += transport.read(step_s)
    return received


@pytest.mark.medium
def test_heli_host_finds_the_simulation_by_its_address() -> None:
    transport = open_transport("sil://?seed=4")
    assert isinstance(transport, Transport)
    assert isinstance(transport, InProcessTransport)
    assert transport.lockstep
    assert transport.url == "sil://?seed=4"


@pytest.mark.medium
def test_the_same_seed_gives_the_same_bytes() -> None:
    url = "sil://?seed=5&flip=1e-4&drop=1e-3&double=1e-3&stall=0.5:0.2"
    assert conversation(url) == conversation(url)
    assert len(conversation(url)) > 1000


@pytest.mark.medium
def test_another_seed_gives_other_faults() -> None:
    assert conversation("sil://?seed=5&flip=1e-3") != conversation("sil://?seed=6&flip=1e-3")


@pytest.mark.medium
def test_time_stands_still_between_reads_and_the_date_follows_it() -> None:
    transport = open_transport("sil://")
    assert (transport.now_s(), transport.now_s()) == (0.0, 0.0)
    start_ns = transport.wall_ns()
    transport.read(0.25)
    assert transport.now_s() == pytest.approx(0.25)
    assert transport.wall_ns() - start_ns == 250_000_000


@pytest.mark.medium
def test_a_read_returns_when_bytes_come_but_not_before_its_slice() -> None:
    transport = open_transport("sil://?slice_ms=20")
    transport.write(hello_frame())
    received = transport.read(5.0)
    assert received
    assert 0.02 <= transport.now_s() < 0.1


@pytest.mark.medium
def test_the_smallest_read_lets_a_millisecond_pass() -> None:
    transport = open_transport("sil://")
    transport.read(0.0)
    assert transport.now_s() == pytest.approx(0.001)


@pytest.mark.medium
def test_frames_come_out_whole() -> None:
    parser = FrameParser()
    parser.feed(conversation("sil://?seed=1"))
    assert (parser.frames_bad, parser.bytes_dropped) == (0, 0)
    assert parser.frames_ok > 90


@pytest.mark.medium
def test_a_closed_transport_is_lost() -> None:
    transport = open_transport("sil://")
    transport.close()
    transport.close()
    with pytest.raises(LinkLost):
        transport.read(0.1)
    with pytest.raises(LinkLost):
        transport.write(b"x")


@pytest.mark.medium
def test_pulling_the_cable_loses_the_link_until_it_is_back_and_the_board_flies_on() -> None:
    flown = world(unplug="0.5:0.45")
    lost = InProcessTransport(flown)
    with pytest.raises(LinkLost):
        while True:
            lost.read(0.02)
    assert flown.tick == 500
    refused = 0
    while refused < 20:
        try:
            transport = lost.reopen()
            break
        except PortError:
            refused += 1
    assert refused == 5
    transport.write(hello_frame())
    assert transport.read(0.1)
    assert flown.board.sim.boots == 1


@pytest.mark.medium
def test_opening_resets_the_board_when_asked_to() -> None:
    flown = world(reset_on_open="1")
    flown.advance(100)
    InProcessTransport(flown).read(0.3)
    assert flown.board.sim.boots == 2


@pytest.mark.medium
@pytest.mark.parametrize(("url", "error"), [("sil://?rig=none", RigError), ("sil://?x=1", OptionError)])
def test_a_wrong_address_is_refused(url: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        open_transport(url)


# Only how long a failing test takes.
PATIENCE_s = 120.0


def has_ended(pid: int) -> bool:
    """Wait for the end of a process that is not a child of this one."""
    try:
        fd = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    ready, _, _ = select.select([fd], [], [], PATIENCE_s)
    os.close(fd)
    return bool(ready)


@pytest.mark.medium
@pytest.mark.parametrize("speed", [None, 20.0])
def test_a_host_talks_to_it_as_to_hardware(speed: float | None) -> None:
    with SilProcess(speed=speed, seed=2) as sil:
        transport = open_transport(sil.url)
        transport.write(hello_frame())
        parser, kinds = FrameParser(), set()
        while d.MessageId.TELEMETRY not in kinds:
            kinds |= {frame.id for frame in parser.feed(transport.read(PATIENCE_s))}
        assert d.MessageId.WELCOME in kinds
        assert not transport.lockstep
        transport.close()
        link = Path(sil.url)
    assert not link.is_symlink()
    assert sil.counters["to_board_bytes"] > 0
    assert sil.counters["ticks"] > 0


@pytest.mark.medium
def test_lockstep_waits_for_a_host_that_says_nothing() -> None:
    began_s = time.monotonic()
    with SilProcess(speed=None) as sil:
        transport = open_transport(sil.url)
        transport.write(hello_frame())
        parser, ticks = FrameParser(), 0
        while not ticks:
            ticks += sum(frame.id == d.MessageId.TELEMETRY for frame in parser.feed(transport.read(0.05)))
        transport.close()
    # Without a host, simulated time is real time, and one frame allows 40 ms more. Unbounded, the simulation
    # makes hundreds of thousands of ticks a second.
    assert sil.counters["ticks"] <= 1e3 * (time.monotonic() - began_s) + 2 * 40


@pytest.mark.medium
def test_it_ends_when_the_process_that_started_it_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "due"
    code = (
        "import time; from heli_sim.sil.transport import SilProcess\n"
        f"sil = SilProcess(speed=1.0, pty={str(path)!r}); print(sil.pid, flush=True); time.sleep(60)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    assert path.is_symlink()
    parent.kill()
    parent.wait()
    assert has_ended(child)
    assert not path.is_symlink()


@pytest.mark.medium
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_server_that_is_ended_takes_its_port_away(tmp_path: Path, number: signal.Signals) -> None:
    path = tmp_path / "due"
    server = subprocess.Popen(
        [sys.executable, "-m", "heli_sim.sil.server", "--pty", str(path), "--options", "speed=1"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    assert str(path) in server.stdout.readline()
    server.send_signal(number)
    assert server.wait(PATIENCE_s) == 0
    assert "counters" in server.stdout.read()
    assert not path.is_symlink()


@pytest.mark.medium
def test_a_board_that_cannot_start_says_why_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(EndpointError, match="unknown rig 'nosuchrig'") as error:
        SilProcess(rig="nosuchrig")
    assert "\n" not in str(error.value)
    with pytest.raises(EndpointError, match="colour"):
        SilProcess(options={"colour": "red"})


@pytest.mark.medium
def test_stopping_twice_is_harmless() -> None:
    sil = SilProcess(speed=1.0)
    sil.stop()
    sil.stop()
    assert not Path(sil.url).is_symlink()


@pytest.mark.medium
def test_a_clock_that_seems_to_race_does_not_flood_the_board(monkeypatch: pytest.MonkeyPatch) -> None:
    # Result of the fit when a port that was read slowly delivers all waiting bytes.
    racing = ClockEstimate(0, 0.0, 1e-9, 0.0, 0.0)
    sent: Counter[int] = Counter()
    with heli_host.connect("sil://?seed=3&speed=max") as heli:
        heli.arm()
        heli.control(d.Axes.ELEVATION | d.Axes.PITCH | d.Axes.TRAVEL)
        to_board, parser = world_of(heli).to_board, FrameParser()
        carry = to_board.pass_through

        def count(data: bytes) -> bytes:
            sent.update(frame.id for frame in parser.feed(data))
            return carry(data)

        monkeypatch.setattr(to_board, "pass_through", count)
        monkeypatch.setattr(ClockFit, "estimate", lambda fit: racing)
        heli.session.wait_for(lambda: False, 1.0, step_s=0.002)
    assert 8 <= sent[d.MessageId.SETPOINT] <= 25
    assert sent[d.MessageId.PING] <= 25
