"""Wrong input: one line that says what and what to do, and an exit code that is not zero."""

from __future__ import annotations

import errno
import os
import random
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.writer import McapBytes
from heli_host.errors import file_remedy
from heli_sim.rig import load_rig, write_rig
from serial.tools import list_ports

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

ASKED, LINK, FILE = 2, 3, 5
SIL = ("--sil", "--speed", "max")


@pytest.fixture
def no_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", list)


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    return tmp_path / "plan.toml"


def test_missing_port_is_named(terminal: Terminal) -> None:
    line = refusal(terminal("fly", "hover", "--port", "/dev/ttyNOWHERE"), code=LINK)
    assert "/dev/ttyNOWHERE" in line


def test_no_board_points_to_the_simulated_one(terminal: Terminal, no_ports: None) -> None:
    line = refusal(terminal("fly", "hover"), code=LINK)
    assert "--sil" in line


def test_a_port_and_the_simulated_board_contradict_each_other(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = refusal(terminal("fly", "hover", "--port", "/dev/ttyACM0", *SIL), code=ASKED)
    assert "--port and --sil" in line
    monkeypatch.setenv("HELI_PORT", "/dev/ttyACM0")
    assert terminal("params", "get", "hover_V", "--sil").code == 0


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals on this system")
def test_a_device_with_another_protocol_is_recognised(terminal: Terminal) -> None:
    talker, port = os.openpty()
    quiet = threading.Event()

    def chatter() -> None:
        while not quiet.wait(0.01):
            os.write(talker, b"$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n")

    thread = threading.Thread(target=chatter)
    thread.start()
    try:
        line = refusal(terminal("params", "list", "--port", os.ttyname(port)), code=LINK)
    finally:
        quiet.set()
        thread.join()
        os.close(talker)
        os.close(port)
    assert "no frame of this link" in line


def test_a_port_at_a_closed_address_is_refused(terminal: Terminal) -> None:
    line = refusal(terminal("params", "list", "--port", "socket://127.0.0.1:9"), code=LINK)
    assert "socket://127.0.0.1:9" in line


def test_an_unknown_plan_lists_those_that_exist(terminal: Terminal) -> None:
    line = refusal(terminal("fly", "hoover", *SIL), code=ASKED)
    assert "hover" in line


def test_an_unknown_key_in_a_plan_is_named(terminal: Terminal, plan: Path) -> None:
    plan.write_text('[[segment]]\nkind = "step"\nelevaton_deg = 5\nduration_s = 3\n')
    line = refusal(terminal("fly", plan, *SIL), code=ASKED)
    assert "elevaton_deg" in line
    assert "elevation_deg" in line


def test_a_plan_beyond_the_limits_does_not_take_off(terminal: Terminal, plan: Path, tmp_path: Path) -> None:
    plan.write_text('[[segment]]\nkind = "step"\nelevation_deg = 50\nduration_s = 3\n')
    line = refusal(terminal("fly", plan, *SIL, "--log", tmp_path / "f.mcap"), code=ASKED)
    assert "elevation_deg" in line
    assert not (tmp_path / "f.mcap").exists()


@pytest.mark.parametrize("option", ["--elevation-deg=80", "--travel-deg=-400", "--pitch-deg=60"])
def test_a_setpoint_outside_the_limits_does_not_take_off(
    terminal: Terminal, option: str, tmp_path: Path
) -> None:
    result = terminal("setpoint", option, "--take-off", *SIL, "--log", tmp_path / "f.mcap")
    assert "limits" in refusal(result, code=ASKED)
    assert not (tmp_path / "f.mcap").exists()


def test_a_setpoint_of_nothing_is_refused(terminal: Terminal) -> None:
    refusal(terminal("setpoint", "--take-off", *SIL), code=ASKED)


def test_a_setpoint_on_a_board_at_rest_asks_for_take_off(terminal: Terminal) -> None:
    assert "--take-off" in refusal(terminal("setpoint", "--elevation-deg", "2", *SIL), code=ASKED)


def test_a_parameter_out_of_range_says_the_range(terminal: Terminal) -> None:
    assert "0 to 20" in refusal(terminal("params", "set", "hover_V", "-5", "--sil"), code=ASKED)


@pytest.mark.medium
def test_a_controller_that_this_board_lacks_points_to_those_it_has(terminal: Terminal) -> None:
    # Declared are 8; the range of the declaration would be the wrong advice.
    line = refusal(terminal("params", "set", "controller", "7", "--sil"), code=ASKED)
    assert "refused controller = 7" in line and "params list controller --long" in line


def test_an_unknown_parameter_is_guessed(terminal: Terminal) -> None:
    assert "hover_V" in refusal(terminal("params", "get", "hover", "--sil"), code=ASKED)


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("[parameters]\nhover_V = 99\n", "hover_V"),
        ('[parameters]\nhover_V = "much"\n', "hover_V"),
        ("[parameters]\nhovver_V = 1.5\n", "hover_V"),
        ("hover_V = 1.5\n", "[parameters]"),
        ("[parameters\n", "TOML"),
    ],
)
def test_a_damaged_dump_sets_nothing(terminal: Terminal, tmp_path: Path, text: str, hint: str) -> None:
    dump = tmp_path / "dump.toml"
    dump.write_text(text)
    assert hint in refusal(terminal("params", "restore", dump, "--sil"), code=ASKED)


