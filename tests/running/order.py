"""Which tests a run chooses, in which order they run, and the CPU time that they took.

``--quick`` leaves out the tests with a marker of an expensive test, and does not import files that have only
such tests.

If several workers run the tests, the tests of a file form a group and run in one worker, because they share
fixtures. A marker ``xdist_group`` puts a test into another group. The group `REAL_TIME` runs first: its tests
fly in real time and need little CPU time, so that one worker waits for minutes while the others compute. Then
the most expensive group is next, so that no worker starts a long group at the end. The cost of a test is its
CPU time in the last run here, else a guess from its markers.

At the end, a run prints its CPU time and lists tests that take more than their markers permit.
"""

import re
import time
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any, Final

import pytest

from tests.running.alone import spent_s

GUESSED_S: Final = {"documents": 10.0, "diagnosis": 10.0, "slow": 2.0, "emulated": 2.0, "medium": 0.5}
"""Expected CPU time of a test, by its marker. `make quick` leaves these tests out."""
UNMARKED_S: Final = 0.02
MAX_S: Final = {"": 1.0, "medium": 2.0}
"""CPU time above which a test without a marker, or with `medium`, is listed. On a busy machine the same work
takes three times the CPU time, so that the list is no verdict.
"""
REAL_TIME: Final = "real-time"
"""Group of the tests that wait: five minutes in all, and one minute of CPU time."""
_COSTS_KEY: Final = "heli/cpu_s"
"""Key of the costs of the last run in pytest's cache."""
_START: Final = pytest.StashKey[float]()
_ALL_LEFT_OUT: Final = re.compile(rf"^pytestmark = pytest\.mark\.({'|'.join(GUESSED_S)})$", re.MULTILINE)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--quick", action="store_true", help=f"run only tests without the markers {', '.join(GUESSED_S)}"
    )


def pytest_configure(config: pytest.Config) -> None:
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(_Account(config), "heli-account")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    if not config.getoption("--quick") or collection_path.suffix != ".py":
        return None
    # None leaves the decision to other plugins.
    return True if _ALL_LEFT_OUT.search(collection_path.read_text(encoding="utf-8")) else None


# Before the hook of xdist, which appends the group to the name of a test.
@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--quick"):
        expensive = [item for item in items if _marker(item)]
        config.hook.pytest_deselected(items=expensive)
        items[:] = [item for item in items if not _marker(item)]
    if not hasattr(config, "workerinput"):
        return
    cache = getattr(config, "cache", None)
    known_s: dict[str, float] = cache.get(_COSTS_KEY, {}) if cache is not None else {}
    groups = {item: group_of(item) for item in items}
    total_s: dict[str, float] = defaultdict(float)
    for item, group in groups.items():
        total_s[group] += known_s.get(item.nodeid, GUESSED_S.get(_marker(item), UNMARKED_S))
    items.sort(key=lambda item: (groups[item] != REAL_TIME, -total_s[groups[item]], groups[item]))
    for item, group in groups.items():
        if not any(item.iter_markers("xdist_group")):
            item.add_marker(pytest.mark.xdist_group(group))


def group_of(item: pytest.Item) -> str:
    """Return the group of a test."""
    names = {str(mark.args[0]) for mark in item.iter_markers("xdist_group")}
    return "_".join(sorted(names)) or item.nodeid.partition("::")[0]


def _marker(item: pytest.Item) -> str:
    """Return the marker of an expensive test, or nothing."""
    return next((name for name in GUESSED_S if item.get_closest_marker(name)), "")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, Any, Any]:
    item.stash[_START] = spent_s()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    report = yield
    # xdist sends the attributes of a report from a worker to the main process.
    if call.when == "teardown":
        vars(report)["cpu_s"] = spent_s() - item.stash[_START]
        vars(report)["max_s"] = MAX_S.get(_marker(item))
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["cpu_s"] = spent_s()


class _Account:
    """Adds up the costs of a run, for its last lines and for the order of the next run."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._cost_s: dict[str, float] = {}
        self._above: list[str] = []
        self._workers_s = 0.0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when != "teardown":
            return
        cost_s, max_s = getattr(report, "cpu_s", 0.0), getattr(report, "max_s", None)
        name = plain(report.nodeid)
        self._cost_s[name] = cost_s
        if max_s is not None and cost_s > max_s:
            self._above.append(f"{name}: {cost_s:.1f} s of CPU, limit {max_s:g} s")

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: object) -> None:
        self._workers_s += getattr(node, "workeroutput", {}).get("cpu_s", 0.0)

    def pytest_sessionfinish(self) -> None:
        cache = getattr(self._config, "cache", None)
        if cache is not None and self._cost_s:
            rounded = {name: round(cost_s, 3) for name, cost_s in self._cost_s.items()}
            cache.set(_COSTS_KEY, {**cache.get(_COSTS_KEY, {}), **rounded})

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self._cost_s:
            return
        # Each worker reports its CPU time, with its children; workers may not have ended yet.
        all_s = self._workers_s + time.process_time() if self._workers_s else spent_s()
        highest = sorted(self._cost_s.items(), key=lambda cost: -cost[1])[:5]
        listed = ", ".join(f"{name.rpartition('::')[2]} {cost_s:.1f}" for name, cost_s in highest)
        terminalreporter.write_line(
            f"{all_s:.1f} s of CPU, of which {all_s - sum(self._cost_s.values()):.1f} to start and collect; "
            f"most expensive: {listed}"
        )
        for text in sorted(self._above):
            terminalreporter.write_line(f"make it cheaper, or mark it as medium or slow: {text}")


def plain(nodeid: str) -> str:
    """Return the name of a test without the group that xdist appends."""
    name, at, group = nodeid.rpartition("@")
    return name if at and not group.endswith("]") else nodeid
