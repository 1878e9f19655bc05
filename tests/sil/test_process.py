"""A simulated board in its own process: it appears, answers, goes away, and never outlives who started it."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from heli_host.declaration import MessageId
from heli_host.link.frames import FrameParser
from heli_host.link.transport import open_transport
from heli_sim.errors import EndpointError
from heli_sim.sil.process import SilProcess

from tests.sil.harness import hello_frame

pytestmark = pytest.mark.medium

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


@pytest.mark.parametrize("speed", [None, 20.0])
def test_a_host_talks_to_it_as_to_hardware(speed: float | None) -> None:
    with SilProcess(speed=speed, seed=2) as sil:
        transport = open_transport(sil.url)
        transport.write(hello_frame())
        parser, kinds = FrameParser(), set()
        while MessageId.TELEMETRY not in kinds:
            kinds |= {frame.id for frame in parser.feed(transport.read(PATIENCE_s))}
        assert MessageId.WELCOME in kinds
        assert not transport.lockstep
        transport.close()
        link = Path(sil.url)
    assert not link.is_symlink()
    assert sil.counters["to_board_bytes"] > 0
    assert sil.counters["ticks"] > 0


def test_lockstep_waits_for_a_host_that_says_nothing() -> None:
    began_s = time.monotonic()
    with SilProcess(speed=None) as sil:
        transport = open_transport(sil.url)
        transport.write(hello_frame())
        parser, ticks = FrameParser(), 0
        while not ticks:
            ticks += sum(frame.id == MessageId.TELEMETRY for frame in parser.feed(transport.read(0.05)))
        transport.close()
    # Without a host, simulated time is real time, and one frame allows 40 ms more. Unbounded, the simulation
    # makes hundreds of thousands of ticks a second.
    assert sil.counters["ticks"] <= 1e3 * (time.monotonic() - began_s) + 2 * 40


def test_it_ends_when_the_process_that_started_it_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "due"
    code = (
        "import time; from heli_sim.sil.process import SilProcess\n"
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


def test_a_board_that_cannot_start_says_why_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(EndpointError, match="unknown rig 'nosuchrig'") as error:
        SilProcess(rig="nosuchrig")
    assert "\n" not in str(error.value)
    with pytest.raises(EndpointError, match="colour"):
        SilProcess(options={"colour": "red"})


def test_stopping_twice_is_harmless() -> None:
    sil = SilProcess(speed=1.0)
    sil.stop()
    sil.stop()
    assert not Path(sil.url).is_symlink()
