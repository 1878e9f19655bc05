"""Wrong input: one line that says what and what to do, an exit code that is not zero, and nothing written."""

import errno
import os
import random
import shlex
import socket
import threading
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.writer import McapBytes
from heli_host.errors import file_remedy
from heli_host.ui.cli.entry import _line_and_exit_code
from heli_sim.rig import load_rig, write_rig
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

ASKED, LINK, FILE = 2, 3, 5
NO_NUMBER = "is not a number; write it with a decimal point"
COLUMNS = "t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n"
SEGMENT = '[[segment]]\nkind = "step"\nduration_s = 3\n'
TEXTS = {
    "misspelt.toml": f"{SEGMENT}elevaton_deg = 5\n",
    "steep.toml": f"{SEGMENT}elevation_deg = 50\n",
    "much.toml": "[parameters]\nhover_V = 99\n",
    "word.toml": '[parameters]\nhover_V = "much"\n',
    "other.toml": "[parameters]\nhovver_V = 1.5\n",
    "bare.toml": "hover_V = 1.5\n",
    "broken.toml": "[parameters\n",
    "notes.txt": "hello",
    "why": "",
    "empty.mcap": "",
    "table.mcap": "t_s,front_V\n0,1\n",
    "flights/flight.mcap": "",
    "texts/mine.txt": "hello",
    "still.csv": COLUMNS + "".join(f"{0.01 * row:.2f},1,1,0,0,0\n" for row in range(1000)),
}


@pytest.fixture
def mistakes(tmp_path: Path) -> Path:
    """A folder with files that each are wrong in one way."""
    for name, text in TEXTS.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    (tmp_path / "noise.mcap").write_bytes(random.Random(1).randbytes(1000))
    (tmp_path / "large.mcap").write_bytes(bytes(2 << 20))
    (tmp_path / "own.mcap").write_bytes(McapBytes(0, np.ones(3), level=1).head())
    write_rig(load_rig("makki2024"), tmp_path / "mine.toml")
    return tmp_path


