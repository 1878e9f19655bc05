"""An expensive test without a marker is listed; the cost of a shared fixture is part of each of its tests."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.running import clock, cost
from tests.running.costs import save
from tests.running.kept import KEPT

pytestmark = pytest.mark.medium

pytest_plugins = ["pytester"]

LIMIT_S = 0.05
MEDIUM_S = 0.3
HEAD = """
import subprocess, sys, time
import pytest

def burn(seconds=0.4):
    end_s = time.process_time() + seconds
    while time.process_time() < end_s:
        pass
"""


def above_limit(pytester: pytest.Pytester, tests: str) -> set[str]:
    """Run tests with the limits `LIMIT_S` and `MEDIUM_S`, and return the names listed as above them."""
    pytester.makeini(
        f"[pytest]\nunmarked_cpu_s = {LIMIT_S}\nmedium_cpu_s = {MEDIUM_S}\nmarkers =\n  medium\n  slow\n"
    )
    pytester.makepyfile(HEAD + tests)
    result = pytester.runpytest_inprocess("-p", "tests.running.cost", "-p", "no:cacheprovider")
    assert result.ret == 0
    listed = [line for line in result.outlines if line.startswith("above its limit: ")]
    return {line.split("::")[1].partition(":")[0] for line in listed}


def test_an_expensive_test_without_a_marker_is_listed(pytester: pytest.Pytester) -> None:
    tests = """
def test_cheap(): pass

def test_expensive(): burn()

@pytest.mark.slow
def test_expensive_and_marked(): burn()
"""
    assert above_limit(pytester, tests) == {"test_expensive"}


def test_a_medium_test_has_another_limit(pytester: pytest.Pytester) -> None:
    tests = """
@pytest.mark.medium
def test_medium(): burn(0.1)

@pytest.mark.medium
def test_expensive(): burn(1.0)
"""
    assert above_limit(pytester, tests) == {"test_expensive"}


def test_the_message_names_limit_and_remedy(pytester: pytest.Pytester) -> None:
    pytester.makeini(f"[pytest]\nunmarked_cpu_s = {LIMIT_S}\nmarkers = slow\n")
    pytester.makepyfile(HEAD + "def test_expensive(): burn()\n")
    result = pytester.runpytest_inprocess("-p", "tests.running.cost", "-p", "no:cacheprovider")
    result.stdout.fnmatch_lines(["*make a test above 0.05 s cheaper, or mark it as one of medium, slow, *"])
    result.stdout.fnmatch_lines(
        ["* s of CPU, of which * to start and collect; most expensive: test_expensive *"]
    )


def test_the_time_of_a_child_counts_and_waiting_does_not(pytester: pytest.Pytester) -> None:
    tests = """
def test_child():
    subprocess.run([sys.executable, "-S", "-c", "for i in range(8_000_000): pass"], check=True)

def test_waiting(): time.sleep(0.3)
"""
    assert above_limit(pytester, tests) == {"test_child"}


def test_a_fixture_counts_for_each_test_that_uses_it(pytester: pytest.Pytester) -> None:
    tests = """
@pytest.fixture(scope="module")
def flight(): burn()

@pytest.fixture
def board(): burn()

def test_first(flight): pass

def test_second(flight): pass

def test_with_unshared(board): pass

def test_none(): pass
"""
    assert above_limit(pytester, tests) == {"test_first", "test_second", "test_with_unshared"}


def test_a_kept_result_counts_for_each_test_that_uses_it(pytester: pytest.Pytester) -> None:
    tests = f"""
from pathlib import Path
from tests.running.kept import KEPT

def kept_flight():
    KEPT.folder = Path({str(pytester.path)!r}) / "kept"
    return KEPT("flight", burn, made_by=[], rooms=[])

def test_first(): kept_flight()

def test_second(): kept_flight()
"""
    folder = KEPT.folder
    try:
        assert above_limit(pytester, tests) == {"test_first", "test_second"}
    finally:
        KEPT.folder = folder


@pytest.mark.parametrize("above", [{}, {"tests/test_a.py::test_b": "make it cheaper"}])
def test_only_a_run_within_the_limits_is_saved(tmp_path: Path, above: dict[str, str]) -> None:
    table = tmp_path / "costs.json"
    for key, value in ((cost.ABOVE_KEY, above), (cost.COSTS_KEY, {"cheap": 0.1, "expensive": 3.04})):
        (tmp_path / key).parent.mkdir(exist_ok=True)
        (tmp_path / key).write_text(json.dumps(value))
    assert len(save(tmp_path, table)) == len(above)
    assert table.exists() is not bool(above)
    if not above:
        assert json.loads(table.read_text()) == {"expensive": 3.0}


def test_a_busy_machine_makes_no_test_expensive(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cost, "slowness", lambda: 1000.0)
    assert above_limit(pytester, "def test_expensive(): burn()\n") == set()


def test_no_machine_counts_as_faster_than_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "_work", lambda: 0.1 * cost.IDLE_WORK_S)
    assert cost.slowness() == 1.0
    monkeypatch.setattr(cost, "_work", lambda: 3.0 * cost.IDLE_WORK_S)
    assert cost.slowness() == pytest.approx(3.0)


def test_the_charge_for_a_running_child_can_be_taken_back() -> None:
    before_s = clock.spent_s()
    clock.charge(1000.0)
    assert clock.spent_s() - before_s >= 1000.0
    clock.charge(-1000.0)
    assert clock.spent_s() - before_s < 1000.0
