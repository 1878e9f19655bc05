"""Each verb that does not fly a plan, once."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from heli_host.data.log.reader import read_flight
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import State
from heli_host.errors import FlightAborted
from heli_host.ui.cli import doctor
from heli_host.ui.cli.doctor import USERS_EXTRAS, Verdict, packages_of
from heli_host.ui.cli.flight import FlownFlight
from heli_sim.checks import check_compiler
from serial.tools import list_ports

from tests.cli.terminal import Terminal, process

pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]

SIL = ("--sil", "--speed", "max")
DUE = SimpleNamespace(device="/dev/ttyDUE", description="n/a", vid=0x2341, pid=0x003D, serial_number=None)
NATIVE = SimpleNamespace(device="/dev/ttyUSBX", description="n/a", vid=0x2341, pid=0x003E, serial_number=None)


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


def test_log_records_for_the_given_time(terminal: Terminal, tmp_path: Path) -> None:
    assert terminal("record", "--duration", "3", "-o", tmp_path / "f.mcap", *SIL).code == 0
    assert read_flight(tmp_path / "f.mcap").duration_s == pytest.approx(3.0, abs=0.2)


def test_info_reads_a_table_too(terminal: Terminal, tmp_path: Path) -> None:
    rows = "".join(f"{k * 0.01:.2f},1,1,0,0,0\n" for k in range(50))
    table = tmp_path / "t.csv"
    table.write_text("# origin: a test\nt_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n" + rows)
    out = terminal("info", table).out
    assert "50 rows" in out
    assert "100 Hz" in out


def test_export_does_not_overwrite_its_source(terminal: Terminal, tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    rows = "".join(f"{k * 0.01:.2f},1,1,0,0,0\n" for k in range(50))
    table.write_text("t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n" + rows)
    before = table.read_bytes()
    assert terminal("export", table, "--csv").code == 2
    assert table.read_bytes() == before


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


def test_a_folder_is_named_after_local_time(terminal: Terminal, tmp_path: Path) -> None:
    day = time.strftime("%Y-%m-%d")
    assert terminal("record", "--duration", "0.5", *SIL).code == 0
    (folder,) = (tmp_path / "flights").iterdir()
    assert folder.name >= day


@pytest.mark.parametrize(
    ("outcome", "message"),
    [
        ("aborted: state idle", "aborted: state idle; look at its events: heli-host info f.mcap --events"),
        ("fault pitch_limit: beyond its limit; tune", "fault pitch_limit: beyond its limit; tune"),
    ],
)
def test_a_flight_that_ended_early_says_what_to_do(outcome: str, message: str) -> None:
    summary = FlightSummary(outcome, 1.0, 1000, 0, {}, {}, {})
    with pytest.raises(FlightAborted) as ended:
        FlownFlight(summary, Path("f.mcap"), (), None, None).end()
    assert str(ended.value) == message
