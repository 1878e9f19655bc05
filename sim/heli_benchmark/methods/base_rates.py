"""Base rates: the answer of a method that does not look at the flights."""

from __future__ import annotations

from typing import Any

from heli_benchmark.task import Answer, BenchmarkCase, answer_content


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Return the base rates of a case's causes."""
    return answer_content(Answer(case.causes.base_rates))
