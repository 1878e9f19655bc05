"""The disk is not in the control path: whatever it does, the board knows where to fly, and lands in order."""

import errno
import io
import re
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from heli_host.board.heli import Heli
from heli_host.data.log import disk
from heli_host.data.log.disk import BackgroundFile
from heli_host.data.log.reader import read_log
from heli_host.data.log.writer import LogWriter
from heli_host.declaration import State
from heli_host.errors import LogWriteError
from heli_host.fly.connection import connect
from heli_host.fly.pilot import FlightMonitor
from heli_host.fly.recorder import Recorder
from heli_host.fly.runner import fly

from tests.fly.test_runner import SHORT, flown, short

pytestmark = pytest.mark.medium

pytest.importorskip("heli_sim._native", reason="skipped: the simulation is not built")

BLOCKS_S = {4.0: 0.7, 6.0: 2.5, 10.0: 6.0}
"""Simulated time at which the disk blocks, and for how long [s]."""
PATIENCE_S = 60.0
"""How long a failing test waits."""


class BlockingDisk:
    """A disk that blocks in simulated time, which only the thread that flies lets pass."""

    # That thread flies on while the disk blocks. Otherwise it waits until the thread of the log has written
    # everything: how late the machine runs that thread changes nothing.
    # `device_s`: Simulated time [s].

    def __init__(self, device_s: Callable[[], float]) -> None:
        self.due = dict(BLOCKS_S)
        self.files: list[BackgroundFile] = []
        self._device_s = device_s
        self._begin_s = device_s()
        self._until_s: float | None = None

    def write(self) -> None:
        """Block if a block is due; in the thread of the log."""
        now_s = self._device_s()
        at_s = next((at_s for at_s in self.due if now_s - self._begin_s >= at_s), None)
        if at_s is not None:
            self._until_s = until_s = now_s + self.due.pop(at_s)
            wait_until(lambda: self._device_s() >= until_s)
            self._until_s = None

    def catch_up(self) -> None:
        """Wait until the log is on the disk, or the disk blocks; in the thread that flies."""
        wait_until(lambda: self._blocks() or not any(file._queued_bytes for file in self.files))

    def _blocks(self) -> bool:
        until_s = self._until_s
        return until_s is not None and self._device_s() < until_s


def wait_until(so: Callable[[], bool]) -> None:
    """Wait for another thread."""
    give_up_s = time.monotonic() + PATIENCE_S
    while not so():
        assert time.monotonic() < give_up_s, "one thread waits for the other in vain"
        time.sleep(0.0005)


def test_a_disk_that_blocks_for_seconds_is_not_noticed_by_the_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = short(SHORT.replace('kind = "hold"\nduration_s = 2', 'kind = "hold"\nduration_s = 10'))
    with connect("sil://?seed=3&speed=max") as heli:

        def device_s() -> float:
            newest = heli.session.latest
            return 1e-3 * newest.tick if newest is not None else 0.0

        blocking = BlockingDisk(device_s)

        class Disk(io.FileIO):
            def write(self, data: object) -> int:
                blocking.write()
                return super().write(data)  # type: ignore[arg-type]

        def in_a_thread(*arguments: Any, **options: Any) -> LogWriter:
            """Write the log as over a port, although the simulation is in lockstep."""
            return LogWriter(*arguments, **{**options, "background": True})

        def on_simulated_time(*arguments: Any, **options: Any) -> BackgroundFile:
            blocking.files.append(BackgroundFile(*arguments, **{**options, "now_s": device_s}))
            return blocking.files[-1]

        monkeypatch.setattr("heli_host.data.log.disk.io.FileIO", Disk)
        monkeypatch.setattr("heli_host.fly.recorder.LogWriter", in_a_thread)
        monkeypatch.setattr("heli_host.data.log.writer.BackgroundFile", on_simulated_time)
        heli.session.subscribe_ticks(lambda _: blocking.catch_up())
        summary = fly(heli, plan, log_path=tmp_path / "a.mcap")
        assert heli.state is State.IDLE
    assert not blocking.due and summary.completed, summary.outcome
    log = read_log(tmp_path / "a.mcap")
    assert log.complete and summary.ticks_lost == log.ticks_lost == 0
    assert State.HOLD not in log.ticks["state"]
    assert not [event for event in log.events if event["name"] == "setpoint_stale"]
    reported_s = [float(s) for s in re.findall(r"the disk blocked for ([\d.]+) s", "\n".join(summary.notes))]
    # Simulated time advances in steps of at most a tenth of a second.
    assert reported_s == pytest.approx(list(BLOCKS_S.values()), abs=0.15)


