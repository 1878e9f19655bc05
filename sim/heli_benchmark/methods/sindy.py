"""PySINDy: sparse regression with an ensemble, in weak form, with the terms of the stepwise regression."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from pysindy.optimizers import STLSQ, EnsembleOptimizer

from heli_benchmark.methods.equation_torques import torques_of_terms
from heli_benchmark.methods.terms import Term, residual_regression
from heli_benchmark.task import BenchmarkCase, Estimate, answer_with

_MODELS: Final = 10
_THRESHOLD: Final = 0.7
"""Smallest coefficient of a scaled term that STLSQ keeps; its square is a share of the variance. Tuned."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Diagnose a case by sparse regression."""
    regression = residual_regression(case, weak_form=True)
    # The nuisance parameters are not sparse: they are projected out, within their priors.
    known = regression.nuisance
    onto = np.linalg.solve(known.T @ known + np.eye(known.shape[1]), known.T)
    target = regression.target - known @ (onto @ regression.target)
    best: dict[str, Term] = {}
    for term in regression.terms:
        # A cause with an unknown moment or frequency enters once, and so does each shape of an unlisted one.
        key = term.cause if term.parameters else f"{term.cause} {len(best)}"
        if key not in best or regression.fit([term])[0] < regression.fit([best[key]])[0]:
            best[key] = term
    terms = [term for key, term in best.items() if key != "input_delay"]
    columns = np.column_stack([term.columns - known @ (onto @ term.columns) for term in terms])
    scale = columns.std(axis=0)
    np.random.seed(0)  # PySINDy draws from the global generator
    ensemble = EnsembleOptimizer(STLSQ(threshold=_THRESHOLD, alpha=1e-3), bagging=True, n_models=_MODELS)
    ensemble.fit(columns / scale, (target / target.std())[:, None])
    coefficients = np.array(ensemble.coef_list)[:, 0, :]
    named: dict[str, float] = {}
    parameters: dict[str, Estimate] = {}
    kept_terms, place = [], 0
    for term in terms:
        width = term.columns.shape[1]
        of = coefficients[:, place : place + width]
        share = float((of != 0.0).any(axis=1).mean())
        named[term.cause] = max(named.get(term.cause, 0.0), min(share, 0.98))
        kept_terms += [term] if share >= 0.5 else []
        values = of * target.std() / scale[place : place + width]
        for name, value in zip(term.parameters, values.T, strict=False):
            if share >= 0.5 and value.std() > 0.0:
                parameters[name] = Estimate(float(np.median(value)), float(value.std()))
        place += width
    kept = {name: share for name, share in named.items() if share > 0.1}
    rig = regression.parameters([term for term in terms if named[term.cause] >= 0.5])
    return answer_with(case.causes, kept, rig | parameters) | torques_of_terms(case, regression, kept_terms)