NO_LOG = "give a name that ends in .mcap, and convert the log with heli-host export --csv"
REFUSED = [
    # Boards, real and simulated
    (LINK, "fly hover --port /dev/ttyNOWHERE", "/dev/ttyNOWHERE"),
    (ASKED, "fly hover --port /dev/ttyACM0 --sil", "--port and --sil"),
    (LINK, "params list --port socket://127.0.0.1:9", "socket://127.0.0.1:9"),
    (LINK, "params list --port 127.0.0.1:9", "served over TCP, give socket://127.0.0.1:9"),
    (ASKED, "fly hover --sil --rig mars", "mars"),
    (ASKED, "rig check lab-7.toml", "cannot read rig file lab-7.toml: No such file or directory"),
    (ASKED, "fly hover --board due", "add --sil"),
    (ASKED, "fly hover --sil --board uno", "native, due, auto"),
    (ASKED, "fly hover --sil --board native --elf a.elf", "leave one of them out"),
    (ASKED, "fly hover --sil --elf nowhere.elf", "nowhere.elf"),
    (ASKED, "sil", "--rfc2217"),
    (ASKED, "sil --pty due --tcp 127.0.0.1:5000", "give one of"),
    (ASKED, "sil --pty ./due --rfc2217 127.0.0.1:0", "give one of"),
    (ASKED, "sil --tcp localhost", "HOST:PORT"),
    (ASKED, "sil --rfc2217 nohost", "HOST:PORT"),
    (LINK, "dashboard --sil --host 192.0.2.9", "give an address of this computer, such as 127.0.0.1"),
    # Plans, setpoints, parameters
    (ASKED, "fly hoover --sil", "hover"),
    (ASKED, "fly misspelt.toml --sil", "elevaton_deg"),
    (ASKED, "fly misspelt.toml --sil", "elevation_deg"),
    (ASKED, "fly steep.toml --sil --speed max --log f.mcap", "elevation_deg"),
    *(
        (ASKED, f"setpoint {option} --take-off --sil --speed max --log f.mcap", "limits")
        for option in ("--elevation-deg=80", "--travel-deg=-400", "--pitch-deg=60")
    ),
    (ASKED, "setpoint --take-off --sil", "no setpoint is given"),
    (ASKED, "setpoint --elevation-deg 2 --sil --speed max", "not flying; add --take-off"),
    (ASKED, "params set hover_V -5 --sil", "0 to 20"),
    # Declared are 8; the range of the declaration would be the wrong advice.
    (ASKED, "params set controller 7 --sil", "refused controller = 7"),
    (ASKED, "params set controller 7 --sil", "params list controller --long"),
    (ASKED, "params get hover --sil", "hover_V"),
    *(
        (ASKED, f"params set --sil -- motor_front_sign {value}", f"= {value} is out of range; give -1 or 1")
        for value in ("0.5", "0", "-0.999")
    ),
    *((ASKED, f"params restore {name}.toml --sil", "hover_V") for name in ("much", "word", "other")),
    (ASKED, "params restore bare.toml --sil", "[parameters]"),
    (ASKED, "params restore broken.toml --sil", "TOML"),
    # Numbers
    *((ASKED, f"fly hover --sil --speed {speed}", "--speed") for speed in ("0", "-1", "fast", "nan")),
    (ASKED, "setpoint --take-off --elevation-deg 0,5 --sil", f"'0,5' {NO_NUMBER} and without a unit"),
    (ASKED, "setpoint --take-off --duration 10s --sil", f"'10s' {NO_NUMBER} and without a unit"),
    (ASKED, "params set travel_kp 0,4 --sil", f"'0,4' {NO_NUMBER} and without a unit"),
    (ASKED, "motors --front-V 3V --sil", f"'3V' {NO_NUMBER} and without a unit"),
    (ASKED, "fly hover --sil --seed 1.5", "'1.5' is not a whole number; give one, such as 3"),
    (ASKED, "fly hover --sil --effect rotor_lag=0,08", f"'0,08' {NO_NUMBER}"),
    (ASKED, "rig new new.toml --set 'M_f=0,39 kg'", f"'0,39 kg' {NO_NUMBER}, not a comma"),
    (ASKED, "rig new new.toml --set M_f=390+-4", "add its unit, such as g or cm"),
    # Effects
    (ASKED, "fly hover --sil --effect rotor_lg=0.1", "unknown effect 'rotor_lg'; did you mean rotor_lag?"),
    (ASKED, "fly hover --sil --effect rotor_lag=9", "rotor_lag_s = 9 s is out of range; give 0 to 0.6"),
    (None, "fly hover --sil --effect-file nowhere.py", "cannot be read; give a Python file"),
    (ASKED, "fly hover --sil --model papr", "unknown model 'papr'; did you mean paper"),
    (ASKED, "fly hover --effect rotor_lag", "for a simulated board only; add --sil"),
    # Verbs and options
    (ASKED, "flly", "--help"),
    (ASKED, "fly hover --fast", "heli-host fly --help"),
    (ASKED, "rig export makki2024 --format mjcf -o --quiet", "--quiet is an option, but a file name"),
    (ASKED, "export flight.mcap", "exactly one format"),
    (ASKED, "export flight.mcap --csv --mat", "exactly one format"),
    (ASKED, "identify still.csv --rig makki2024 --from 9 --to 5", "--from 9 is not before --to 5"),
    (ASKED, "diagnose still.csv --rig makki2024 --from 9 --to 5", "--from 9 is not before --to 5"),
    # Files to write
    (ASKED, "fly hover --sil --speed max --figure figure.gif", "unknown format"),
    (FILE, "fly hover --sil --speed max --log /dev/full", "/dev/full"),
    (FILE, "fly hover --sil --log a.csv", NO_LOG),
    (FILE, "setpoint --elevation-deg 2 --sil --log a.csv", NO_LOG),
    (FILE, "record --duration 1 --sil --output a.csv", NO_LOG),
    (ASKED, "export flight.mcap --parquet --output flight.csv", "give a name that ends in .parquet"),
    (ASKED, "export still.csv --csv -o texts", "it is a folder; give another file"),
    (ASKED, "export still.csv --csv", "is the log itself"),
    *(
        (ASKED, words, "mine.toml exists and holds no parameters; give another file")
        for words in (
            "rig to-board mine.toml mine.toml",
            "params dump mine.toml --sil",
            "tune --rig mine.toml --save-params mine.toml",
            "calibrate --sil --save-params mine.toml",
        )
    ),
    (ASKED, "identify a.csv --report why", "is a file; give the name of a folder"),
    # Files to read
    *(
        (FILE, f"{verb} {name}.mcap{' --csv' if verb == 'export' else ''}", f"{name}.mcap")
        for verb in ("info", "plot", "export")
        for name in ("missing", "empty", "table", "noise")
    ),
    (FILE, "info texts", "give a file"),
    (FILE, "info flights", "is a folder, not a flight; give a file, such as flights/flight.mcap"),
    (FILE, "info empty", "there is no such file; did you mean empty.mcap?"),
    (FILE, "info nothing", "check the path"),
    (FILE, "info notes.txt", "is not a flight; give a file that ends in .mcap, .csv or .csv.gz"),
    (FILE, "info empty.mcap", "is an empty file"),
    (ASKED, "fly texts --sil", "Is a directory; give the path of a file"),
    (ASKED, "fly large.mcap --sil", "is too large for a"),
    (ASKED, "fly large.mcap --sil", "to repeat a log, use --again"),
    (ASKED, "params restore large.mcap --sil", "give a TOML file of params dump or tune"),
    (ASKED, "law check large.mcap", "give a Python file that ends with LAW = ..."),
    (FILE, "import texts --guess", "not a ROS 2 bag; give a file, or the folder of a bag"),
    (FILE, "import own.mcap --guess -o out", "own.mcap is a log of heli-host and needs no import"),
    (FILE, "flash nofile.bin --port /dev/ttyACM0", "No such file or directory; check the path"),
    pytest.param(ASKED, "class . --rig nosuch", "unknown rig 'nosuch'", marks=pytest.mark.slow),
]  # fmt: skip


