"""The flight code's ELF, built once for this room."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def elf() -> Path:
    """The ELF of the sources as they are; make builds again only what is out of date."""
    for tool in ("arm-none-eabi-g++", "make"):
        if shutil.which(tool) is None:
            pytest.skip(
                f"{tool} is not installed; on Debian: apt-get install gcc-arm-none-eabi "
                "libnewlib-arm-none-eabi libstdc++-arm-none-eabi-dev make"
            )
    build = ROOT / "build" / "firmware-of-tests"
    done = subprocess.run(
        ["make", "-s", "-C", ROOT / "firmware" / "due", f"BUILD={build}", build / "heli.elf"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return build / "heli.elf"


@pytest.fixture(params=["native", "due"])
def board(request: pytest.FixtureRequest) -> dict[str, str]:
    """Options of either board."""
    if request.param == "native":
        return {"board": "native"}
    return {"board": "due", "elf": str(request.getfixturevalue("elf"))}
