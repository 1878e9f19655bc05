"""Typical mistakes of newcomers: the message names the mistake, and gives the fix for it."""

from __future__ import annotations

from pathlib import Path

import pytest
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

ASKED, LINK, FILE = 2, 3, 5
TOO_LARGE_FOR_TEXT = bytes(2 << 20)


@pytest.mark.parametrize(
    ("words", "written"),
    [
        (("setpoint", "--take-off", "--elevation-deg", "0,5", "--sil"), "'0,5'"),
        (("setpoint", "--take-off", "--duration", "10s", "--sil"), "'10s'"),
        (("params", "set", "travel_kp", "0,4", "--sil"), "'0,4'"),
        (("motors", "--front-V", "3V", "--sil"), "'3V'"),
    ],
)
def test_a_comma_or_a_unit_in_a_number_is_named(
    terminal: Terminal, words: tuple[str, ...], written: str
) -> None:
    line = refusal(terminal(*words), code=ASKED)
    assert f"{written} is not a number; write it with a decimal point and without a unit" in line


def test_a_fraction_is_no_whole_number(terminal: Terminal) -> None:
    line = refusal(terminal("fly", "hover", "--sil", "--seed", "1.5"), code=ASKED)
    assert "'1.5' is not a whole number; give one, such as 3" in line


def test_a_comma_in_a_size_of_an_effect_asks_for_a_point(terminal: Terminal) -> None:
    line = refusal(terminal("fly", "hover", "--sil", "--effect", "rotor_lag=0,08"), code=ASKED)
    assert "'0,08' is not a number; write it with a decimal point" in line


@pytest.mark.parametrize(
    ("number", "expected"),
    [
        ("M_f=0,39 kg", "'0,39 kg' is not a number; write it with a decimal point, not a comma"),
        ("M_f=390+-4", "add its unit, such as g or cm"),
    ],
)
def test_a_stated_mass_asks_for_point_and_unit(terminal: Terminal, number: str, expected: str) -> None:
    assert expected in refusal(terminal("rig", "new", "mine.toml", "--set", number), code=ASKED)


def test_an_address_without_its_kind_asks_for_a_socket(terminal: Terminal) -> None:
    line = refusal(terminal("params", "list", "--port", "127.0.0.1:9"), code=LINK)
    assert line.endswith("for a board that is served over TCP, give socket://127.0.0.1:9")


def test_a_serial_port_that_is_no_usb_port_is_not_offered(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    serial_port, usb_port = ListPortInfo("/dev/ttyS0"), ListPortInfo("/dev/ttyACM3")
    usb_port.vid, usb_port.pid = 0x2341, 0x003D
    monkeypatch.setattr(list_ports, "comports", lambda: [serial_port])
    line = refusal(terminal("watch", "--port", "/dev/ttyACM9"), code=LINK)
    assert "plug the board in" in line
    assert "--sil" in line
    assert "ttyS0" not in line
    monkeypatch.setattr(list_ports, "comports", lambda: [serial_port, usb_port])
    line = refusal(terminal("watch", "--port", "/dev/ttyACM9"), code=LINK)
    assert line.endswith("choose an existing port: /dev/ttyACM3")


def test_a_folder_is_no_flight_and_its_flight_is_offered(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("hello")
    assert refusal(terminal("info", tmp_path), code=FILE).endswith("give a file")
    (tmp_path / "flight.mcap").touch()
    line = refusal(terminal("info", tmp_path), code=FILE)
    assert line.endswith(f"is a folder, not a flight; give a file, such as {tmp_path / 'flight.mcap'}")


def test_a_flight_without_its_ending_is_offered_with_it(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "hover.mcap").touch()
    line = refusal(terminal("info", tmp_path / "hover"), code=FILE)
    assert line.endswith(f"there is no such file; did you mean {tmp_path / 'hover.mcap'}?")
    assert refusal(terminal("info", tmp_path / "hoover"), code=FILE).endswith("check the path")
    (tmp_path / "notes.txt").touch()
    line = refusal(terminal("info", tmp_path / "notes.txt"), code=FILE)
    assert line.endswith("is not a flight; give a file that ends in .mcap, .csv or .csv.gz")


def test_an_empty_log_is_called_empty(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "hover.mcap").touch()
    assert "is an empty file" in refusal(terminal("info", tmp_path / "hover.mcap"), code=FILE)


def test_a_folder_in_place_of_a_plan_asks_for_a_file(terminal: Terminal, tmp_path: Path) -> None:
    line = refusal(terminal("fly", tmp_path, "--sil", "--speed", "max"), code=ASKED)
    assert line.endswith("Is a directory; give the path of a file")


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("fly", "{log}", "--sil", "--speed", "max"), "to repeat a log, use --again"),
        (("params", "restore", "{log}", "--sil"), "give a TOML file of params dump or tune"),
    ],
)
def test_a_log_in_place_of_a_small_file_is_called_too_large(
    terminal: Terminal, tmp_path: Path, words: tuple[str, ...], expected: str
) -> None:
    log = tmp_path / "hover.mcap"
    log.write_bytes(TOO_LARGE_FOR_TEXT)
    line = refusal(terminal(*(word.format(log=log) for word in words)), code=ASKED)
    assert "is too large for a" in line
    assert line.endswith(expected)


def test_a_log_in_place_of_a_law_asks_for_a_python_file(terminal: Terminal, tmp_path: Path) -> None:
    log = tmp_path / "hover.mcap"
    log.write_bytes(TOO_LARGE_FOR_TEXT)
    line = refusal(terminal("law", "check", log), code=ASKED)
    assert line.endswith("give a Python file that ends with LAW = ...")


def test_a_folder_of_tables_is_no_bag(terminal: Terminal, tmp_path: Path) -> None:
    line = refusal(terminal("import", tmp_path, "--guess"), code=FILE)
    assert line.endswith("without metadata.yaml, not a ROS 2 bag; give a file, or the folder of a bag")