@pytest.mark.parametrize(("code", "words", "says"), REFUSED)
def test_wrong_input_is_refused_in_one_line_and_nothing_is_written(
    terminal: Terminal, mistakes: Path, code: int | None, words: str, says: str
) -> None:
    before = {path: path.read_bytes() for path in mistakes.rglob("*") if path.is_file()}
    ended = terminal(*shlex.split(words))
    line = refusal(ended, code=ended.code if code is None else code)
    assert ended.code and says in line, line
    assert {path: path.read_bytes() for path in mistakes.rglob("*") if path.is_file()} == before


PERIOD = "start or start:length"
FAULTS = [
    *(("--encoder-out", value, "elevation, pitch, travel") for value in ("pitc", "", ":5")),
    *(("--encoder-out", value, "give a number") for value in ("pitch:x", "pitch:1:2:3")),
    *(("--encoder-out", value, PERIOD) for value in ("pitch:-1", "pitch:1:0")),
    *(("--stop-switch", value, PERIOD) for value in ("nan", "1e300", "9" * 400, "1:-2")),
    ("--stop-switch", "", "give a number"),
    *(("--supply-out", value, "give a number") for value in ("a:b", "1\x1b[2J")),
    ("--supply-out", "5:nan", PERIOD),
]


@pytest.mark.parametrize(("option", "value", "says"), FAULTS)
def test_a_fault_that_cannot_be_rehearsed_is_refused_by_its_option(
    terminal: Terminal, tmp_path: Path, option: str, value: str, says: str
) -> None:
    line = refusal(terminal("sil", "--pty", tmp_path / "due", f"{option}={value}"), code=ASKED)
    assert says in line and line.isprintable() and (option in line or "encoder" in line)
    assert not (tmp_path / "due").exists()


