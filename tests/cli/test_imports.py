"""Who needs an option of the command line does not load the verbs of all packages with it."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.medium
def test_an_option_is_imported_without_the_verbs() -> None:
    program = "import heli_lab.fit_inputs, sys; sys.exit('heli_host.cli.entry' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
