"""The tests of a file stay together, the most expensive group is first, and a run says what is expensive."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from tests.running import alone
from tests.running.order import REAL_TIME, group_of, plain, pytest_collection_modifyitems

pytestmark = pytest.mark.medium

pytest_plugins = ["pytester"]

ROOT = Path(__file__).resolve().parents[2]
MARKERS = "markers =\n  medium\n  slow\n  emulated\n  documents\n"
TESTS = f"""
import pytest

def test_cheap(): pass

@pytest.mark.slow
def test_slow(): pass

@pytest.mark.documents
@pytest.mark.xdist_group("document-b.md")
def test_document(): pass

@pytest.mark.xdist_group("document-a.md")
def test_other_document(): pass

@pytest.mark.xdist_group("{REAL_TIME}")
def test_that_waits(): pass
"""


def ordered(
    pytester: pytest.Pytester, known_s: dict[str, float], *, worker: bool = True
) -> list[pytest.Item]:
    """Return tests in the order in which a worker would run them."""
    pytester.makeini(f"[pytest]\n{MARKERS}")
    items = pytester.getitems(TESTS)
    cache = SimpleNamespace(get=lambda key, default: known_s)
    config: Any = SimpleNamespace(
        cache=cache, getoption=lambda name: False, **({"workerinput": {}} if worker else {})
    )
    pytest_collection_modifyitems(config, items)
    return items


def names(items: list[pytest.Item]) -> list[str]:
    return [item.name.removeprefix("test_") for item in items]


def test_flights_in_real_time_are_first_then_markers_or_known_costs_decide(pytester: pytest.Pytester) -> None:
    items = ordered(pytester, {})
    assert names(items) == ["that_waits", "document", "cheap", "slow", "other_document"]
    groups = {item.name: group_of(item) for item in items}
    file = items[0].nodeid.partition("::")[0]
    assert groups["test_cheap"] == groups["test_slow"] == file
    assert groups["test_document"] == "document-b.md"
    known_s = {
        f"{file}::test_{name}": cost_s
        for name, cost_s in (("other_document", 50.0), ("document", 1.0), ("cheap", 9.0))
    }
    assert names(ordered(pytester, known_s)) == ["that_waits", "other_document", "cheap", "slow", "document"]


def test_one_process_keeps_the_order_of_the_file(pytester: pytest.Pytester) -> None:
    items = ordered(pytester, {}, worker=False)
    assert names(items) == ["cheap", "slow", "document", "other_document", "that_waits"]
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
    result = pytester.runpytest_subprocess(*arguments)
    result.assert_outcomes(passed=12)
    result.stdout.fnmatch_lines(
        ["* s of CPU, of which * to start and collect; most expensive: test_of_a_file*"]
    )
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


def test_quick_leaves_expensive_tests_out_and_does_not_import_their_files(pytester: pytest.Pytester) -> None:
    pytester.makeini(f"[pytest]\n{MARKERS}")
    pytester.makepyfile(
        test_mixed=TESTS,
        test_expensive="""
        import pytest

        pytestmark = pytest.mark.emulated

        raise AssertionError("imported")
        """,
    )
    result = pytester.runpytest_inprocess("-p", "tests.running.order", "--quick", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, deselected=2)


def test_an_expensive_test_is_listed_unless_it_has_a_marker(pytester: pytest.Pytester) -> None:
    pytester.makeini(f"[pytest]\n{MARKERS}")
    pytester.makepyfile("""
        import pytest
        from tests.running import alone

        def test_waiting(): alone.charge(1.5)

        @pytest.mark.medium
        def test_medium(): alone.charge(1.5)

        @pytest.mark.slow
        def test_slow(): alone.charge(9)
        """)
    result = pytester.runpytest_inprocess("-p", "tests.running.order", "-p", "no:cacheprovider")
    alone.charge(-12.0)
    listed = [line for line in result.outlines if line.startswith("make it cheaper")]
    assert [line.rpartition("::")[2] for line in listed] == ["test_waiting: 1.5 s of CPU, limit 1 s"]
