"""``--quick``: run the tests without a marker of expensive tests, and do not import files that have none."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

import pytest

from tests.running.cost import MEDIUM, UNLIMITED

_LEFT_OUT: Final = (MEDIUM, *UNLIMITED)
_ALL_LEFT_OUT: Final = re.compile(rf"^pytestmark = pytest\.mark\.({'|'.join(_LEFT_OUT)})$", re.MULTILINE)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--quick", action="store_true", help=f"run only tests without the markers {', '.join(_LEFT_OUT)}"
    )


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    if not config.getoption("--quick") or collection_path.suffix != ".py":
        return None
    # None leaves the decision to other plugins.
    return True if _ALL_LEFT_OUT.search(collection_path.read_text(encoding="utf-8")) else None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--quick"):
        return
    expensive = [item for item in items if any(item.get_closest_marker(name) for name in _LEFT_OUT)]
    if expensive:
        config.hook.pytest_deselected(items=expensive)
        items[:] = [item for item in items if item not in set(expensive)]
