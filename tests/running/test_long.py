"""`make test` runs a share of each kind, the same in every run; `make long` runs all."""

from __future__ import annotations

import pytest

from tests.running import long
from tests.running.long import parallel_map, samples

CASES = [f"{kind}{number}" for kind, count in (("a", 7), ("b", 1), ("c", 4)) for number in range(count)]


def kind_of(case: str) -> str:
    return case[0]


def test_a_share_has_at_least_one_case_of_each_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "LONG", False)
    assert parallel_map(CASES, every=3, kind=kind_of) == ["a0", "a3", "a6", "b0", "c0", "c3"]
    assert parallel_map(CASES, every=5) == ["a0", "a5", "c2"]
    assert samples(200, 8) == 8


def test_long_runs_all(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "LONG", True)
    assert parallel_map(CASES, every=3, kind=kind_of) == CASES
    assert samples(200, 8) == 200
