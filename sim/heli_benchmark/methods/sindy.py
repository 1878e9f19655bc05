"""PySINDy: sparse regression with an ensemble, in weak form, with the terms of the stepwise regression."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from pysindy.optimizers import STLSQ, EnsembleOptimizer

from heli_benchmark.methods.terms import ResidualRegression, Term, residual_regression, torques_of_terms
from heli_benchmark.task import BenchmarkCase, Estimate, answer_with

_MODELS: Final = 10
"""Models of the ensemble, each fitted to a random sample of the rows."""
_MIN_SHARE: Final = 0.5
"""Share of the models that must keep a term before its parameters are estimated."""
_THRESHOLD: Final = 0.7
"""Smallest coefficient of a scaled term that STLSQ keeps; its square is a share of the variance. Tuned."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Diagnose a case by sparse regression."""
    regression = residual_regression(case, weak_form=True)
    # The nuisance parameters are not sparse: they are projected out, within their priors.
    nuisance = regression.nuisance
    to_nuisance = np.linalg.solve(nuisance.T @ nuisance + np.eye(nuisance.shape[1]), nuisance.T)
    target = regression.target - nuisance @ (to_nuisance @ regression.target)
    terms = _best_terms(regression)
    columns = np.column_stack([term.columns - nuisance @ (to_nuisance @ term.columns) for term in terms])
    scale = columns.std(axis=0)
    # Coefficients of each model in units of the data, shape (models, columns); 0 if a model has no such term.
    coefficients = _ensemble_coefficients(columns / scale, target / target.std()) * target.std() / scale
    probability: dict[str, float] = {}
    parameters: dict[str, Estimate] = {}
    kept_terms, first_column = [], 0
    for term in terms:
        width = term.columns.shape[1]
        values = coefficients[:, first_column : first_column + width]
        first_column += width
        share = float((values != 0.0).any(axis=1).mean())  # of the models that keep this term
        # Never certain: a probability of 1 that is wrong has the largest possible loss.
        probability[term.cause] = max(probability.get(term.cause, 0.0), min(share, 0.98))
        if share < _MIN_SHARE:
            continue
        kept_terms.append(term)
        # Terms of unlisted causes have columns, but no parameters.
        for name, value in zip(term.parameters, values.T, strict=False):
            if value.std() > 0.0:
                parameters[name] = Estimate(float(np.median(value)), float(value.std()))
    # Rarer causes keep their base rates.
    named = {name: share for name, share in probability.items() if share > 0.1}
    rig = regression.parameters([term for term in terms if probability[term.cause] >= _MIN_SHARE])
    return answer_with(case.causes, named, rig | parameters) | torques_of_terms(case, regression, kept_terms)


def _best_terms(regression: ResidualRegression) -> list[Term]:
    """Return the best term of each listed cause, and all terms of unlisted causes."""
    # A listed cause has several terms if its moment or frequency is unknown.
    best: dict[str, Term] = {}
    for term in regression.terms:
        key = term.cause if term.parameters else f"{term.cause} {len(best)}"
        if key not in best or regression.fit([term]).bic < regression.fit([best[key]]).bic:
            best[key] = term
    # Lag and delay have the same term here.
    return [term for key, term in best.items() if key != "input_delay"]


def _ensemble_coefficients(columns: Floats, target: Floats) -> Floats:
    """Fit the ensemble to scaled columns, and return its coefficients, shape (models, columns)."""
    np.random.seed(0)  # PySINDy draws from the global generator
    ensemble = EnsembleOptimizer(STLSQ(threshold=_THRESHOLD, alpha=1e-3), bagging=True, n_models=_MODELS)
    ensemble.fit(columns, target[:, None])
    return np.array(ensemble.coef_list)[:, 0, :]