def test_a_disk_that_fills_during_a_check_is_the_reason_of_the_end() -> None:
    class FailsWhenRead:
        """A recorder that fails at the moment at which the monitor looks whether it has failed."""

        def __init__(self) -> None:
            self.write_error: LogWriteError | None = None

        @property
        def error(self) -> LogWriteError | None:
            self.write_error = LogWriteError("cannot write the log: it is full", "make room")
            return self.write_error

        def check(self) -> None:
            if self.write_error is not None:
                raise self.write_error

    session = SimpleNamespace(state=State.CLOSED_LOOP, counters=SimpleNamespace(restarts=0, reconnects=0))
    heli: Any = SimpleNamespace(session=session)
    recorder: Any = FailsWhenRead()
    monitor = FlightMonitor(heli, recorder, lambda: "")
    monitor.begin()
    with pytest.raises(LogWriteError, match="it is full"):
        monitor.check(1.0)


def disk_of(byte_count: int) -> type[io.FileIO]:
    """Return a class of files on a disk that refuses to write behind so many bytes."""

    class FullDisk(io.FileIO):
        def write(self, data: object) -> int:
            if self.tell() >= byte_count:
                raise OSError(errno.ENOSPC, "No space left on device")
            return super().write(data)  # type: ignore[arg-type]

    return FullDisk


def test_over_a_port_a_full_disk_lands_the_rig_and_is_reported_first(
    heli_at_a_port: Heli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_host.data.log.disk.io.FileIO", disk_of(120_000))
    summary = fly(heli_at_a_port, short(), log_path=tmp_path / "a.mcap")
    assert heli_at_a_port.state is State.IDLE
    assert summary.outcome.startswith("aborted: cannot write the log"), summary.outcome
    assert "No space left on device" in summary.outcome
    log = read_log(tmp_path / "a.mcap")
    assert len(log.ticks) >= 1000 and State.HOLD not in log.ticks["state"]


def test_a_disk_that_gets_full_lands_while_the_log_can_still_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def free_bytes(_: Path) -> int:
        path = tmp_path / "a.mcap"
        return 3_000_000 if path.exists() and path.stat().st_size > 120_000 else 10**9

    monkeypatch.setattr(disk, "free_bytes", free_bytes)
    summary, log, state = flown(tmp_path / "a.mcap")
    assert summary.outcome.startswith("aborted: the disk of the log") and "3.0 MB are left" in summary.outcome
    assert state is State.IDLE and log.complete and log.ticks["state"][-1] == State.IDLE
    assert any("touchdown" in event["message"] for event in log.events)


def test_without_space_for_the_flight_nothing_is_armed(
    heli: Heli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "free_bytes", lambda _: 5_000_000)
    with pytest.raises(LogWriteError, match=r"has 5\.0 MB left"):
        fly(heli, short(), log_path=tmp_path / "a.mcap")
    assert heli.state is State.IDLE
    assert not (tmp_path / "a.mcap").exists()


def test_a_disk_that_takes_not_even_the_beginning_is_reported(
    heli_at_a_port: Heli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_host.data.log.disk.io.FileIO", disk_of(0))
    try:
        outcome = fly(heli_at_a_port, short(), log_path=tmp_path / "a.mcap").outcome
    except LogWriteError as error:
        outcome = f"aborted: {error}"
    assert heli_at_a_port.state is State.IDLE and heli_at_a_port.latest.elevation_deg < -24.0
    assert outcome.startswith("aborted: cannot write the log")


def test_a_recording_by_hand_raises_at_its_end_what_stopped_it(
    heli: Heli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_host.data.log.disk.io.FileIO", disk_of(20_000))

    def record() -> None:
        with Recorder(heli, tmp_path / "a.mcap"):
            heli.wait(5.0)

    with pytest.raises(LogWriteError, match="No space left"):
        record()
