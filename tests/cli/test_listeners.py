"""No verb listens beyond this machine, unless it is given another address."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from heli_host.ui.cli.verb import installed_verbs

from tests.cli.listeners import listeners
from tests.cli.terminal import PATIENCE_S, command

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="skipped: reads Linux's tables of sockets"),
]

CAMPAIGN = """
work = "tests.campaign.works:count"
[cases]
number = [1, 2]
nap_s = 600.0
log = "began.txt"
"""


@dataclass(frozen=True)
class Started:
    """A command that goes on until it is ended.

    Parameters
    ----------
    arguments : tuple of str
        Words behind ``heli-host``.
    ready : str
        A file or a word of its output that shows that all of it runs.
    count : int
        Places at which it listens.
    """

    arguments: tuple[str, ...]
    ready: str
    count: int


STARTED = {
    "dashboard": Started(("dashboard", "--sil", "--twin", "makki2024"), "programs join", 1),
    "sil over TCP": Started(("sil", "--tcp", ":0"), "socket://127.0.0.1", 1),
    "sil over RFC 2217": Started(("sil", "--rfc2217", "127.0.0.1:0"), "rfc2217://127.0.0.1", 1),
    "sil behind a terminal": Started(("sil", "--pty", "./due"), "Ctrl-C ends it", 0),
    "campaign": Started(("campaign", "campaign.toml", "--output", "out"), "began.txt", 2),
    "fly": Started(("fly", "hover", "--sil", "--twin", "makki2024", "--log", "f.mcap"), "f.mcap", 0),
    "record": Started(("record", "--sil", "--duration", "600", "--output", "g.mcap"), "g.mcap", 0),
}
ENDED = {
    *(
        "benchmark",
        "calibrate",
        "class",
        "course",
        "diagnose",
        "doctor",
        "export",
        "flash",
        "identify",
        "import",
        "info",
        "law",
        "motors",
        "paper",
    ),
    *("params", "plot", "pool", "ports", "rig", "setpoint", "tune", "twin", "watch"),
}
"""Verbs that serve nobody: they read and write files, or talk to a board as `fly` and `record` do."""


@contextmanager
def running(folder: Path, started: Started) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command until the block ends, from the moment on when all of it runs."""
    output = folder / "output.txt"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    with output.open("wb") as file:
        process = subprocess.Popen(
            command(*started.arguments),
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        end_s = time.monotonic() + PATIENCE_S
        while started.ready not in output.read_text() and not (folder / started.ready).exists():
            assert process.poll() is None and time.monotonic() < end_s, output.read_text()
            time.sleep(0.02)
        assert process.poll() is None, output.read_text()
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.parametrize("name", STARTED)
def test_no_verb_listens_beyond_loopback(tmp_path: Path, name: str) -> None:
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    with running(tmp_path, STARTED[name]) as process:
        addresses = listeners(process.pid)
    assert len(addresses) == STARTED[name].count, addresses
    assert all(address.is_loopback for address, _ in addresses), addresses


def test_every_verb_is_run_here_or_serves_nobody() -> None:
    assert ENDED | {started.arguments[0] for started in STARTED.values()} == set(installed_verbs())


@pytest.mark.parametrize(("family", "host"), [(socket.AF_INET, "0.0.0.0"), (socket.AF_INET6, "::")])
def test_a_listener_on_every_interface_is_noticed(family: socket.AddressFamily, host: str) -> None:
    with socket.socket(family) as listening:
        listening.bind((host, 0))
        listening.listen()
        addresses = listeners(os.getpid())
        port = listening.getsockname()[1]
    assert [str(address) for address, number in addresses if number == port] == [host]
