"""Symbolic regression of the residual accelerations with pyoperon; the most similar term names each."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from pyoperon.sklearn import SymbolicRegressor

from heli_benchmark.methods.equation_torques import torques_of_accelerations
from heli_benchmark.methods.terms import ResidualRegression, residual_regression
from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, answer_with

_HELD_OUT: Final = 0.3
_MIN_R2: Final = 0.05
"""Share of the variance of held-out residuals from which an equation counts. By judgement, not tuned."""
_SIMILAR: Final = 0.8
"""Correlation of an equation with a term of the catalogue from which the term names it."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Search an equation for the residual acceleration of each axis."""
    regression = residual_regression(case)
    named: dict[str, float] = {}
    equations, unlisted = [], {}
    for axis, (r2, predicted, search) in enumerate(searched(regression)):
        if r2 < _MIN_R2 or not np.isfinite(r2):
            continue
        name, similarity = _most_similar(regression, predicted, axis)
        named[name] = max(named.get(name, 0.0), 0.6 * similarity + 0.3)
        equations.append(str(search.get_model_string(search.model_, 3)))
        if name == UNLISTED:
            unlisted[axis] = search.predict
    answer = answer_with(case.causes, named or {NOTHING: 0.7}, regression.parameters([]))
    torques = torques_of_accelerations(case, regression, unlisted)
    return answer | {"equation": "; ".join(equations)} | torques


def searched(regression: ResidualRegression) -> list[tuple[float, np.ndarray, SymbolicRegressor]]:
    """Return the held-out share of the variance, the prediction and the equation of each axis."""
    features, count = regression.features, len(regression.residuals)
    first = slice(0, round((1.0 - _HELD_OUT) * count))
    last = slice(first.stop, count)
    equations = []
    for target in regression.residuals.T:
        search = SymbolicRegressor(
            population_size=500,
            generations=200,
            max_evaluations=100_000,
            max_length=15,
            n_threads=1,
            random_state=1,
        )
        search.fit(features[first], target[first])
        predicted = np.asarray(search.predict(features)).ravel()
        error = target[last] - predicted[last]
        r2 = 1.0 - float(error @ error) / float(target[last] @ target[last])
        equations.append((r2, predicted, search))
    return equations


def _most_similar(regression: ResidualRegression, predicted: np.ndarray, axis: int) -> tuple[str, float]:
    best = (UNLISTED, 0.4)
    moved = predicted - predicted.mean()
    for term in regression.terms:
        for column in term.columns.T:
            # The rows of terms are whitened differences; sums bring back their shape along an axis.
            whole = column.reshape(-1, 3)[:, axis]
            if term.parameters and whole.std() > 0.1 * column.std():
                similarity = abs(float(np.corrcoef(whole, moved[1:])[0, 1]))
                if similarity > max(best[1], _SIMILAR):
                    best = (term.cause, similarity)
    return best
