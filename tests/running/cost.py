"""CPU time of tests, and the limit above which a test needs a marker.

The cost of a test is the CPU time that it would need alone. It includes set-up and call, and each shared
fixture and kept result that the test uses, whichever test made them. So no test passes only because
another one ran first. Child processes count once they have ended. Waiting costs nothing.

On a busy machine the same work takes up to three times the CPU time. A test above its limit is therefore
compared with the machine. A fixed piece of work, which takes `IDLE_WORK_S` on an idle machine, is timed right
after the test, and the cost is divided by the ratio.

This correction is not exact: a build server once failed four tests that were within their limits elsewhere.
So a test above its limit passes and is listed after the run, and `python -m tests.running.costs`, which is
called on an idle machine, refuses to save such a run.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Generator
from typing import Any, Final

import pytest

from tests.running.clock import spent_s
from tests.running.kept import KEPT

UNLIMITED: Final = ("slow", "emulated", "documents", "diagnosis")
"""Markers of tests without a limit; `make quick` leaves these tests out."""
MEDIUM: Final = "medium"
"""Marker of a test that flies, fits or starts a program for a moment; `make quick` leaves it out, too."""
IDLE_WORK_S: Final = 0.0064
"""CPU time of `_work` on an idle core of the machine where the limits were set, Python 3.11."""
COSTS_KEY: Final = "heli/cpu_s"
"""Key of the costs of the last run in pytest's cache."""
ABOVE_KEY: Final = "heli/above_limit"
"""Key of the tests above their limits in the last run, with what to do, in pytest's cache."""


def slowness() -> float:
    """Return the time of a fixed piece of work relative to an idle machine, at least 1."""
    return max(1.0, statistics.median(_work() for _ in range(9)) / IDLE_WORK_S)


def _work() -> float:
    start_s = time.thread_time()
    value = 0
    for i in range(100_000):
        value = (value * 31 + i) % 1_000_003
    return time.thread_time() - start_s


