"""Verbs for the bench: `watch` moves nothing, `motors` leaves everything off."""

from __future__ import annotations

import contextlib
import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import termios
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.declaration import State
from heli_host.errors import CommandRefused
from heli_host.link.engine import Command
from heli_host.link.session import Session
from heli_host.ui.cli.verbs import board as bench_verbs
from heli_sim.sil.process import SilProcess

from tests.cli.terminal import Process, Terminal, command, process, refusal, until_open
from tests.sil.patient import PATIENT

pytestmark = pytest.mark.medium

ASKED, ABORTED = 2, 4
SIL = ("--sil", "--speed", "max")


def test_watch_shows_counts_angles_and_errors_of_each_axis(terminal: Terminal) -> None:
    result = terminal("watch", *SIL, "--duration", "1")
    assert result.code == 0, result
    first, *lines = result.out.splitlines()
    assert "native board, firmware 0.1.0" in first
    # On the table, at -25 degrees, 284 counts of 4096 below level.
    assert lines[0].startswith("elevation   -284 ( -24.96 deg, 0 bad)  pitch     +0")
    assert lines[0].endswith("front +0.00 V, back +0.00 V  idle")


def test_watch_is_a_table_that_fits_a_terminal_of_80_columns(tmp_path: Path) -> None:
    screen, terminal = pty.openpty()
    fcntl.ioctl(terminal, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    with (
        SilProcess() as board,
        Process(
            command("watch", "--port", board.url, "--duration", "1.5"),
            cwd=tmp_path,
            stdin=subprocess.DEVNULL,
            stdout=terminal,
            stderr=terminal,
            env={**os.environ, "TERM": "xterm", "COLUMNS": "80"},
        ) as running,
    ):
        os.close(terminal)
        shown = b""
        with contextlib.suppress(OSError):  # how a terminal ends whose program has gone
            while piece := os.read(screen, 65536):
                shown += piece
        assert running.wait() == 0
    os.close(screen)
    text = re.sub(r"\x1b\[[\d;?]*[A-Za-z]", "", shown.decode())
    lines = re.split(r"[\r\n]+", text)
    tables = [line for line in lines if line.startswith(("elevation", "pitch", "travel", "front", "link"))]
    assert "is" in text
    assert "bad edges" in text
    assert len(tables) >= 5
    assert max(map(len, lines[1:])) <= 79


def test_watch_commands_nothing(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_session: Session, command: Command, timeout_s: float = 0.0) -> None:
        raise AssertionError(f"watch commanded {command}")

    monkeypatch.setattr(Session, "command", refuse)
    monkeypatch.setattr(Session, "stream", refuse)
    # Its own session ends in stop(), but only where the motors may run.
    assert terminal("watch", *SIL, "--duration", "1").code == 0


def test_motors_get_the_voltage_for_the_time_and_are_off_afterwards() -> None:
    with heli_host.connect("sil://?speed=max") as heli:
        heli.arm()
        bench_verbs._apply_voltages(heli, 1.0, 0.5, 1.0)
        heli.stop()
        heli.wait(0.1)
        flown = heli.samples()
        acted = flown.state == State.OPEN_LOOP
        assert 0.9 <= np.count_nonzero(acted) * 1e-3 <= 1.3
        # The board's own filter takes a while to get there.
        assert flown.front_V[acted][-1] == pytest.approx(1.0, abs=0.05)
        assert flown.back_V[acted][-1] == pytest.approx(0.5, abs=0.03)
        assert flown.state[-1] == State.IDLE
        assert flown.front_V[-1] == 0.0


def test_motors_without_a_voltage_only_enable(terminal: Terminal) -> None:
    result = terminal("motors", *SIL, "--duration", "1")
    assert result.code == 0, result
    assert "drivers off again" in result.out


def test_motors_refuse_a_voltage_beyond_the_limits_and_enable_nothing(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    armed: list[Heli] = []
    monkeypatch.setattr(Heli, "arm", armed.append)
    assert "motor_max_V" in refusal(terminal("motors", *SIL, "--front-V", "50"), code=ASKED)
    assert armed == []


def test_motors_that_the_board_switches_off_say_why(terminal: Terminal) -> None:
    # Back motor alone: the short arm turns over.
    line = refusal(terminal("motors", *SIL, "--back-V", "6", "--duration", "10"), code=ABORTED)
    assert "pitch" in line


@pytest.mark.slow
def test_ctrl_c_switches_the_motors_off(tmp_path: Path) -> None:
    with SilProcess() as board:
        with heli_host.connect(board.url) as heli:
            heli.params.restore(PATIENT)
        with process(tmp_path, "motors", "--port", board.url, "--duration", "30") as running:
            until_open(running, board.url)
            with pytest.raises(subprocess.TimeoutExpired):
                running.wait(timeout=1.0)
            running.send_signal(signal.SIGINT)
            running.communicate(timeout=60.0)
            assert running.returncode == 130
        with heli_host.connect(board.url) as heli:
            assert heli.state is State.IDLE


def test_a_person_at_the_terminal_of_a_served_board_presses_its_stop_switch(tmp_path: Path) -> None:
    keyboard, stdin = pty.openpty()
    with Process(
        command("sil", "--pty", "./due", "--speed", "5"),
        cwd=tmp_path,
        stdin=stdin,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        assert server.stdout is not None
        assert "Ctrl-C ends it" in server.stdout.readline()
        assert "pull elevation|pitch|travel" in server.stdout.readline()
        os.write(keyboard, b"stop\n")
        assert "the stop switch is pressed" in server.stdout.readline()
        with heli_host.connect(str(tmp_path / "due")) as heli:
            with pytest.raises(CommandRefused, match="hardware_stop"):
                heli.arm()
            os.write(keyboard, b"release\n")
            assert "released" in server.stdout.readline()
            heli.arm()
        server.send_signal(signal.SIGINT)
        out, _ = server.communicate(timeout=60)
    for fd in (keyboard, stdin):
        os.close(fd)
    assert server.returncode == 0
    assert "simulated" in out
