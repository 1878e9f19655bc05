"""The WebAssembly module, and the program that runs JavaScript."""

from pathlib import Path

import pytest

from tests.web.pages import board_module


@pytest.fixture(scope="session")
def node() -> str:
    """The JavaScript engine that playwright brings along."""
    driver = pytest.importorskip("playwright._impl._driver", reason="playwright is not installed: make setup")
    executable, _ = driver.compute_driver_executable()
    return str(executable)


@pytest.fixture(scope="session")
def board() -> Path:
    """The module of the boards."""
    return board_module()
