"""The WebAssembly module, a page, and the program that runs JavaScript; made once for all tests."""

from __future__ import annotations

import fcntl
import importlib.util
from pathlib import Path

import pytest
from heli_web.build import write_page
from heli_web.compiler import built_board

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def node() -> str:
    """The JavaScript engine that playwright brings along."""
    driver = pytest.importorskip("playwright._impl._driver", reason="playwright is not installed: make setup")
    executable, _ = driver.compute_driver_executable()
    return str(executable)


@pytest.fixture(scope="session")
def board() -> Path:
    """The module of the boards; compiled in two minutes where the sources are new."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("skipped: no compiler for WebAssembly: make setup")
    # The workers of a run would each compile it.
    folder = ROOT / "build"
    folder.mkdir(exist_ok=True)
    with (folder / "web.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return built_board(print)


@pytest.fixture(scope="session")
def page(board: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page with all that it offers."""
    output = tmp_path_factory.mktemp("page") / "heli-lab.html"
    write_page(output, [], None, [])
    return output
