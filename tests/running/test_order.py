"""The tests of a file stay together, documents alone, and the dearest group goes first."""

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
    """The tests above, and then the cheap one of a file of its own, as a worker would run them."""
    pytester.makeini("[pytest]\nmarkers =\n  slow\n  documents\n")
    items = pytester.getitems(tests)
    cache = SimpleNamespace(get={COSTS_KEY: known_s}.get)
    config: Any = SimpleNamespace(cache=cache, **({"workerinput": {}} if worker else {}))
    pytest_collection_modifyitems(config, items)
    return items


def names(items: list[pytest.Item]) -> list[str]:
    return [item.name for item in items]


def test_without_a_known_cost_markers_tell_which_group_is_dearest(pytester: pytest.Pytester) -> None:
    assert names(ordered(pytester, {})) == ["test_document", "test_cheap", "test_slow", "test_other_document"]


def test_the_cost_of_the_last_run_tells_it_better(pytester: pytest.Pytester) -> None:
    file = "test_the_cost_of_the_last_run_tells_it_better.py"
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


def test_a_clone_that_has_run_nothing_goes_by_what_is_written_down(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = "test_a_clone_that_has_run_nothing_goes_by_what_is_written_down.py"
    monkeypatch.setattr(order, "written_down_s", lambda: {f"{file}::test_other_document": 9.0})
    assert names(ordered(pytester, {}))[0] == "test_other_document"
    # What ran here is known better.
    assert names(ordered(pytester, {f"{file}::test_document": 0.3}))[0] == "test_document"


def test_what_flies_in_real_time_goes_before_all_that_costs_more(pytester: pytest.Pytester) -> None:
    assert names(ordered(pytester, {}, tests=TESTS + WAITS))[0] == "test_that_waits"


def test_a_file_is_a_group_and_a_document_one_of_its_own(pytester: pytest.Pytester) -> None:
    groups = {item.name: group_of(item) for item in ordered(pytester, {})}
    assert (
        groups["test_cheap"]
        == groups["test_slow"]
        == "test_a_file_is_a_group_and_a_document_one_of_its_own.py"
    )
    assert groups["test_document"] == "document-b.md"
    assert groups["test_other_document"] == "document-a.md"


def test_one_process_keeps_the_order_of_the_file(pytester: pytest.Pytester) -> None:
    items = ordered(pytester, {}, worker=False)
    assert names(items) == ["test_cheap", "test_slow", "test_document", "test_other_document"]
    assert not any(items[0].iter_markers("xdist_group"))


def test_two_workers_share_files_out_and_never_the_tests_of_one(
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
    words = ("-n2", "-p", "tests.running.order", "-p", "no:cacheprovider")
    pytester.runpytest_subprocess(*words).assert_outcomes(passed=12)
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
def test_a_test_has_one_name_whoever_runs_it(nodeid: str, name: str) -> None:
    assert plain(nodeid) == name
