"""Every target of the Makefile runs, small; what runs it elsewhere in `make test` is named and looked up."""

from __future__ import annotations

import os
import re
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from tests.page.page_server import SHORT_PLAN

ROOT: Final = Path(__file__).resolve().parents[2]
MAKEFILE: Final = ROOT / "Makefile"
TARGETS: Final = re.findall(r"^([a-z]+):(?!=)", MAKEFILE.read_text(), re.MULTILINE)
FEW_TESTS: Final = "tests/running/test_helpers.py"


@dataclass(frozen=True)
class Small:
    """A small run of a target."""

    variables: tuple[str, ...]  # Variables of the Makefile that make it small
    says: str  # Pattern of what it prints
    statuses: tuple[int, ...] = (0,)  # Exit statuses of make that are good


SMALL: Final = {
    "help": Small((), r"make mutants +list small changes"),
    "fly": Small(("PLANS=short.toml", "SPEED=max", "BOARD=native"), r"completed"),
    "quick": Small((f"TESTS={FEW_TESTS}",), r"\d+ passed"),
    "long": Small((f"TESTS={FEW_TESTS}",), r"\d+ passed"),
    "bench": Small(("PARTS=line",), r"bytes"),
    "mutants": Small(("FILES=link/parser.cpp", "TESTS=tests/link/test_core_parser", "COUNT=1"), r"1/1 "),
    # Its status also judges the machine: one that is busy loses samples.
    "soak": Small(("MINUTES=0.03",), r"^\| statuses \| [1-9]", statuses=(0, 2)),
    "attack": Small(("KINDS=logs", "COUNT=1"), r"damaged logs \| 20 \| 0 "),
    "prove": Small(
        ("CLAIMS=parser:step_cobs",), r"parser:step_cobs: proved, \d+ properties, 1 mutants refuted"
    ),
    "release": Small(("CHECKS=citation",), r"ok +CITATION.cff is valid"),
    "clean": Small((), r"rm -rf \.venv"),
}

ELSEWHERE: Final = {
    "setup": (".ci/test", ".ci/setup test"),
    "test": (".ci/run", "make --no-print-directory test"),
    "check": (".ci/test", ".ci/check"),
    "fuzz": (".ci/test", ".ci/fuzz"),
    "blind": ("tests/benchmark/test_blind.py", "As `make blind` does"),
    "docs": ("tests/repo/test_site.py", "def test_the_site_builds_without_a_warning"),
    "firmware": ("tests/firmware/test_tools.py", "def test_platformio_builds_the_same_program"),
}
"""Targets that a step of `make test` or another test runs, because they take a minute: file and words."""


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with links to what a clone has, and to .venv: what a target makes is made here."""
    folder = tmp_path_factory.mktemp("clone")
    tracked = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in {line.partition("/")[0] for line in tracked.splitlines()} | {".venv"}:
        (folder / name).symlink_to(ROOT / name)
    (folder / "short.toml").write_text(SHORT_PLAN)
    return folder


def made(target: str, folder: Path, *variables: str) -> subprocess.CompletedProcess[str]:
    """Run a target; its step that sets up does nothing, because `make test` has done it."""
    outer = ("PYTEST_", "MAKE", "MFLAGS", "HELI_LONG")
    inherited = {name: value for name, value in os.environ.items() if not name.startswith(outer)}
    return subprocess.run(
        ["make", "--no-print-directory", target, *variables],
        cwd=folder,
        # The results of these few tests are not those of the next run's order.
        env={**inherited, "HELI_IS_SET_UP": "1", "PYTEST_ADDOPTS": "-p no:cacheprovider"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )


def test_each_target_runs_here_or_is_run_elsewhere() -> None:
    assert sorted((*SMALL, *ELSEWHERE)) == sorted(TARGETS)
    for target, (file, words) in ELSEWHERE.items():
        assert words in (ROOT / file).read_text(), target


@pytest.mark.slow
@pytest.mark.parametrize("target", SMALL)
def test_a_small_run_of_a_target_ends_well(target: str, clone: Path) -> None:
    small = SMALL[target]
    ended = made(target, clone, *small.variables)
    assert ended.returncode in small.statuses, ended.stdout[-3000:]
    assert re.search(small.says, ended.stdout, re.MULTILINE), ended.stdout[-3000:]
    assert "Traceback" not in ended.stdout, ended.stdout[-3000:]
