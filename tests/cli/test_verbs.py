"""Each verb that does not fly a plan; `watch` moves nothing, and `motors` leaves everything off."""

import contextlib
import fcntl
import os
import pty
import re
import signal
import struct
import subprocess
import sys
import termios
import time
from pathlib import Path
from types import SimpleNamespace

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.data.log.reader import read_flight
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import State
from heli_host.errors import CommandRefused, FlightAborted
from heli_host.link.engine import Command
from heli_host.link.session import Session
from heli_host.ui.cli import doctor
from heli_host.ui.cli.doctor import USERS_EXTRAS, Verdict, packages_of
from heli_host.ui.cli.flight import FlownFlight
from heli_host.ui.cli.verbs import board as bench_verbs
from heli_sim.checks import check_compiler
from heli_sim.sil.transport import SilProcess
from serial.tools import list_ports

from tests.cli.terminal import Process, Terminal, command, process, refusal, until_open
from tests.sil.harness import PATIENT

pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]
SIL = ("--sil", "--speed", "max")
DUE = SimpleNamespace(device="/dev/ttyDUE", description="n/a", vid=0x2341, pid=0x003D, serial_number=None)
NATIVE = SimpleNamespace(device="/dev/ttyUSBX", description="n/a", vid=0x2341, pid=0x003E, serial_number=None)
ASKED, ABORTED = 2, 4


def test_ports_names_a_due(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: [NATIVE, DUE])
    out = terminal("ports").out
    assert out.index("programming port") < out.index("native port")


def test_params_survive_dump_and_restore(terminal: Terminal, tmp_path: Path) -> None:
    dump = tmp_path / "rig.toml"
    assert terminal("params", "dump", dump, "--sil").code == 0
    assert "0 of" in terminal("params", "restore", dump, "--sil").out
    dump.write_text(dump.read_text().replace("hover_V = 1.4", "hover_V = 1.625"))
    assert "hover_V -> 1.625" in terminal("params", "restore", dump, "--sil", "--save").out


def test_params_list_and_get_agree(terminal: Terminal) -> None:
    value = terminal("params", "get", "hover_V", "--sil").out.strip()
    rows = terminal("params", "list", "hover", "--sil").out.splitlines()
    (row,) = [row for row in rows if row.startswith("hover_V ")]
    assert value in row.split()


def test_params_set_says_what_was_before(terminal: Terminal) -> None:
    assert "1.4 -> 1.5 V" in terminal("params", "set", "hover_V", "1.5", "--sil").out
    assert "not saved" in terminal("params", "set", "motor_min_V", "-2", "--sil").out


def test_setpoint_holds_then_lands(terminal: Terminal, tmp_path: Path) -> None:
    log = tmp_path / "f.mcap"
    given = ("--elevation-deg", "4", "--travel-deg", "8", "--duration", "12")
    result = terminal("setpoint", "--take-off", *given, *SIL, "--log", log)
    assert result.code == 0
    assert result.out.splitlines()[-1] == "landed"
    flight = read_flight(log)
    assert flight.elevation_setpoint_rad is not None
    assert flight.state is not None
    # Later, the paper's rig may float up without voltage.
    landed_rad = flight.elevation_rad[flight.state == State.LANDING][-1]
    assert landed_rad == pytest.approx(flight.elevation_rad[0], abs=0.02)
    assert flight.travel_rad.max() > 0.12


def test_record_records_for_the_given_time_in_a_folder_named_after_local_time(
    terminal: Terminal, tmp_path: Path
) -> None:
    day = time.strftime("%Y-%m-%d")
    for _ in range(2):
        assert terminal("record", "--duration", "1", *SIL).code == 0
    folders = sorted((tmp_path / "flights").iterdir())
    assert len(folders) == 2 and folders[0].name >= day
    assert read_flight(folders[0] / "flight.mcap").duration_s == pytest.approx(1.0, abs=0.2)


