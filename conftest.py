"""Settings that all tests share."""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.running.alone import NAMES

if TYPE_CHECKING:
    from tests.repo.typed import Typed

pytest_plugins = ["tests.running.order", "tests.cli.terminal"]

# If the environment forbids bytecode, each worker and each of a hundred commands compiles all sources
# again. Pytest then rewrites the asserts of all tests, too: 5 s of CPU per worker.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The workers share the cores out among them: threads within a test would take a core from another.
for _threads in NAMES:
    os.environ[_threads] = "1"

# What is read before the first test stays; to look for garbage in it took a third of the time until then.
gc.disable()

# A shell that runs the tests in the background ignores Ctrl-C; processes started here would inherit
# that, were it not set back.
signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def typed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Typed]:
    """What documents say to type, run by one process of a worker: what that reads takes seconds."""
    from tests.repo.typed import Typed

    with Typed(tmp_path_factory.mktemp("typed") / "output") as started:
        yield started


@pytest.fixture(scope="session")
def single_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page that flies in a browser, as one file."""
    from tests.web.pages import write_whole_page

    return write_whole_page(tmp_path_factory.mktemp("page"))


def pytest_collection_finish() -> None:
    """Leave out of every later collection what was read until here: hundreds of thousands of objects."""
    gc.enable()
    gc.freeze()


def pytest_configure() -> None:
    """Let hypothesis try the same examples in every run: a failure seen once is seen again."""
    from hypothesis import settings

    settings.register_profile("repeatable", derandomize=True, deadline=None)
    settings.load_profile("repeatable")
