"""`pio run -e due -t upload` with the stand-in platform reaches the uploader, over `heli-host flash`."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from heli_sim.sil.process import SilProcess

from tests.cli.uploader import Uploader
from tests.firmware.conftest import ROOT


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals on this system")
def test_upload_writes_the_image_that_was_built(elf: Path, tmp_path: Path) -> None:
    if find_spec("platformio") is None or find_spec("SCons") is None:
        pytest.skip("PlatformIO is not installed: pip install platformio scons")
    uploader = Uploader(tmp_path / "bin")
    with SilProcess(speed=None) as board:
        done = subprocess.run(
            [
                *(sys.executable, str(ROOT / "firmware/pio/build.py"), "run", "-e", "due"),
                *("-t", "upload", "--upload-port", board.url),
            ],
            env={
                **os.environ,
                "PATH": f"{uploader.folder}{os.pathsep}{os.environ['PATH']}",
                # A proxy that does not exist stands for the network that is missing.
                "http_proxy": "http://127.0.0.1:9",
                "https_proxy": "http://127.0.0.1:9",
            },
            capture_output=True,
            text=True,
            check=False,
        )
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    [call] = uploader.calls
    assert Path(ROOT, call[-1]) == ROOT / "build/pio/due/firmware.bin"
    assert "flashed: simulated board" in done.stdout
