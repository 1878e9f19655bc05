"""Ctrl-C: no traceback while the program loads, and nothing more after the one that ended a flight."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading

import pytest
from heli_host.board.interrupts import Interrupts
from heli_host.ui.cli import entry, run

LOADING = """
import importlib.abc, sys

class Interrupted(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt
        return None

sys.meta_path.insert(0, Interrupted())
from heli_host.ui.cli import main
sys.argv = ["heli-host", "fly", "hover", "--sil"]
main()
"""


@pytest.mark.medium
@pytest.mark.parametrize(
    "module", ["heli_host.ui.cli.entry", "heli_host.ui.cli.verbs.flying", "typer", "heli_host.board.heli"]
)
def test_an_interrupt_while_the_program_loads_is_one_word(module: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", LOADING.format(module=module)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr == "interrupted\n"


def test_a_verb_that_is_interrupted_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("heli_host.link.transport.available_ports", interrupted)
    assert run(["ports"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_signal_after_the_end_of_a_flight_does_not_break_its_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("heli_host.board.interrupts._interrupted", threading.Event())
    before = signal.signal(signal.SIGINT, entry._raise_interrupt)
    try:
        with Interrupts(), pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)
