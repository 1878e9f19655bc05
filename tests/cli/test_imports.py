"""Parts of the command line import nothing that takes longer than their own work."""

from __future__ import annotations

import subprocess
import sys

import pytest


@pytest.mark.medium
def test_an_option_is_imported_without_the_verbs() -> None:
    program = "import heli_lab.fit_inputs, sys; sys.exit('heli_host.cli.entry' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@pytest.mark.medium
def test_the_check_after_a_flight_does_not_import_scipy() -> None:
    program = "import heli_lab.encoder_scale.warning, sys; sys.exit('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
