"""What `make check` checks, and a short fuzzing: beside the tests, as their equals, so that no core waits."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

from tests.running.long import LONG, samples

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
CHECKS = re.findall(r'^check "(.+?)"', (ROOT / ".ci" / "check").read_text(), re.MULTILINE)
TIDY_NODES = "20000"
"""States of a function that the analyser follows; `make check` and `make long` follow all that it does."""
FUZZ_S = samples(60, 1)
"""Of each target; `make fuzz` has 60 s, too."""


def finds_nothing(*command: str) -> None:
    if not (ROOT / ".venv" / "bin" / "mypy").exists():
        pytest.skip("the tools of the checks are not in .venv: make setup")
    environment = {**os.environ, "CHECK_JOBS": "1", "TIDY_NODES": "" if LONG else TIDY_NODES}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize(
    "check", [pytest.param(check, marks=pytest.mark.xdist_group(f"check-{check}")) for check in CHECKS]
)
def test_a_check_finds_nothing(check: str) -> None:
    finds_nothing(".ci/check", check)


@pytest.mark.xdist_group("fuzz")
def test_generated_input_breaks_nothing() -> None:
    finds_nothing(".ci/fuzz", str(FUZZ_S))
