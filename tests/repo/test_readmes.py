"""Each room's README names every file and folder of it, by itself or by a pattern such as `test_*.py`."""

from __future__ import annotations

import re
from fnmatch import fnmatchcase
from pathlib import Path

import pytest

from tests.repo.test_tree import ROOT, tracked

# What every package has, and what pytest looks for by name.
UNSAID = {"README.md", "__init__.py", "__main__.py", "py.typed", "conftest.py", "CMakeLists.txt"}
FILES = [path.relative_to(ROOT) for path in tracked()]
ROOMS = sorted({path.parent for path in FILES if path.name == "README.md"} - {Path()})


def unnamed(readme: str, children: set[str]) -> set[str]:
    """Children that a README does not name."""
    words = set(re.findall(r"[\w-]+", readme))
    patterns = re.findall(r"[\w.{},-]*\*[\w.*-]*", readme)
    return {
        child
        for child in children
        if child.partition(".")[0] not in words
        and not any(fnmatchcase(child, pattern) for pattern in patterns)
    }


@pytest.mark.parametrize("room", ROOMS, ids=str)
def test_readme_names_every_child(room: Path) -> None:
    depth = len(room.parts)
    children = {path.parts[depth] for path in FILES if path.parts[:depth] == room.parts} - UNSAID
    missing = unnamed((ROOT / room / "README.md").read_text(), children)
    assert not missing, f"{room}/README.md does not name {', '.join(sorted(missing))}"


def test_a_child_that_nobody_names_is_noticed() -> None:
    readme = "`link.hpp` and `tc*.cpp`: timers."
    assert unnamed(readme, {"link.hpp", "tc_channel.cpp", "uart.cpp"}) == {"uart.cpp"}
