"""With what Windows lacks hidden, a board is flown over TCP, and errors say what to do."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from heli_host.data.files import limit_process
from heli_host.ui.cli import doctor
from heli_host.ui.cli.board import ARDUINO_VIDS

ROOT = Path(__file__).resolve().parents[2]
WITHOUT = Path(__file__).parent / "without"

HELI_HOST = "import sys; from heli_host.ui.cli import main; sys.exit(main())"
FLIES_OVER_TCP = """
import heli_host
with heli_host.connect("sil://?process=1&speed=max") as heli:
    assert heli.session.transport.url.startswith("socket://127.0.0.1:"), heli.session.transport.url
    assert not heli.session.lockstep
    heli.params.restore({"setpoint_hold_s": 5.0, "setpoint_land_s": 30.0})
    heli.take_off(elevation_deg=0.0)
    sample = heli.wait_until(lambda now: abs(now.elevation_deg) < 2.0, 20.0)
    assert "rig makki2024" in repr(heli), repr(heli)
    heli.land()
print(sample.elevation_deg)
"""

CAMPAIGNS = """
import sys
from pathlib import Path
from heli_lab.apps.campaign import Case
from heli_lab.apps.campaign.cases import Limits
from heli_lab.apps.campaign.worker import WorkerProcess
from heli_lab.apps.campaign.run import Store
from heli_lab.errors import CampaignError
assert "resource" not in sys.modules and "fcntl" not in sys.modules
with WorkerProcess(Limits(cpu_s=0.3)) as cage:
    print(cage.run(Case("a", "tests.campaign.works:bad", {"how": "runs away"}), "key").failure)
    print(dict(cage.run(Case("b", "tests.campaign.works:count", {"number": 3}), "other").row))
with Store(Path("results")).locked():
    try:
        with Store(Path("results")).locked():
            print("two campaigns in one folder")
    except CampaignError as error:
        print(error.cause)
with Store(Path("results")).locked():
    print("free again")
"""


def run(*words: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(WITHOUT), "PYTHONDONTWRITEBYTECODE": "1"}
    return subprocess.run(
        [sys.executable, *words], cwd=cwd, env=environment, capture_output=True, text=True, check=False
    )


@pytest.mark.medium
def test_the_modules_are_hidden() -> None:
    script = (
        "import os, signal\n"
        "for name in ('termios', 'tty', 'pty', 'fcntl'):\n"
        "    try: __import__(name)\n"
        "    except ImportError: pass\n"
        "    else: raise SystemExit(name)\n"
        "assert not hasattr(os, 'openpty') and not hasattr(signal, 'SIGHUP')\n"
    )
    done = run("-c", script)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_a_board_in_a_process_of_its_own_is_flown_over_tcp() -> None:
    done = run("-c", FLIES_OVER_TCP)
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.slow
def test_the_command_line_flies_in_process_and_reads_its_log(tmp_path: Path) -> None:
    flown = run("-c", HELI_HOST, "fly", "hover", "--sil", "--speed", "max", "--log", "a.mcap", cwd=tmp_path)
    assert flown.returncode == 0, flown.stderr[-2000:]
    assert "completed" in run("-c", HELI_HOST, "info", "a.mcap", cwd=tmp_path).stdout


@pytest.mark.medium
def test_campaigns_lock_their_folder_and_end_cases_that_run_away(tmp_path: Path) -> None:
    done = run("-c", f"import sys; sys.path.append({str(ROOT)!r})" + CAMPAIGNS, cwd=tmp_path)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.splitlines() == [
        "the case used more than 0.3 s of CPU",
        "{'square': 9}",
        "another campaign is writing to results",
        "free again",
    ]


@pytest.mark.medium
def test_a_pseudo_terminal_is_refused_with_the_other_way(tmp_path: Path) -> None:
    done = run("-c", HELI_HOST, "sil", "--pty", "due", cwd=tmp_path)
    assert done.returncode != 0 and "Traceback" not in done.stderr
    assert "no pseudo-terminals" in done.stderr and "--tcp 127.0.0.1:5000" in done.stderr


def test_the_udev_file_is_for_the_board_and_keeps_modem_manager_off(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (ROOT / "docs" / "99-heli.rules").read_text()
    rules = [line for line in text.splitlines() if line and not line.startswith("#")]
    for vendor in ARDUINO_VIDS:
        of_vendor = [rule for rule in rules if f'ATTRS{{idVendor}}=="{vendor:04x}"' in rule]
        assert len(of_vendor) == 3
        assert sum('GROUP="dialout"' in rule for rule in of_vendor) == 2
    monkeypatch.setattr(doctor, "UDEV_FOLDERS", (ROOT / "docs",))
    assert all(doctor._udev_ignores(vendor) for vendor in ARDUINO_VIDS)


def test_wheels_are_configured_for_every_python_that_the_project_takes() -> None:
    with (ROOT / "pyproject.toml").open("rb") as file:
        project = tomllib.load(file)
    wheels = project["tool"]["cibuildwheel"]
    oldest = re.fullmatch(r">=3\.(\d+)", project["project"]["requires-python"])
    assert oldest is not None and f"cp3{oldest[1]}-*" in wheels["build"]
    assert any("fly hover --sil" in command for command in wheels["test-command"])
    assert wheels["windows"]["environment"]["CXX"] == "clang++"


resource = pytest.importorskip("resource")


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> dict[int, tuple[int, int]]:
    """Limits of a process on a system without one of the address space, such as macOS."""
    present = {
        resource.RLIMIT_CPU: (60, 60),
        resource.RLIMIT_FSIZE: (resource.RLIM_INFINITY, resource.RLIM_INFINITY),
    }

    def set_limit(number: int, limit: tuple[int, int]) -> None:
        if number == resource.RLIMIT_AS or present[number][1] not in (
            resource.RLIM_INFINITY,
            *range(limit[1], 61),
        ):
            raise ValueError("current limit exceeds maximum limit")
        present[number] = limit

    monkeypatch.setattr(resource, "setrlimit", set_limit)
    monkeypatch.setattr(resource, "getrlimit", lambda number: present.get(number, (-1, -1)))
    return present


def test_limit_that_the_system_lacks_does_not_stop_the_others(limits: dict[int, tuple[int, int]]) -> None:
    limit_process("AS", 1 << 30, 1 << 30)
    limit_process("FSIZE", 0, 0)
    assert limits[resource.RLIMIT_FSIZE] == (0, 0)
    assert resource.RLIMIT_AS not in limits


def test_stricter_limit_of_the_parent_stays(limits: dict[int, tuple[int, int]]) -> None:
    limit_process("CPU", 100, 105)
    assert limits[resource.RLIMIT_CPU] == (60, 60)


def test_soft_limit_can_be_raised_again_up_to_the_hard_one(limits: dict[int, tuple[int, int]]) -> None:
    limit_process("CPU", 10)
    limit_process("CPU", 20)
    assert limits[resource.RLIMIT_CPU] == (20, 60)
