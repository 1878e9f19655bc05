"""Text of any editor is read, also in UTF-16; joined files and endings of other formats are refused."""

from __future__ import annotations

import codecs
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.parameters import read_parameter_set
from heli_host.data.files import decode_text
from heli_host.data.log import table
from heli_host.data.log.reader import read_log
from heli_host.data.log.table import read_csv
from heli_host.data.tables import read_profile
from heli_host.errors import FlightDataError, LogError
from heli_host.fly.plan import load_plan
from heli_host.link.transport import PortInfo
from heli_host.ui.cli.board import is_due, is_due_native
from heli_sim.model.effects.catalogue import _effects_in_file
from heli_sim.rig import load_rig, rig_text

from tests.cli.terminal import Terminal, terminal

__all__ = ["terminal"]
pytestmark = pytest.mark.medium

ROOT = Path(__file__).resolve().parents[2]
ENCODINGS: dict[str, Callable[[str], bytes]] = {
    "UTF-8": lambda text: text.encode(),
    "UTF-8 with a mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16, big end first": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
}
PLAN = 'title = "Über"\n[[segment]]\nkind = "hold"\nduration_s = 2\n'
PROFILE = """
[time]
column = "t"
unit = "s"
[elevation]
column = "e"
unit = "deg"
[pitch]
column = "p"
unit = "deg"
[travel]
column = "l"
unit = "deg"
[front]
column = "f"
[back]
column = "b"
"""
EFFECT = (ROOT / "sim" / "heli_sim" / "model" / "effects" / "cable_spring.py").read_text()


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_text_of_a_user_is_read_in_every_encoding(encoding: str, tmp_path: Path) -> None:
    encode = ENCODINGS[encoding]

    def written(name: str, text: str) -> Path:
        (tmp_path / name).write_bytes(encode(text))
        return tmp_path / name

    assert decode_text(encode("hé")) == "hé"
    assert load_plan(str(written("plan.toml", PLAN))).title == "Über"
    assert load_rig(str(written("rig.toml", rig_text(load_rig("makki2024"))))).name == "makki2024"
    parameters = read_parameter_set(written("params.toml", "[parameters]\nhover_V = 2.0\n"))
    assert parameters.values == {"hover_V": 2.0}
    assert read_profile(written("profile.toml", PROFILE))
    rows = "".join(f"{k / 1000},1,1,0,0,{k / 10000}\n" for k in range(300))
    flight = read_csv(written("flight.csv", f"t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n{rows}"))
    np.testing.assert_allclose(flight.t_s[-1], 0.299)
    kinds = _effects_in_file(written("spring.py", EFFECT.replace("cable_spring", "my_spring")))
    assert [kind.id for kind in kinds] == ["my_spring.elevation", "my_spring.travel"]


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for name in ("a", "b"):
        words = ["record", "--sil", "--speed", "max", "--duration", "0.5", "-o", f"{name}.mcap", "--quiet"]
        command = [sys.executable, "-c", "from heli_host.ui.cli import main; main()", *words]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder


@pytest.mark.parametrize("cut", [0, 3000])
def test_two_logs_in_one_file_are_refused_with_the_place_of_the_second(
    cut: int, logs: Path, tmp_path: Path
) -> None:
    first, second = (logs / "a.mcap").read_bytes(), (logs / "b.mcap").read_bytes()
    first = first[: len(first) - cut]
    (tmp_path / "joined.mcap").write_bytes(first + second)
    message = f"two logs that were joined; the second begins after {len(first)} bytes"
    with pytest.raises(LogError, match=message):
        read_log(tmp_path / "joined.mcap")
    assert read_log(logs / "a.mcap").ticks.size == 500


def test_two_tables_in_one_file_are_refused(logs: Path, terminal: Terminal) -> None:
    assert terminal("export", logs / "a.mcap", "--csv", "-o", "a.csv").code == 0
    text = Path("a.csv").read_text()
    head, _, rows = text.partition("\n")
    Path("twice.csv").write_text(text + text)
    Path("rows.csv").write_text(f"{head}\n{rows}{rows}")
    with pytest.raises(FlightDataError, match=r"two tables that were joined: line 502 repeats the names"):
        read_csv(Path("twice.csv"))
    with pytest.raises(FlightDataError, match=r"two flights that were joined: t_s falls from 0.499 to 0 s"):
        read_csv(Path("rows.csv"))


def test_an_export_has_the_ending_of_its_format(logs: Path, terminal: Terminal) -> None:
    log = logs / "a.mcap"
    for name in ("x.xlsx", "x.txt", "x", "x.mat"):
        ended = terminal("export", log, "--csv", "-o", name)
        assert ended.code == 2 and "give a name that ends in .csv" in ended.err
        assert not Path(name).exists()
    assert terminal("export", log, "--csv", "-o", "x.csv.gz").code == 0
    assert terminal("export", log, "--csv", "-o", "/dev/null").code == 0


@pytest.mark.slow
def test_a_table_is_drawn_as_a_log_is(logs: Path, terminal: Terminal) -> None:
    assert terminal("export", logs / "a.mcap", "--csv", "-o", "a.csv").code == 0
    assert terminal("plot", "a.csv").code == 0
    assert Path("figure.png").read_bytes().startswith(b"\x89PNG")


def test_a_table_that_heli_host_does_not_read_again_is_said(
    logs: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a.csv", "a.csv.gz"):
        ended = terminal("export", logs / "a.mcap", "--csv", "-o", name)
        assert "reads at most" not in ended.out
    monkeypatch.setattr(table, "MAX_TABLE_BYTES", 10_000)
    for name in ("a.csv", "a.csv.gz"):
        ended = terminal("export", logs / "a.mcap", "--csv", "-o", name)
        assert ended.code == 0 and "heli-host reads at most 0 MiB; give " in ended.out
    refused = terminal("info", "a.csv")
    assert "it has more than" in refused.err and "cut it into pieces" in refused.err
    assert "disk" not in refused.err


@pytest.mark.parametrize("vendor", [0x2341, 0x2A03])
def test_a_due_of_either_vendor_is_a_due(vendor: int) -> None:
    ports = [PortInfo("/dev/ttyACM0", "/dev/ttyACM0", "Due", vendor, product) for product in (0x3D, 0x3E)]
    assert [is_due(port) for port in ports] == [True, False]
    assert [is_due_native(port) for port in ports] == [False, True]