def test_info_reads_a_table_too(terminal: Terminal, tmp_path: Path) -> None:
    rows = "".join(f"{k * 0.01:.2f},1,1,0,0,0\n" for k in range(50))
    table = tmp_path / "t.csv"
    table.write_text("# origin: a test\nt_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n" + rows)
    out = terminal("info", table).out
    assert "50 rows" in out
    assert "100 Hz" in out


def test_sil_serves_a_board_until_it_is_stopped(terminal: Terminal, tmp_path: Path) -> None:
    with process(tmp_path, "sil", "--pty", "due", "--speed", "20") as board:
        assert board.stdout is not None
        assert "due" in board.stdout.readline()
        assert terminal("params", "get", "hover_V", "--port", tmp_path / "due").out.strip() == "1.4"
        board.terminate()
        out, err = board.communicate(timeout=30)
    assert "bytes to the host" in out
    assert err == ""


def test_doctor_finds_this_computer_fit(terminal: Terminal) -> None:
    result = terminal("doctor")
    assert result.code == 0, result.out


def test_doctor_says_what_to_repair(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: [NATIVE])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file" / "below"))
    (tmp_path / "file").write_text("")
    result = terminal("doctor")
    assert result.code == 1
    assert "move the cable to the programming port" in result.out
    assert "XDG_CACHE_HOME" in result.out


def test_doctor_calls_a_missing_compiler_slow_not_broken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    finding = check_compiler()
    assert finding.verdict is Verdict.NOTE
    assert "50 times slower" in finding.what


def test_doctor_knows_an_old_python() -> None:
    assert doctor.check_python((3, 10, 2)).verdict is Verdict.BAD
    assert doctor.check_python((3, 11, 0)).verdict is Verdict.GOOD


def test_doctor_names_a_missing_package() -> None:
    finding = doctor.check_packages(lambda name: name != "cobs")
    assert finding.verdict is Verdict.BAD
    assert "cobs" in finding.what


def test_doctor_lists_optional_parts_and_how_to_add_them() -> None:
    notes = {finding.what: finding for finding in doctor.check_extras(lambda name: name != "pyarrow")}
    lacking = next(finding for what, finding in notes.items() if "logs as Parquet" in what)
    assert lacking.verdict is Verdict.NOTE
    assert lacking.what == "not installed: logs as Parquet (needs pyarrow)"
    assert lacking.remedy.endswith("pip install -e '.[export]'")
    complete = next(what for what in notes if what.startswith("optional: "))
    assert "the Gymnasium environment" in complete and "logs as Parquet" not in complete


def test_every_optional_part_of_the_documents_exists() -> None:
    rows = (ROOT / "docs" / "how-to" / "platforms.md").read_text().partition("## Optional parts")[2]
    listed = dict(re.findall(r"^\| `(\w+)` \| (.+) \|$", rows.partition("## Containers")[0], re.M))
    assert listed == dict(USERS_EXTRAS)
    assert all(packages_of(extra) for extra in listed)


def test_help_imports_nothing_heavy() -> None:
    code = (
        "import sys; from heli_host.ui.cli import run; run(['--help']); "
        "heavy = {'numpy', 'matplotlib', 'casadi', 'scipy', 'serial', 'heli_sim.rig'}; "
        "heavy |= {'heli_lab.fit'}; "
        "heavy &= set(sys.modules); "
        "sys.exit(', '.join(sorted(heavy)) or 0)"
    )
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr


@pytest.mark.parametrize(
    ("outcome", "message"),
    [
        ("aborted: state idle", "aborted: state idle; look at its events: heli-host info f.mcap --events"),
        ("fault pitch_limit: beyond its limit; tune", "fault pitch_limit: beyond its limit; tune"),
    ],
)
def test_a_flight_that_ended_early_says_what_to_do(outcome: str, message: str) -> None:
    summary = FlightSummary(
        outcome=outcome,
        duration_s=1.0,
        ticks_logged=1000,
        ticks_lost=0,
        rms_error_deg={},
        max_error_deg={},
        link={},
    )
    with pytest.raises(FlightAborted) as ended:
        FlownFlight(summary, Path("f.mcap"), (), None, None).raise_if_not_completed()
    assert str(ended.value) == message


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
