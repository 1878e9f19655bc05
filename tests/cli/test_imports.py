"""A command does not import what it does not need: the verbs of all packages, or SciPy."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

SHORT = 'title = "Short"\n[[segment]]\nkind = "hold"\nduration_s = 6\n'
# A flight without SciPy takes half of the time.
FLY = """
import sys
from heli_host.ui.cli import run
code = run(["fly", "short.toml", "--sil", "--speed", "max", "--board", "native", "--log", "flight.mcap"])
assert "heli_lab.watch.encoder_scale" in sys.modules
heavy = "matplotlib", "pandas", "scipy"
sys.exit(code or next((name for name in sys.modules if name.startswith(heavy)), 0))
"""


@pytest.mark.medium
def test_an_option_is_imported_without_the_verbs() -> None:
    program = "import heli_lab.fit_inputs, sys; sys.exit('heli_host.ui.cli.entry' in sys.modules)"
    process = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (process.returncode, process.stdout, process.stderr) == (0, "", "")


@pytest.mark.medium
def test_a_flight_and_its_checks_import_no_library_of_analyses(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    process = subprocess.run(
        [sys.executable, "-c", FLY], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