@pytest.mark.parametrize("speed", ["0", "-1", "fast", "nan"])
def test_a_speed_that_is_none_is_refused(terminal: Terminal, speed: str) -> None:
    assert "--speed" in refusal(terminal("fly", "hover", "--sil", "--speed", speed), code=ASKED)


def test_an_unknown_rig_is_named(terminal: Terminal) -> None:
    assert "mars" in refusal(terminal("fly", "hover", *SIL, "--rig", "mars"), code=ASKED)


def test_an_unknown_verb_points_to_help(terminal: Terminal) -> None:
    assert "--help" in refusal(terminal("flly"), code=ASKED)


def test_an_unknown_option_points_to_help(terminal: Terminal) -> None:
    assert "heli-host fly --help" in refusal(terminal("fly", "hover", "--fast"), code=ASKED)


def test_a_figure_of_an_unknown_kind_is_refused_before_the_flight(terminal: Terminal, tmp_path: Path) -> None:
    refusal(terminal("fly", "hover", *SIL, "--figure", tmp_path / "figure.gif"), code=ASKED)
    assert not (tmp_path / "flights").exists()


def test_a_log_that_cannot_be_written_does_not_take_off(terminal: Terminal) -> None:
    line = refusal(terminal("fly", "hover", *SIL, "--log", "/dev/full"), code=FILE)
    assert "/dev/full" in line


@pytest.mark.parametrize(
    "words",
    [
        ("fly", "hover", "--log"),
        ("setpoint", "--elevation-deg", "2", "--log"),
        ("record", "--duration", "1", "--output"),
    ],
)
def test_a_log_under_the_name_of_a_table_is_not_recorded(
    terminal: Terminal, tmp_path: Path, words: tuple[str, ...]
) -> None:
    line = refusal(terminal(*words, "a.csv", *SIL), code=FILE)
    assert "a.csv, because a log is an .mcap file; " in line and "heli-host export --csv" in line
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", ["0.5", "0", "-0.999"])
def test_the_sign_of_a_motor_is_minus_one_or_one(terminal: Terminal, value: str) -> None:
    line = refusal(terminal("params", "set", "--sil", "--", "motor_front_sign", value), code=ASKED)
    assert line.endswith(f"motor_front_sign = {value} is out of range; give -1 or 1")


@pytest.mark.parametrize("verb", ["info", "plot", "export"])
@pytest.mark.parametrize(
    "content",
    [None, b"", b"t_s,front_V\n0,1\n", random.Random(1).randbytes(1000)],
    ids=["missing", "empty", "table", "noise"],
)
def test_a_file_that_is_no_log_is_refused(
    terminal: Terminal, tmp_path: Path, verb: str, content: bytes | None
) -> None:
    log = tmp_path / "flight.mcap"
    if content is not None:
        log.write_bytes(content)
    extra = ("--csv",) if verb == "export" else ()
    assert "flight.mcap" in refusal(terminal(verb, log, *extra), code=FILE)


def test_export_wants_one_format(terminal: Terminal, tmp_path: Path) -> None:
    refusal(terminal("export", tmp_path / "flight.mcap"), code=ASKED)
    refusal(terminal("export", tmp_path / "flight.mcap", "--csv", "--mat"), code=ASKED)


def test_export_does_not_write_one_format_under_the_ending_of_another(
    terminal: Terminal, tmp_path: Path
) -> None:
    table = tmp_path / "flight.csv"
    line = refusal(terminal("export", "flight.mcap", "--parquet", "--output", table), code=ASKED)
    assert "give a name that ends in .parquet" in line
    assert not table.exists()


def test_export_names_a_folder_in_the_place_of_its_file(terminal: Terminal, tmp_path: Path) -> None:
    terminal("record", *SIL, "--duration", "0.2", "-o", "a.mcap")
    line = refusal(terminal("export", "a.mcap", "--csv", "-o", tmp_path), code=ASKED)
    assert "it is a folder; give another file" in line


