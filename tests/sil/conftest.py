"""The flight code's ELF, built once for this room."""

from pathlib import Path

import pytest

from tests.firmware.built import built_elf


@pytest.fixture(scope="session")
def elf() -> Path:
    """The ELF of the sources as they are."""
    return built_elf()


@pytest.fixture(params=["native", "due"])
def board(request: pytest.FixtureRequest) -> dict[str, str]:
    """Options of either board."""
    if request.param == "native":
        return {"board": "native"}
    return {"board": "due", "elf": str(request.getfixturevalue("elf"))}