@pytest.mark.parametrize(
    "address",
    [
        "encoder_out=yaw",
        "encoder_out=pitch:-1",
        "stop_switch=1:0",
        "supply_out=x",
        "stop_switch=1&stop_switch=2",
    ],
)
def test_a_fault_in_an_address_is_refused_by_its_name(terminal: Terminal, address: str) -> None:
    line = refusal(terminal("params", "list", "--port", f"sil://?{address}"), code=ASKED)
    assert "encoder" in line or address.partition("=")[0] in line


@pytest.mark.parametrize(
    ("tolerance", "says"),
    [
        ("tolerance = 3\n", "write [tolerance]"),
        ("[[tolerance]]\nelevation_deg = 1\n", "write [tolerance]"),
        ('[tolerance]\nelevation_deg = "x"\n', "not a number"),
        ("[tolerance]\nelevation_deg = true\n", "not a number"),
        ("[tolerance]\nelevation_deg = nan\n", "finite"),
        ("[tolerance]\nelevation_deg = 0\n", "0.1 to"),
        ("[tolerance]\ntravel_deg = 1e300\n", "0.1 to"),
        ("[tolerance]\nfor_s = -1\n", "0.1 to"),
        (f"[tolerance]\nfor_s = {'9' * 400}\n", "64 bits"),
        ("[tolerance]\nelevaton_deg = 1\n", "elevation_deg"),
    ],
)
def test_a_tolerance_that_cannot_be_is_refused_before_the_flight(
    terminal: Terminal, tmp_path: Path, tolerance: str, says: str
) -> None:
    (tmp_path / "plan.toml").write_text(f'{tolerance}[[segment]]\nkind = "hold"\nduration_s = 3\n')
    line = refusal(terminal("fly", "plan.toml", "--sil", "--speed", "max", "--log", "f.mcap"), code=ASKED)
    assert says in line and "plan.toml" in line
    assert not (tmp_path / "f.mcap").exists()


def test_a_lasting_port_does_not_contradict_the_simulation(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
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


def test_a_serial_port_that_is_no_usb_port_is_not_offered(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    serial_port, usb_port = ListPortInfo("/dev/ttyS0"), ListPortInfo("/dev/ttyACM3")
    usb_port.vid, usb_port.pid = 0x2341, 0x003D
    monkeypatch.setattr(list_ports, "comports", lambda: [serial_port])
    line = refusal(terminal("watch", "--port", "/dev/ttyACM9"), code=LINK)
    assert "plug the board in" in line and "--sil" in line and "ttyS0" not in line
    monkeypatch.setattr(list_ports, "comports", lambda: [serial_port, usb_port])
    line = refusal(terminal("watch", "--port", "/dev/ttyACM9"), code=LINK)
    assert line.endswith("choose an existing port: /dev/ttyACM3")


def test_debug_shows_the_traceback(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HELI_DEBUG", "1")
    with pytest.raises(Exception, match="unknown parameter"):
        terminal("params", "get", "hover", "--sil")


def test_only_a_used_port_asks_for_another_port(terminal: Terminal) -> None:
    line = refusal(terminal("dashboard", "--sil", "--host", "192.0.2.9"), code=LINK)
    assert "port" not in line.partition("; ")[2]
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
        line = refusal(terminal("dashboard", "--sil", "--http-port", str(port)), code=LINK)
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


@pytest.mark.parametrize(
    ("package", "remedy"),
    [
        ("uvicorn", "pip install -e '.[page]'"),
        ("rosbags.highlevel", "pip install -e '.[import]'"),
        ("gymnasium", "pip install -e '.[gym]'"),
        ("numpy", "pip install -e ."),
        ("my_laws", "or install the package that contains it"),
    ],
)
def test_the_remedy_of_a_missing_package_installs_its_extra(package: str, remedy: str) -> None:
    line, code = _line_and_exit_code(ModuleNotFoundError("gone", name=package))
    assert line.endswith(remedy) and code == ASKED
