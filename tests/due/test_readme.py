"""The example of the README runs, and prints what its comments state."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
from pathlib import Path

import pytest

from tests.due.conftest import Build

pytestmark = pytest.mark.emulated

README = Path(__file__).resolve().parents[2] / "sim" / "due" / "README.md"


def test_the_example_prints_what_its_comments_state(
    build: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (example,) = re.findall(r"^```python\n(.*?)^```", README.read_text(), re.MULTILINE | re.DOTALL)
    stated = re.findall(r"^print\(.*\)  # ([^:\n]+)", example, re.MULTILINE)
    assert len(stated) == 3
    shutil.copy(build("button.c", "-Os", "-Wall", "-Wextra", "-Werror"), tmp_path / "button.elf")
    monkeypatch.chdir(tmp_path)
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        exec(compile(example, str(README), "exec"), {})
    assert printed.getvalue().splitlines() == stated
