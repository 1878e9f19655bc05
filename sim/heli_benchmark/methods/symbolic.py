"""Symbolic regression of the residual accelerations with pyoperon.

An equation gets the name of the cause whose term it resembles most.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from pyoperon.sklearn import SymbolicRegressor

from heli_benchmark.methods.terms import ResidualRegression, residual_regression, torques_of_accelerations
from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, answer_with

_SETTINGS: Final = {"population_size": 500, "generations": 200, "max_evaluations": 100_000, "max_length": 15}
_HELD_OUT: Final = 0.3
"""Share of the rows, the last ones, that test an equation instead of fitting it."""
_MIN_R2: Final = 0.05
"""Share of the variance of held-out residuals that an equation must explain. By judgement, not tuned."""
_SIMILAR: Final = 0.8
"""Correlation with a term of the catalogue from which an equation gets the name of its cause."""
_UNLISTED_SIMILARITY: Final = 0.4
"""Similarity that an equation of an unlisted cause is given, for its probability. By judgement."""


@dataclass(frozen=True)
class AxisEquation:
    """An equation for the residual acceleration of one axis."""

    held_out_r2: float  # Share of the variance that it explains on the held-out rows
    predicted: np.ndarray  # (k,): Its value on all rows
    search: SymbolicRegressor  # The finished search, which holds the equation


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Search an equation for the residual acceleration of each axis."""
    regression = residual_regression(case)
    named: dict[str, float] = {}
    equations, unlisted = [], {}
    for axis, equation in enumerate(search_equations(regression)):
        if equation.held_out_r2 < _MIN_R2 or not np.isfinite(equation.held_out_r2):
            continue
        name, similarity = _most_similar(regression, equation.predicted, axis)
        # By judgement: between 0.54 for an unlisted cause and 0.9 for a perfect match.
        named[name] = max(named.get(name, 0.0), 0.6 * similarity + 0.3)
        equations.append(str(equation.search.get_model_string(equation.search.model_, 3)))
        if name == UNLISTED:
            unlisted[axis] = equation.search.predict
    answer = answer_with(case.causes, named or {NOTHING: 0.7}, regression.parameters([]))
    torques = torques_of_accelerations(case, regression, unlisted)
    return answer | {"equation": "; ".join(equations)} | torques


def search_equations(regression: ResidualRegression) -> list[AxisEquation]:
    """Search an equation of the features for the residual of each axis, and test it on held-out rows."""
    features, count = regression.features, len(regression.residuals)
    training = slice(0, round((1.0 - _HELD_OUT) * count))
    held_out = slice(training.stop, count)
    equations = []
    for target in regression.residuals.T:
        search = SymbolicRegressor(**_SETTINGS, n_threads=1, random_state=1)
        search.fit(features[training], target[training])
        predicted = np.asarray(search.predict(features)).ravel()
        error = target[held_out] - predicted[held_out]
        r2 = 1.0 - float(error @ error) / float(target[held_out] @ target[held_out])
        equations.append(AxisEquation(r2, predicted, search))
    return equations


def _most_similar(regression: ResidualRegression, predicted: np.ndarray, axis: int) -> tuple[str, float]:
    """Return the cause whose term correlates most with a prediction about an axis, and the correlation."""
    # If no term is similar enough, the cause is unlisted.
    cause, highest = UNLISTED, _UNLISTED_SIMILARITY
    centred = predicted - predicted.mean()
    for term in regression.terms:
        for column in term.columns.T:
            # Rows of a term are (moment, axis), without the first moment.
            about_axis = column.reshape(-1, 3)[:, axis]
            # A term that acts on other axes correlates only by rounding errors.
            if term.parameters and about_axis.std() > 0.1 * column.std():
                similarity = abs(float(np.corrcoef(about_axis, centred[1:])[0, 1]))
                if similarity > max(highest, _SIMILAR):
                    cause, highest = term.cause, similarity
    return cause, highest
