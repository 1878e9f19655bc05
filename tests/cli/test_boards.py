"""Which simulated board the command line flies, and how it says so."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import heli_host
import pytest
from heli_sim.due import firmware

from tests.cli.terminal import Terminal, process

pytestmark = pytest.mark.emulated

MAX = ("--sil", "--speed", "max")


@pytest.fixture
def built() -> Path:
    """An ELF that this installation can fly."""
    builds = firmware.candidates()
    if not builds:
        pytest.skip("no firmware is built: install the cross-compiler, then make setup or make firmware")
    return firmware.find_firmware()


def board_line(out: str) -> str:
    (line,) = [line for line in out.splitlines() if line.startswith("board: ")]
    return line


def test_a_flight_of_the_emulated_due_says_so_everywhere(
    terminal: Terminal, tmp_path: Path, built: Path
) -> None:
    result = terminal("fly", "hover", *MAX, "--board", "due", "--json", "f.json", "--log", "f.mcap")
    assert result.code == 0, result.err
    assert f"emulated Due, {built.name}" in board_line(result.out)
    summary = json.loads((tmp_path / "f.json").read_text())
    assert (summary["board"], summary["outcome"]) == ("emulated Due", "completed")
    # Where the ELF lies is no part of a flight: the same flight leaves the same log elsewhere.
    assert str(built.parent).encode() not in (tmp_path / "f.mcap").read_bytes()


def test_the_native_board_is_flown_unless_asked_otherwise(terminal: Terminal, tmp_path: Path) -> None:
    result = terminal("fly", "hover", *MAX, "--json", "f.json", "--log", "f.mcap")
    assert "native board" in board_line(result.out)
    assert json.loads((tmp_path / "f.json").read_text())["board"] == "native"


def test_auto_without_firmware_flies_the_native_board_and_says_why(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(firmware, "candidates", list)
    result = terminal("fly", "hover", *MAX, "--board", "auto", "--log", "f.mcap")
    assert result.code == 0
    assert "native board" in board_line(result.out)
    assert "make firmware" in result.out
    assert terminal("fly", "hover", *MAX, "--board", "due").code == 2


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("fly", "hover", "--board", "due"), "add --sil"),
        (("fly", "hover", *MAX, "--board", "uno"), "native, due, auto"),
        (("fly", "hover", *MAX, "--board", "native", "--elf", "a.elf"), "leave one of them out"),
        (("fly", "hover", *MAX, "--elf", "nowhere.elf"), "nowhere.elf"),
        (("sil",), "--rfc2217"),
        (("sil", "--pty", "./due", "--rfc2217", "127.0.0.1:0"), "give one of"),
        (("sil", "--rfc2217", "nohost"), "HOST:PORT"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(
    terminal: Terminal, arguments: tuple[str, ...], says: str
) -> None:
    result = terminal(*arguments)
    assert result.code == 2
    assert result.err.startswith("error: ")
    assert len(result.err.splitlines()) == 1
    assert says in result.err


def test_sil_serves_the_emulated_due_with_its_control_lines(tmp_path: Path, built: Path) -> None:
    arguments = ("--rfc2217", "127.0.0.1:0", "--board", "due", "--elf", built, "--speed", "max")
    with process(tmp_path, "sil", *arguments) as server:
        assert server.stdout is not None
        output = server.stdout.readline()
        assert "emulated Due" in output
        url = next(word for word in output.replace(",", " ").split() if word.startswith("rfc2217://"))
        with heli_host.connect(url) as heli:
            assert (heli.info.board, heli.info.reset) == ("Arduino Due", "user")
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=60)
    assert server.returncode == 0, err
    assert "simulated" in out


def test_opening_spares_the_board_where_that_was_asked_for(tmp_path: Path, built: Path) -> None:
    arguments = ("--pty", "./due", "--board", "due", "--no-reset-on-open", "--speed", "max")
    with process(tmp_path, "sil", *arguments) as server:
        assert server.stdout is not None
        server.stdout.readline()
        with heli_host.connect(str(tmp_path / "due")) as heli:
            assert heli.info.reset == "power_up"
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=60)
