"""Shares of samples, measures of pictures, and stalls of processes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import image

from tests.running import long
from tests.running.long import samples, select_cases
from tests.running.pixels import coloured_share
from tests.running.stalls import run

CASES = [f"{kind}{number}" for kind, count in (("a", 7), ("b", 1), ("c", 4)) for number in range(count)]


def test_a_share_has_at_least_one_case_of_each_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "LONG", False)
    assert select_cases(CASES, every=3, kind=lambda case: case[0]) == ["a0", "a3", "a6", "b0", "c0", "c3"]
    assert select_cases(CASES, every=5) == ["a0", "a5", "c2"]
    assert samples(200, 8) == 8
    monkeypatch.setattr(long, "LONG", True)
    assert select_cases(CASES, every=3, kind=lambda case: case[0]) == CASES
    assert samples(200, 8) == 200


def test_only_coloured_pixels_count(tmp_path: Path) -> None:
    picture = np.full((10, 10, 3), 0.5)
    picture[:3] = (0.1, 0.4, 0.9)
    image.imsave(tmp_path / "picture.png", picture)
    assert coloured_share(tmp_path / "picture.png") == pytest.approx(0.3)


# A process that ends once it went on after two stalls.
IS_STALLED_TWICE = """
import signal, time
continued = []
signal.signal(signal.SIGCONT, lambda *_: continued.append(True))
while len(continued) < 2:
    time.sleep(0.01)
raise SystemExit(7)
"""
IN_A_CHILD = """
import subprocess, sys
sys.exit(subprocess.run([sys.executable, "-c", sys.argv[1]]).returncode)
"""


@pytest.mark.medium
@pytest.mark.skipif(sys.platform != "linux", reason="skipped: reads /proc, which is of Linux")
@pytest.mark.parametrize("words", [["-c", IS_STALLED_TWICE], ["-c", IN_A_CHILD, IS_STALLED_TWICE]])
def test_a_command_or_its_child_is_stalled_and_its_exit_status_is_reported(words: list[str]) -> None:
    status, stalls = run(1, [sys.executable, *words])
    assert status == 7 and stalls >= 2
