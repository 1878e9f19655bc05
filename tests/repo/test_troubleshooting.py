"""The pages of faults and of troubleshooting name every fault of the board, and no other."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
DECLARED = {fault["name"] for fault in tomllib.loads((ROOT / "firmware/link.toml").read_text())["fault"]}
PARAMETERS = {param["name"] for param in tomllib.loads((ROOT / "firmware/link.toml").read_text())["param"]}
FIRST_CELL = re.compile(r"^\| ([^|]*) \|", re.MULTILINE)


def section(page: str, heading: str) -> str:
    """The text of one section of a page."""
    text = (DOCS / page).read_text()
    return text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def named(text: str) -> list[str]:
    """Names in backticks in the first cells of a table."""
    return [name for cell in FIRST_CELL.findall(text) for name in re.findall(r"`(\w+)`", cell)]


def test_troubleshooting_has_each_fault_of_the_board_once() -> None:
    faults = named(section("how-to/troubleshooting.md", "Faults of the board"))
    assert sorted(faults) == sorted(DECLARED)


def test_troubleshooting_names_parameters_that_the_board_has() -> None:
    text = section("how-to/troubleshooting.md", "Signs, scales and supply")
    given = set(re.findall(r"`(\w+_(?:per_rev|sign|V|deg))`", text))
    assert given
    assert given <= PARAMETERS


def test_a_missing_fault_is_noticed() -> None:
    assert named("| `pitch_rate`, `travel_rate` | fast |\n| fault | x |\n") == ["pitch_rate", "travel_rate"]
