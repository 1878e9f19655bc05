"""Stalls stop the processes of a command for a while, and change nothing else."""

from __future__ import annotations

import sys

import pytest

from tests.running.stalls import run

pytestmark = [
    pytest.mark.medium,
    pytest.mark.skipif(sys.platform != "linux", reason="skipped: reads /proc, which is of Linux"),
]
# A process that ends once it went on after two stalls.
IS_STALLED_TWICE = """
import signal, time
continued = []
signal.signal(signal.SIGCONT, lambda *_: continued.append(True))
while len(continued) < 2:
    time.sleep(0.01)
raise SystemExit(7)
"""
IN_A_CHILD = """
import subprocess, sys
sys.exit(subprocess.run([sys.executable, "-c", sys.argv[1]]).returncode)
"""


def test_a_command_is_stalled_and_its_exit_status_is_reported() -> None:
    status, stalls = run(1, [sys.executable, "-c", IS_STALLED_TWICE])
    assert status == 7 and stalls >= 2


def test_a_child_of_a_command_is_stalled_too() -> None:
    assert run(1, [sys.executable, "-c", IN_A_CHILD, IS_STALLED_TWICE])[0] == 7
