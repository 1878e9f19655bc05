"""Every number in the printed blocks of docs/validation/paper.md is what the commands print today."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pytest
from heli_host.ui.cli import app
from heli_lab.apps.paper.experiments import ELEVATION_STEPS
from heli_lab.apps.paper.lumped import analytic
from heli_sim.rig import load_rig
from typer.testing import CliRunner

from tests.running.pixels import coloured_share

pytestmark = pytest.mark.documents

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "validation" / "paper.md"
BLOCK = re.compile(r"^```console\n\$ heli-host (paper [a-z]+)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?")
# Other compilers round otherwise: the last digits of an interval move.
RELATIVE, LAST_DIGITS = 0.03, 3.0


@dataclass(frozen=True)
class Printed:
    """A command, and the lines that the document says it prints."""

    command: str
    lines: list[str]


def blocks() -> list[Printed]:
    return [Printed(match[1], match[2].splitlines()) for match in BLOCK.finditer(DOCUMENT.read_text())]


def words(line: str) -> list[str]:
    return NUMBER.sub("#", line).split()


def same(line: str, other: str) -> bool:
    if words(line) != words(other):
        return False
    pairs = zip(NUMBER.findall(line), NUMBER.findall(other), strict=True)
    return all(close(first, second) for first, second in pairs)


def close(first: str, second: str) -> bool:
    digits = len(first.partition(".")[2])
    slack = max(RELATIVE * abs(float(first)), LAST_DIGITS * 10.0**-digits if digits else 0.0)
    return abs(float(first) - float(second)) <= slack


@pytest.mark.parametrize("block", blocks(), ids=lambda block: block.command)
def test_the_document_shows_what_the_command_prints(block: Printed, tmp_path: Path) -> None:
    arguments = block.command.split()
    folder = [str(tmp_path)] if arguments[1] == "figures" else []
    result = CliRunner().invoke(app, [*arguments, *folder])
    assert result.exit_code == 0, result.output
    printed = result.output.splitlines()
    for line in filter(None, block.lines):
        assert any(same(line, other) for other in printed), f"not printed any more: {line}"
    if folder:
        drawn = sorted(path.name for path in tmp_path.glob("*.png"))
        assert drawn == [f"fig{number}.png" for number in (15, 16, 17, 18, 19, 21, 22, 23, 24, 25)]
        assert all(coloured_share(path) > 0.001 for path in tmp_path.glob("*.png"))


def test_the_document_shows_every_command_that_prints_numbers() -> None:
    assert {block.command for block in blocks()} == {
        "paper tables",
        "paper gains",
        "paper models",
        "paper figures",
    }


def test_a_number_that_has_changed_is_noticed() -> None:
    assert same("P_3  -73  -96.272 within 0.048 deg", "P_3  -73  -96.270 within 0.049 deg")
    assert not same("P_3  -73  -96.272 within 0.048 deg", "P_3  -79  -96.272 within 0.048 deg")
    assert not same("stable, dies at 0.029 1/s", "unstable, grows at 0.029 1/s")


def equilibrium_deg(p: Mapping[str, float]) -> float:
    """Elevation at which thrust and gravity balance: forced + P_2 cos + P_3 sin = 0."""
    test = ELEVATION_STEPS[0]
    forced = p["P_1"] + p["P_5"] + p["P_6"] * (test.front_V + test.back_V)
    turn = math.asin(forced / math.hypot(p["P_2"], p["P_3"]))
    return math.degrees(math.atan2(p["P_2"], -p["P_3"]) + turn)


def test_the_stated_sensitivities_are_those_of_the_figure() -> None:
    base = analytic(load_rig("makki2024"))
    rest_deg = equilibrium_deg(base)
    computed = {
        name: abs(equilibrium_deg(base | {name: 1.01 * base[name]}) - rest_deg)
        for name in ("P_1", "P_2", "P_3", "P_4", "P_6")
    }
    documented = {"P_6": 0.6, "P_1": 0.4, "P_2": 0.3, "P_3": 0.1, "P_4": 0.0}
    assert {name: round(value, 1) for name, value in computed.items()} == documented
