"""A test that is dear and does not say so fails, and what it shares with others is part of what it costs."""

from __future__ import annotations

import pytest

from tests.running import clock, cost
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


def ran(pytester: pytest.Pytester, tests: str) -> dict[str, str]:
    """How each test ended, where `LIMIT_S` of CPU needs a marker and `MEDIUM_S` one of a dear test."""
    pytester.makeini(
        f"[pytest]\nunmarked_cpu_s = {LIMIT_S}\nmedium_cpu_s = {MEDIUM_S}\nmarkers =\n  medium\n  slow\n"
    )
    pytester.makepyfile(HEAD + tests)
    result = pytester.runpytest_inprocess("-v", "-p", "tests.running.cost", "-p", "no:cacheprovider")
    words = [line.split() for line in result.outlines if "::" in line and " [" in line]
    return {line[0].partition("::")[2]: line[1] for line in words}


def test_a_dear_test_without_a_marker_fails_and_is_told_what_to_do(pytester: pytest.Pytester) -> None:
    tests = """
def test_cheap(): pass

def test_dear(): burn()

@pytest.mark.slow
def test_dear_and_marked(): burn()
"""
    assert ran(pytester, tests) == {
        "test_cheap": "PASSED",
        "test_dear": "FAILED",
        "test_dear_and_marked": "PASSED",
    }


def test_a_medium_test_has_a_bound_of_its_own(pytester: pytest.Pytester) -> None:
    tests = """
@pytest.mark.medium
def test_medium(): burn(0.1)

@pytest.mark.medium
def test_dear(): burn(1.0)
"""
    assert ran(pytester, tests) == {"test_medium": "PASSED", "test_dear": "FAILED"}


def test_the_line_says_bound_and_remedy(pytester: pytest.Pytester) -> None:
    pytester.makeini(f"[pytest]\nunmarked_cpu_s = {LIMIT_S}\nmarkers = slow\n")
    pytester.makepyfile(HEAD + "def test_dear(): burn()\n")
    result = pytester.runpytest_inprocess("-p", "tests.running.cost", "-p", "no:cacheprovider")
    result.stdout.fnmatch_lines(["*a test above 0.05 s is made cheaper, or marked as one of medium, slow, *"])
    result.stdout.fnmatch_lines(["* s of CPU, of which * to start and collect; dearest: test_dear *"])


def test_a_child_s_time_counts_and_waiting_does_not(pytester: pytest.Pytester) -> None:
    tests = """
def test_child():
    subprocess.run([sys.executable, "-S", "-c", "for i in range(8_000_000): pass"], check=True)

def test_waiting(): time.sleep(0.3)
"""
    assert ran(pytester, tests) == {"test_child": "FAILED", "test_waiting": "PASSED"}


def test_a_fixture_is_paid_by_all_who_use_it_whoever_was_first(pytester: pytest.Pytester) -> None:
    tests = """
@pytest.fixture(scope="module")
def flight(): burn()

@pytest.fixture
def board(): burn()

def test_first(flight): pass

def test_second(flight): pass

def test_own(board): pass

def test_none(): pass
"""
    assert ran(pytester, tests) == {
        "test_first": "FAILED",
        "test_second": "FAILED",
        "test_own": "FAILED",
        "test_none": "PASSED",
    }


def test_what_is_kept_is_paid_by_all_who_take_it_whoever_made_it(pytester: pytest.Pytester) -> None:
    tests = f"""
from pathlib import Path
from tests.running.kept import KEPT

def taken():
    KEPT.folder = Path({str(pytester.path)!r}) / "kept"
    return KEPT("flight", burn, made_by=[], rooms=[])

def test_first(): taken()

def test_second(): taken()
"""
    folder = KEPT.folder
    try:
        assert ran(pytester, tests) == {"test_first": "FAILED", "test_second": "FAILED"}
    finally:
        KEPT.folder = folder


def test_a_busy_machine_makes_no_test_dear(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cost, "slowness", lambda: 1000.0)
    assert ran(pytester, "def test_dear(): burn()\n") == {"test_dear": "PASSED"}


def test_a_machine_is_never_taken_for_faster_than_idle(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cost, "_work", lambda: 0.1 * cost.UNHURRIED_S)
    assert cost.slowness() == 1.0
    monkeypatch.setattr(cost, "_work", lambda: 3.0 * cost.UNHURRIED_S)
    assert cost.slowness() == pytest.approx(3.0)


def test_what_is_charged_for_a_process_is_taken_back_when_it_is_waited_for() -> None:
    before_s = clock.spent_s()
    clock.charge(1000.0)
    assert clock.spent_s() - before_s >= 1000.0
    clock.charge(-1000.0)
    assert clock.spent_s() - before_s < 1000.0
