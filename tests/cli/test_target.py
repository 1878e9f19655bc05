"""Every verb that opens a board names it by ``--port``, ``HELI_PORT`` or ``--sil``."""

from __future__ import annotations

from pathlib import Path

import pytest
import serial
from heli_host.errors import PortError
from heli_host.ui.cli.board import ARDUINO_VIDS, DUE_NATIVE_PID, DUE_PROGRAMMING_PID, check_target
from heli_host.ui.cli.entry import command_line
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

LAW = str(Path(__file__).resolve().parents[2] / "docs/laws/lqr.py")
WORDS = {
    "calibrate": ("--rig", "makki2024"),
    "dashboard": (),
    "fly": ("hover",),
    "law compare": (LAW,),
    "law fly": (LAW,),
    "motors": (),
    "params dump": ("dumped.toml",),
    "params get": ("hover_V",),
    "params list": (),
    "params restore": ("dump.toml",),
    "params save": (),
    "params set": ("hover_V", "1.5"),
    "record": (),
    "setpoint": ("--elevation-deg", "1"),
    "watch": (),
}
"""Verbs that open a board, and what else each needs."""


def due(device: str, product: int = DUE_PROGRAMMING_PID) -> ListPortInfo:
    port = ListPortInfo(device)
    port.vid, port.pid = ARDUINO_VIDS[0], product
    return port


@pytest.fixture(autouse=True)
def no_port_opens(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """One Due is plugged in; every attempt to open a port is noted and fails the test."""
    (tmp_path / "dump.toml").write_text("[parameters]\nhover_V = 1.5\n")
    opened: list[str] = []

    def refuse(url: str, *arguments: object, **options: object) -> None:
        opened.append(url)
        raise AssertionError(f"{url} was opened")

    monkeypatch.setattr(list_ports, "comports", lambda: [due("/dev/ttyACM7")])
    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.setattr("heli_host.connect", refuse)
    monkeypatch.delenv("HELI_PORT", raising=False)
    return opened


@pytest.mark.parametrize("verb", WORDS)
def test_a_verb_without_a_target_opens_nothing_and_lists_the_boards(
    verb: str, terminal: Terminal, no_port_opens: list[str]
) -> None:
    line = refusal(terminal(*verb.split(), *WORDS[verb]), code=3)
    assert line == (
        "error: no board is named; add --sil for the simulation, "
        "or --port /dev/ttyACM7 for the Due found there"
    )
    assert not no_port_opens


@pytest.mark.parametrize("verb", WORDS)
def test_a_verb_with_two_targets_opens_nothing(
    verb: str, terminal: Terminal, no_port_opens: list[str]
) -> None:
    line = refusal(terminal(*verb.split(), *WORDS[verb], "--sil", "--port", "/dev/ttyACM7"), code=2)
    assert "--port and --sil name two different boards" in line
    assert not no_port_opens


@pytest.mark.slow
@pytest.mark.parametrize("verb", WORDS)
def test_a_verb_takes_its_target_from_the_environment(
    verb: str, terminal: Terminal, no_port_opens: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HELI_PORT", "/dev/ttyACM8")
    terminal(*verb.split(), *WORDS[verb])
    assert no_port_opens == ["/dev/ttyACM8"]


def test_every_verb_that_takes_a_port_is_tested_here() -> None:
    with_port = set()
    waiting = list(command_line().commands.items())  # type: ignore[attr-defined]
    while waiting:
        name, command = waiting.pop()
        waiting += [(f"{name} {part}", below) for part, below in getattr(command, "commands", {}).items()]
        options = {option for parameter in command.params for option in parameter.opts}
        if "--port" in options and not command.hidden:
            assert "--sil" in options or name in ("class", "flash"), name
            with_port.add(name)
    # `class` flies in simulation first, and asks before each flight on the rig.
    assert with_port == {*WORDS, "class", "flash"}


def test_a_verb_for_a_real_board_offers_no_simulation() -> None:
    with pytest.raises(PortError, match="add --port /dev/ttyACM7 for the Due found there"):
        check_target(None, None)


@pytest.mark.parametrize(
    ("plugged_in", "remedy"),
    [
        ([], "and no Due is plugged in; add --sil for the simulation"),
        ([due("/dev/ttyACM1"), due("/dev/ttyACM2")], "--port /dev/ttyACM1 or --port /dev/ttyACM2"),
        ([due("/dev/ttyACM1", DUE_NATIVE_PID)], "move its cable to the programming port"),
    ],
    ids=["none", "two", "native port"],
)
def test_the_remedy_follows_from_what_is_plugged_in(
    plugged_in: list[ListPortInfo], remedy: str, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: plugged_in)
    assert remedy in refusal(terminal("fly", "hover"), code=3)
