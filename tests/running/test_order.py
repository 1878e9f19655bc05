"""The tests of a file stay together, each document is a group, and the most expensive group is first."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.running import order
from tests.running.cost import COSTS_KEY, plain
from tests.running.order import REAL_TIME, group_of, pytest_collection_modifyitems

pytestmark = pytest.mark.medium

pytest_plugins = ["pytester"]

ROOT = Path(__file__).resolve().parents[2]
TESTS = """
import pytest

def test_cheap(): pass

@pytest.mark.slow
def test_slow(): pass

@pytest.mark.documents
@pytest.mark.xdist_group("document-b.md")
def test_document(): pass

@pytest.mark.xdist_group("document-a.md")
def test_other_document(): pass
"""
WAITS = f"""
@pytest.mark.xdist_group("{REAL_TIME}")
def test_that_waits(): pass
"""


def ordered(
    pytester: pytest.Pytester, known_s: dict[str, float], *, worker: bool = True, tests: str = TESTS
) -> list[pytest.Item]:
    """Return tests in the order in which a worker would run them."""
    pytester.makeini("[pytest]\nmarkers =\n  slow\n  documents\n")
    items = pytester.getitems(tests)
    cache = SimpleNamespace(get={COSTS_KEY: known_s}.get)
    config: Any = SimpleNamespace(cache=cache, **({"workerinput": {}} if worker else {}))
    pytest_collection_modifyitems(config, items)
    return items


def names(items: list[pytest.Item]) -> list[str]:
    return [item.name for item in items]


def test_without_known_costs_markers_decide_the_order(pytester: pytest.Pytester) -> None:
    assert names(ordered(pytester, {})) == ["test_document", "test_cheap", "test_slow", "test_other_document"]


def test_costs_of_the_last_run_decide_the_order(pytester: pytest.Pytester) -> None:
    file = "test_costs_of_the_last_run_decide_the_order.py"
    known_s = {
        f"{file}::test_other_document": 50.0,
        f"{file}::test_document": 1.0,
        f"{file}::test_cheap": 9.0,
    }
    assert names(ordered(pytester, known_s)) == [
        "test_other_document",
        "test_cheap",
        "test_slow",
        "test_document",
    ]


def test_a_clone_that_has_run_nothing_uses_the_saved_costs(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = "test_a_clone_that_has_run_nothing_uses_the_saved_costs.py"
    monkeypatch.setattr(order, "saved_costs_s", lambda: {f"{file}::test_other_document": 9.0})
    assert names(ordered(pytester, {}))[0] == "test_other_document"
    # Costs of a run in this clone have priority.
    assert names(ordered(pytester, {f"{file}::test_document": 0.3}))[0] == "test_document"


def test_flights_in_real_time_run_before_more_expensive_tests(pytester: pytest.Pytester) -> None:
    assert names(ordered(pytester, {}, tests=TESTS + WAITS))[0] == "test_that_waits"


def test_each_file_and_each_document_is_a_group(pytester: pytest.Pytester) -> None:
    groups = {item.name: group_of(item) for item in ordered(pytester, {})}
    assert groups["test_cheap"] == groups["test_slow"] == "test_each_file_and_each_document_is_a_group.py"
    assert groups["test_document"] == "document-b.md"
    assert groups["test_other_document"] == "document-a.md"


def test_one_process_keeps_the_order_of_the_file(pytester: pytest.Pytester) -> None:
    items = ordered(pytester, {}, worker=False)
    assert names(items) == ["test_cheap", "test_slow", "test_document", "test_other_document"]
    assert not any(items[0].iter_markers("xdist_group"))


def test_the_tests_of_a_file_run_in_one_worker(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeini("[pytest]\naddopts = --dist=loadgroup --no-loadscope-reorder\n")
    test = """
    import os, time
    from pathlib import Path
    import pytest
    @pytest.mark.parametrize("number", range(6))
    def test_of_a_file(number):
        time.sleep(0.05)
        with Path(__file__).with_suffix(".txt").open("a") as file:
            print(os.environ["PYTEST_XDIST_WORKER"], file=file)
    """
    pytester.makepyfile(test_one=test, test_two=test)
    arguments = ("-n2", "-p", "tests.running.order", "-p", "no:cacheprovider")
    pytester.runpytest_subprocess(*arguments).assert_outcomes(passed=12)
    workers = [set((pytester.path / f"test_{name}.txt").read_text().split()) for name in ("one", "two")]
    assert sorted(map(sorted, workers)) == [["gw0"], ["gw1"]]


@pytest.mark.parametrize(
    ("nodeid", "name"),
    [
        ("tests/log/test_log.py::test_cut@tests/log/test_log.py", "tests/log/test_log.py::test_cut"),
        ("test_a.py::test_b[who@where]@group", "test_a.py::test_b[who@where]"),
        ("test_a.py::test_b[who@where]", "test_a.py::test_b[who@where]"),
        ("test_a.py::test_b", "test_a.py::test_b"),
    ],
)
def test_a_test_has_the_same_name_in_each_worker(nodeid: str, name: str) -> None:
    assert plain(nodeid) == name
