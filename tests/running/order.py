"""Who runs which tests, and in which order, when several workers share them.

The tests of a file stay together, because they share what the file builds, unless a test is in a group of its
own by ``xdist_group``. The dearest group goes first, so that none is left over at the end: by what its tests
cost when they ran last, here or where `costs.json` was written; where that is not known, by their markers.
Before all others goes what hardly costs anything and takes minutes, because it flies in real time: one worker
waits there, the others compute.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Container
from typing import Final

import pytest

from tests.running.cost import COSTS_KEY
from tests.running.costs import written_down_s

GUESSED_S: Final = {"documents": 10.0, "diagnosis": 10.0, "slow": 2.0, "emulated": 2.0, "medium": 0.5}
GUESSED_OTHERWISE_S: Final = 0.02
REAL_TIME: Final = "real-time"
"""Group of the tests that wait longest: five minutes, of which they compute one."""


def group_of(item: pytest.Item) -> str:
    """The group that a test runs in."""
    names = {str(mark.args[0]) for mark in item.iter_markers("xdist_group")}
    return "_".join(sorted(names)) or item.nodeid.partition("::")[0]


def cost_s(item: pytest.Item, known_s: dict[str, float], files: Container[str]) -> float:
    """What a test is expected to cost: in one of the `files` of which some are known, others cost little."""
    if item.nodeid in known_s or item.nodeid.partition("::")[0] in files:
        return known_s.get(item.nodeid, GUESSED_OTHERWISE_S)
    guesses = (guess_s for name, guess_s in GUESSED_S.items() if item.get_closest_marker(name))
    return next(guesses, GUESSED_OTHERWISE_S)


# Before xdist, which writes the group behind a test's name.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not hasattr(config, "workerinput"):
        return
    cache = getattr(config, "cache", None)
    known_s = (cache.get(COSTS_KEY, {}) if cache is not None else {}) or written_down_s()
    groups = {item: group_of(item) for item in items}
    files = {name.partition("::")[0] for name in known_s}
    total_s: dict[str, float] = defaultdict(float)
    for item, group in groups.items():
        total_s[group] += cost_s(item, known_s, files)
    items.sort(key=lambda item: (groups[item] != REAL_TIME, -total_s[groups[item]], groups[item]))
    for item, group in groups.items():
        if not any(item.iter_markers("xdist_group")):
            item.add_marker(pytest.mark.xdist_group(group))
