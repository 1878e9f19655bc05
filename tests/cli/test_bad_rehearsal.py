"""A fault that a simulated board cannot rehearse is refused in one line that names the option."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

ASKED = 2


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--encoder-out", "pitc", "elevation, pitch, travel"),
        ("--encoder-out", "", "elevation, pitch, travel"),
        ("--encoder-out", ":5", "elevation, pitch, travel"),
        ("--encoder-out", "pitch:x", "give a number"),
        ("--encoder-out", "pitch:-1", "start or start:length"),
        ("--encoder-out", "pitch:1:0", "start or start:length"),
        ("--encoder-out", "pitch:1:2:3", "give a number"),
        ("--stop-switch", "", "give a number"),
        ("--stop-switch", "nan", "start or start:length"),
        ("--stop-switch", "1e300", "start or start:length"),
        ("--stop-switch", "9" * 400, "start or start:length"),
        ("--stop-switch", "1:-2", "start or start:length"),
        ("--supply-out", "a:b", "give a number"),
        ("--supply-out", "5:nan", "start or start:length"),
        ("--supply-out", "1\x1b[2J", "give a number"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_by_its_option(
    terminal: Terminal, tmp_path: Path, option: str, value: str, says: str
) -> None:
    line = refusal(terminal("sil", "--pty", tmp_path / "due", f"{option}={value}"), code=ASKED)
    assert says in line and line.isprintable()
    assert option in line or "encoder" in line
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
def test_the_same_in_an_address(terminal: Terminal, address: str) -> None:
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
    plan = tmp_path / "plan.toml"
    plan.write_text(f'{tolerance}[[segment]]\nkind = "hold"\nduration_s = 3\n')
    line = refusal(terminal("fly", plan, "--sil", "--speed", "max", "--log", "f.mcap"), code=ASKED)
    assert says in line and "plan.toml" in line
    assert not (tmp_path / "f.mcap").exists()