class Costs:
    """Measures the tests of one process.

    Parameters
    ----------
    unmarked_s, medium_s : float
        Limit of a test without a marker, and of a medium test.
    """

    def __init__(self, unmarked_s: float, medium_s: float) -> None:
        self._limits_s = (unmarked_s, medium_s)
        self._shared: dict[tuple[str, str], float] = {}
        self._within: list[float] = [0.0]
        self._phase_s: dict[str, float] = {}
        self._unshared_s = 0.0

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(
        self, fixturedef: pytest.FixtureDef[Any], request: pytest.FixtureRequest
    ) -> Generator[None, Any, Any]:
        self._within.append(0.0)
        start_s = KEPT.charged_s()
        try:
            return (yield)
        finally:
            # The cost of fixtures that this one requested in its body belongs to them.
            all_s, others_s = KEPT.charged_s() - start_s, self._within.pop()
            apart_s = others_s
            if fixturedef.scope != "function":
                self._shared[fixturedef.argname, fixturedef.baseid] = all_s - others_s
                apart_s = all_s
            self._within[-1] += apart_s

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self) -> Generator[None, Any, Any]:
        self._unshared_s = 0.0
        return (yield from self._phase("setup"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_call(self) -> Generator[None, Any, Any]:
        return (yield from self._phase("call"))

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_teardown(self) -> Generator[None, Any, Any]:
        return (yield from self._phase("teardown"))

    def _phase(self, name: str) -> Generator[None, Any, Any]:
        self._within = [0.0]
        real_s, start_s = spent_s(), KEPT.charged_s()
        try:
            return (yield)
        finally:
            self._phase_s[name] = spent_s() - real_s
            self._unshared_s += KEPT.charged_s() - start_s - self._within[0]

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_makereport(
        self, item: pytest.Item, call: pytest.CallInfo[None]
    ) -> Generator[None, pytest.TestReport, pytest.TestReport]:
        report = yield
        # xdist sends the attributes of a report from a worker to the main process.
        vars(report)["cpu_s"] = self._phase_s.pop(call.when, 0.0)
        if (
            call.when == "call"
            and report.passed
            and not any(item.get_closest_marker(name) for name in UNLIMITED)
        ):
            self._check_limit(item, report)
        return report

    def _check_limit(self, item: pytest.Item, report: pytest.TestReport) -> None:
        is_medium = item.get_closest_marker(MEDIUM) is not None
        limit_s = self._limits_s[is_medium]
        names = set(getattr(item, "fixturenames", ()))
        alone_s = self._unshared_s + sum(
            cost_s
            for (name, base), cost_s in self._shared.items()
            if name in names and item.nodeid.startswith(base)
        )
        if alone_s <= limit_s:
            return
        times = slowness()
        if alone_s / times > limit_s:
            allowing = UNLIMITED if is_medium else (MEDIUM, *UNLIMITED)
            vars(report)["above_limit"] = (
                f"{alone_s:.1f} s of CPU, on a machine that is {times:.1f} times slower than an idle one; "
                f"make a test above {limit_s:g} s cheaper, or mark it as one of {', '.join(allowing)}"
            )


class Account:
    """Adds up the costs of a run, for its last lines and for the order of the next run.

    Parameters
    ----------
    config : pytest.Config
        Configuration of the main process.
    """

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._cost_s: dict[str, float] = {}
        self._above_limit: dict[str, str] = {}
        self._workers_s = 0.0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        name = plain(report.nodeid)
        self._cost_s[name] = self._cost_s.get(name, 0.0) + getattr(report, "cpu_s", 0.0)
        if what_to_do := getattr(report, "above_limit", None):
            self._above_limit[name] = what_to_do

    @pytest.hookimpl(optionalhook=True)
    def pytest_testnodedown(self, node: Any, error: object) -> None:
        self._workers_s += getattr(node, "workeroutput", {}).get("cpu_s", 0.0)

    def pytest_sessionfinish(self) -> None:
        cache = getattr(self._config, "cache", None)
        if cache is not None and self._cost_s:
            known = {**cache.get(COSTS_KEY, {}), **{name: round(s, 3) for name, s in self._cost_s.items()}}
            cache.set(COSTS_KEY, known)
            cache.set(ABOVE_KEY, self._above_limit)

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if not self._cost_s:
            return
        # Each worker reports its CPU time, with its children; workers may not have ended yet.
        all_s = self._workers_s + time.process_time() if self._workers_s else spent_s()
        tests_s = sum(self._cost_s.values())
        highest = sorted(self._cost_s.items(), key=lambda cost: -cost[1])[:5]
        listed = ", ".join(f"{name.rpartition('::')[2]} {cost_s:.1f}" for name, cost_s in highest)
        terminalreporter.write_line(
            f"{all_s:.1f} s of CPU, of which {all_s - tests_s:.1f} to start and collect; "
            f"most expensive: {listed}"
        )
        for name, what_to_do in sorted(self._above_limit.items()):
            terminalreporter.write_line(f"above its limit: {name}: {what_to_do}")


def plain(nodeid: str) -> str:
    """Return the name of a test without the group that xdist appends."""
    name, at, group = nodeid.rpartition("@")
    return name if at and not group.endswith("]") else nodeid


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addini("unmarked_cpu_s", "most CPU seconds of a test without a marker", default="1")
    parser.addini("medium_cpu_s", "most CPU seconds of a test marked as medium", default="2")


def pytest_configure(config: pytest.Config) -> None:
    unmarked_s, medium_s = (float(config.getini(name)) for name in ("unmarked_cpu_s", "medium_cpu_s"))
    config.pluginmanager.register(Costs(unmarked_s, medium_s), "heli-costs")
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Account(config), "heli-account")


def pytest_sessionfinish(session: pytest.Session) -> None:
    if hasattr(session.config, "workeroutput"):
        session.config.workeroutput["cpu_s"] = spent_s()
