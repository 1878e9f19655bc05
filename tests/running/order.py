"""Order of the tests, and their groups, when several workers run them.

The tests of a file form a group and run in one worker, because they share fixtures. A marker ``xdist_group``
puts a test into another group. The most expensive group runs first, so that no worker starts a long group at
the end. The cost of a test is its CPU time in the last run here, else in `costs.json`, else a guess from its
markers.

The group `REAL_TIME` runs before all others. Its tests fly in real time and need little CPU time, so
that one worker waits for minutes while the others compute.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container
from typing import Final

import pytest

from tests.running.cost import COSTS_KEY
from tests.running.costs import saved_costs_s

GUESSED_S: Final = {"documents": 10.0, "diagnosis": 10.0, "slow": 2.0, "emulated": 2.0, "medium": 0.5}
GUESSED_OTHERWISE_S: Final = 0.02
REAL_TIME: Final = "real-time"
"""Group of the tests that wait: five minutes in all, and one minute of CPU time."""


def group_of(item: pytest.Item) -> str:
    """Return the group of a test."""
    names = {str(mark.args[0]) for mark in item.iter_markers("xdist_group")}
    return "_".join(sorted(names)) or item.nodeid.partition("::")[0]


def cost_s(item: pytest.Item, known_s: dict[str, float], files: Container[str]) -> float:
    """Return the expected CPU time of a test. In `files` with known costs, a test without one is cheap."""
    if item.nodeid in known_s or item.nodeid.partition("::")[0] in files:
        return known_s.get(item.nodeid, GUESSED_OTHERWISE_S)
    guesses = (guess_s for name, guess_s in GUESSED_S.items() if item.get_closest_marker(name))
    return next(guesses, GUESSED_OTHERWISE_S)


# Before the hook of xdist, which appends the group to the name of a test.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not hasattr(config, "workerinput"):
        return
    cache = getattr(config, "cache", None)
    known_s = (cache.get(COSTS_KEY, {}) if cache is not None else {}) or saved_costs_s()
    groups = {item: group_of(item) for item in items}
    files = {name.partition("::")[0] for name in known_s}
    total_s: dict[str, float] = defaultdict(float)
    for item, group in groups.items():
        total_s[group] += cost_s(item, known_s, files)
    items.sort(key=lambda item: (groups[item] != REAL_TIME, -total_s[groups[item]], groups[item]))
    for item, group in groups.items():
        if not any(item.iter_markers("xdist_group")):
            item.add_marker(pytest.mark.xdist_group(group))
