"""LISDD ("Where Is My Physics Wrong?", arXiv 2606.23215), after its abstract: local, sparse discrepancies.

Rig parameters are fitted in clean regimes. A regime with too much residual energy gets the term with the
lowest hold-out error, and an F-test on a third part of its samples confirms the term.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from scipy.stats import chi2, f
from sklearn.cluster import KMeans
from statsmodels.stats.multitest import multipletests

from heli_benchmark.methods.terms import ResidualRegression, Term, residual_regression, torques_of_terms
from heli_benchmark.task import NOTHING, BenchmarkCase, answer_with

_REGIMES: Final = 6
_BLOCK: Final = 150
"""Rows of the blocks that serve fit, hold-out and test in turn: 5 s, longer than the disturbances last."""
_FALSE_DISCOVERIES: Final = 1e-6
"""Tuned. The paper's tests are exact for independent noise, and the noise of flights is correlated."""
_CONFIRMED: Final = 0.8
"""Probability of a cause whose term is confirmed."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Diagnose a case by local discrepancies."""
    regression = residual_regression(case)
    labels = KMeans(_REGIMES, n_init=4, random_state=0).fit_predict(regression.features)
    # Rows of the whitened regression are (moment, axis), without the first moment.
    regimes = np.repeat(labels[1:], 3)
    block_roles = np.arange(len(regimes)) // _BLOCK % 3
    residual = _clean_residual(regression, regimes)
    in_regime = [regimes == regime for regime in range(_REGIMES)]
    energy_p_values = [chi2.sf(residual[rows] @ residual[rows], rows.sum()) for rows in in_regime]
    terms, p_values = [], []
    for regime in np.flatnonzero(multipletests(energy_p_values, _FALSE_DISCOVERIES, "fdr_bh")[0]):
        fit, held_out, test = (in_regime[regime] & (block_roles == role) for role in range(3))
        terms.append(min(regression.terms, key=lambda term: _held_out_error(term, residual, fit, held_out)))
        p_values.append(_p_value(terms[-1], residual, test))
    confirmed = multipletests(p_values, _FALSE_DISCOVERIES, "fdr_bh")[0] if terms else []
    chosen = {term.cause: term for term, is_real in zip(terms, confirmed, strict=True) if is_real}
    named = dict.fromkeys(chosen, _CONFIRMED) or {NOTHING: 0.5}
    answer = answer_with(case.causes, named, regression.parameters([*chosen.values()]))
    return answer | torques_of_terms(case, regression, [*chosen.values()])


def _clean_residual(regression: ResidualRegression, regimes: np.ndarray) -> Floats:
    """Fit the rig parameters to the clean regimes, and return the residual in units of its noise there."""
    # The clean regimes are the half with the least residual energy. Fit and choice are repeated three times.
    is_clean = np.ones(len(regimes), bool)
    prior = np.eye(regression.nuisance.shape[1])
    for _ in range(3):
        design = np.vstack([regression.nuisance[is_clean], prior])
        target = np.concatenate([regression.target[is_clean], np.zeros(len(prior))])
        residual = regression.target - regression.nuisance @ np.linalg.lstsq(design, target)[0]
        energies = [float(np.mean(residual[regimes == regime] ** 2)) for regime in range(_REGIMES)]
        is_clean = np.isin(regimes, np.argsort(energies)[: _REGIMES // 2])
    return np.asarray(residual / residual[is_clean].std())


def _held_out_error(term: Term, residual: Floats, fit: np.ndarray, held_out: np.ndarray) -> float:
    """Fit a term to the rows `fit`, and return its squared error on the rows `held_out`."""
    size = np.linalg.lstsq(term.columns[fit], residual[fit])[0]
    return float(np.sum((residual[held_out] - term.columns[held_out] @ size) ** 2))


def _p_value(term: Term, residual: Floats, test: np.ndarray) -> float:
    """Return the p-value of an F-test: does the term explain a part of the residual on the rows `test`?"""
    columns, before = term.columns[test], residual[test]
    coefficient_count = columns.shape[1]
    degrees_of_freedom = len(before) - coefficient_count
    if degrees_of_freedom <= 0:
        return 1.0
    after = before - columns @ np.linalg.lstsq(columns, before)[0]
    explained_variance = (before @ before - after @ after) / coefficient_count
    ratio = explained_variance / (after @ after / degrees_of_freedom)
    return float(f.sf(ratio, coefficient_count, degrees_of_freedom))
