"""`.ci/test` runs the checks and the fuzzer next to the tests, and fails if one of the three does."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PARTS = {"tests": ".venv/bin/python", "checks": ".ci/check", "fuzzer": ".ci/fuzz"}
SUMMARY = "3 passed in 1.00s"


def run_with(failing: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Run `.ci/test` in a folder whose tests, checks and fuzzer are one line each."""
    for name in (".ci/setup", *PARTS.values()):
        script = folder / name
        script.parent.mkdir(parents=True, exist_ok=True)
        says = f"echo progress; echo '{SUMMARY}'" if name == PARTS["tests"] else f"echo ran {name}"
        script.write_text(f"#!/bin/sh\n{says}\nexit {int(name == PARTS.get(failing))}\n")
        script.chmod(0o755)
    shutil.copy(ROOT / ".ci" / "test", folder / ".ci" / "test")
    return subprocess.run([".ci/test"], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("failing", ["nothing", *PARTS])
def test_the_run_fails_if_a_part_fails(failing: str, tmp_path: Path) -> None:
    done = run_with(failing, tmp_path)
    assert bool(done.returncode) == (failing != "nothing")


@pytest.mark.parametrize("failing", ["nothing", "checks"])
def test_the_last_line_is_the_summary_of_pytest(failing: str, tmp_path: Path) -> None:
    lines = run_with(failing, tmp_path).stdout.splitlines()
    assert "progress" in lines
    assert lines[-1] == SUMMARY
    assert {"ran .ci/check", "ran .ci/fuzz"} <= set(lines)
