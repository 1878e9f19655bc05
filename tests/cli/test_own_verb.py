"""A package of a user's own adds a verb, and a broken one takes no other with it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

GREET = '''\
"""``heli-host greet``."""

from heli_host.ui.cli.verb import Verb


def greet(name: str) -> None:
    """Say good day."""
    print(f"good day, {name}")


VERB = Verb(greet, "Own")
'''


def install(folder: Path, package: str, modules: dict[str, str]) -> None:
    """Write a package and the files of its installer into a folder."""
    (folder / package).mkdir()
    for name, text in {"__init__": "", **modules}.items():
        (folder / package / f"{name}.py").write_text(text)
    metadata_folder = folder / f"{package}-1.0.dist-info"
    metadata_folder.mkdir()
    (metadata_folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (metadata_folder / "entry_points.txt").write_text(f"[heli_host.verbs]\nown = {package}\n")


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = "import sys; from heli_host.ui.cli import main; main()"
    environment = {**os.environ, "PYTHONPATH": str(folder), "NO_COLOR": "1", "COLUMNS": "100"}
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_package_of_ones_own_adds_a_verb(tmp_path: Path) -> None:
    install(tmp_path, "own_verbs", {"greet": GREET})
    done = run(tmp_path, "greet", "Ada")
    assert (done.returncode, done.stdout, done.stderr) == (0, "good day, Ada\n", "")


def test_a_broken_package_is_one_line_and_takes_no_verb_with_it(tmp_path: Path) -> None:
    install(tmp_path, "own_verbs", {"greet": GREET})
    install(tmp_path, "broken_verbs", {"worse": "1 / 0"})
    done = run(tmp_path, "--help")
    assert done.returncode == 0
    listed = [words[1] for line in done.stdout.splitlines() if len(words := line.split()) > 1]
    assert {"greet", "fly", "doctor", "sil", "diagnose"} <= set(listed)
    (warning,) = done.stderr.splitlines()
    assert warning.startswith("warning: the verbs of broken_verbs do not load (ZeroDivisionError")


def test_a_verb_that_exists_is_not_replaced(tmp_path: Path) -> None:
    install(tmp_path, "own_verbs", {"ports": GREET.replace("greet", "ports")})
    done = run(tmp_path, "ports", "Ada")
    assert "good day" not in done.stdout
    assert done.stderr.splitlines()[0] == "warning: own_verbs has another verb 'ports'; left out"