@pytest.mark.parametrize(
    "words",
    [
        ("rig", "to-board", "mine.toml", "mine.toml"),
        ("params", "dump", "mine.toml", *SIL[:1]),
        ("tune", "--rig", "mine.toml", "--save-params", "mine.toml"),
        ("calibrate", *SIL[:1], "--save-params", "mine.toml"),
    ],
    ids=["to-board", "dump", "tune", "calibrate"],
)
def test_parameters_never_replace_a_rig(terminal: Terminal, words: tuple[str, ...]) -> None:
    write_rig(load_rig("makki2024"), Path("mine.toml"))
    before = Path("mine.toml").read_bytes()
    line = refusal(terminal(*words), code=ASKED)
    assert "mine.toml exists and holds no parameters; give another file" in line
    assert Path("mine.toml").read_bytes() == before


def test_sil_wants_one_endpoint(terminal: Terminal, tmp_path: Path) -> None:
    refusal(terminal("sil"), code=ASKED)
    refusal(terminal("sil", "--pty", tmp_path / "due", "--tcp", "127.0.0.1:5000"), code=ASKED)


def test_sil_refuses_an_address_without_a_port(terminal: Terminal) -> None:
    refusal(terminal("sil", "--tcp", "localhost"), code=ASKED)


def test_debug_shows_the_traceback(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HELI_DEBUG", "1")
    with pytest.raises(Exception, match="unknown parameter"):
        terminal("params", "get", "hover", "--sil")


def test_an_option_is_no_file(terminal: Terminal, tmp_path: Path) -> None:
    line = refusal(terminal("rig", "export", "makki2024", "--format", "mjcf", "-o", "--quiet"), code=ASKED)
    assert "--quiet is an option, but a file name is needed there" in line
    assert not list(tmp_path.iterdir())


def test_an_address_of_another_computer_is_not_taken_for_a_used_port(terminal: Terminal) -> None:
    line = refusal(terminal("dashboard", *SIL[:1], "--host", "192.0.2.9"), code=LINK)
    assert "give an address of this computer, such as 127.0.0.1" in line
    assert "port" not in line.partition("; ")[2]


def test_a_used_port_asks_for_another_port(terminal: Terminal) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        line = refusal(terminal("dashboard", *SIL[:1], "--http-port", str(port)), code=LINK)
    assert "give --http-port another port, or 0 for a free one" in line


@pytest.mark.parametrize(
    ("number", "remedy"),
    [
        (errno.ENOENT, "check the path"),
        (errno.EACCES, "change its permissions"),
        (errno.ENOSPC, "free disk space"),
        (errno.EFBIG, "choose another disk"),
        (errno.EISDIR, "give the path of a file"),
        (errno.ENOTDIR, "a file has the name of a folder"),
        (errno.EEXIST, "a file has the name of a folder"),
    ],
)
def test_the_remedy_of_a_file_follows_from_the_reason(number: int, remedy: str) -> None:
    assert remedy in file_remedy(OSError(number, os.strerror(number)))


def test_a_missing_image_does_not_ask_for_disk_space(terminal: Terminal) -> None:
    line = refusal(terminal("flash", "nofile.bin", "--port", "/dev/ttyACM0"), code=FILE)
    assert line.endswith("No such file or directory; check the path")


def test_a_log_of_heli_host_is_not_imported_but_used_directly(terminal: Terminal, tmp_path: Path) -> None:
    log = tmp_path / "own.mcap"
    log.write_bytes(McapBytes(0, np.ones(3), level=1).head())
    line = refusal(terminal("import", log, "--guess", "-o", tmp_path / "out"), code=FILE)
    assert "own.mcap is a log of heli-host and needs no import" in line


def test_a_missing_rig_file_is_named_and_not_called_an_unknown_rig(terminal: Terminal) -> None:
    line = refusal(terminal("rig", "check", "lab-7.toml"), code=ASKED)
    assert "cannot read rig file lab-7.toml: No such file or directory; check the path" in line


@pytest.mark.parametrize("verb", ["identify", "diagnose"])
def test_a_part_that_ends_before_it_begins_is_refused(terminal: Terminal, tmp_path: Path, verb: str) -> None:
    flight = tmp_path / "flight.csv"
    flight.write_text(
        "t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n"
        + "".join(f"{0.01 * row:.2f},1,1,0,0,0\n" for row in range(1000))
    )
    line = refusal(terminal(verb, flight, "--rig", "makki2024", "--from", "9", "--to", "5"), code=ASKED)
    assert "--from 9 is not before --to 5" in line


@pytest.mark.slow
def test_a_class_with_an_unknown_rig_marks_nothing(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "ann").mkdir()
    line = refusal(terminal("class", tmp_path, "--rig", "nosuch"), code=ASKED)
    assert "unknown rig 'nosuch'" in line
    assert not (tmp_path / "marks.csv").exists()


def test_a_report_in_the_place_of_a_file_asks_for_a_folder(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "why").touch()
    line = refusal(terminal("identify", tmp_path / "a.csv", "--report", tmp_path / "why"), code=ASKED)
    assert "is a file; give the name of a folder" in line
