"""An engineer's way: smoothed accelerations, and stepwise regression of their residuals by BIC."""

from __future__ import annotations

import math
from typing import Any, Final

from heli_benchmark.methods.terms import ResidualRegression, Term, residual_regression, torques_of_terms
from heli_benchmark.task import UNLISTED, BenchmarkCase, answer_with

MAX_TERMS: Final = 5
_MIN_NATS: Final = 50.0
"""Evidence that a term needs. Tuned: the choice among thirty candidates would need only 3 (ln 30)."""
_SHARPNESS: Final = 0.5
"""A regression that ignores the errors of its terms is too certain; half the evidence counts. A guess."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Diagnose a case by stepwise regression."""
    regression = residual_regression(case)
    chosen, gains_nats = selected(regression)
    named = {
        term.cause: 1.0 / (1.0 + math.exp(min(50.0, _SHARPNESS * (_MIN_NATS - gain))))
        for term, gain in zip(chosen, gains_nats, strict=True)
    }
    named.setdefault(UNLISTED, 0.5 * case.causes.base_rates[UNLISTED])
    answer = answer_with(case.causes, named, regression.parameters(chosen))
    return answer | torques_of_terms(case, regression, chosen)


def selected(regression: ResidualRegression) -> tuple[list[Term], list[float]]:
    """Select terms one by one, while the BIC decreases by more than the number of candidates costs."""
    chosen: list[Term] = []
    gains_nats: list[float] = []
    bic = regression.fit([]).bic
    while len(chosen) < MAX_TERMS:
        causes = {term.cause for term in chosen}
        candidates = [term for term in regression.terms if term.cause not in causes]
        bics = [regression.fit([*chosen, term]).bic for term in candidates]
        best = min(range(len(candidates)), key=bics.__getitem__)
        gain_nats = 0.5 * (bic - bics[best])
        if gain_nats <= _MIN_NATS:
            break
        chosen.append(candidates[best])
        gains_nats.append(gain_nats)
        bic = bics[best]
    return chosen, gains_nats
