"""Gradient boosting (scikit-learn), trained on the simulated flights of another split with its truth."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.arrays import Floats
from sklearn.ensemble import HistGradientBoostingClassifier

from heli_benchmark.methods.terms import ResidualRegression, residual_regression
from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, Causes, answer_with, read_case, read_split

_MODEL: Final = "boosting.pickle"
_FEWEST: Final = 3
"""Training cases with a cause from which a classifier learns it; other causes keep their base rates."""


def train(resources: Path) -> None:
    """Train one classifier per name on the cases of a split, and keep them in its folder.

    Parameters
    ----------
    resources : Path
        Folder of the training split.
    """
    split = read_split(resources)
    inputs = np.stack(
        [_features(residual_regression(read_case(folder)), split.causes) for folder in split.cases]
    )
    hidden = []
    for folder in split.cases:
        truth = split.truth(folder.name)
        names = {*truth["causes"], *([UNLISTED] if truth["unlisted"] else [])}
        hidden.append(names or {NOTHING})
    models = {}
    for name in split.causes.names:
        labels = np.array([name in names for names in hidden])
        if min(labels.sum(), (~labels).sum()) >= _FEWEST:
            boosting = HistGradientBoostingClassifier(max_iter=60, min_samples_leaf=3, random_state=0)
            models[name] = boosting.fit(inputs, labels)
    (resources / _MODEL).write_bytes(pickle.dumps(models))


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Answer with the probabilities of the classifiers.

    Parameters
    ----------
    case : BenchmarkCase
        The case, with the training split as its resources.
    """
    if case.resources is None:
        raise ValueError("boosting needs a training split: give it with --resources")
    models = pickle.loads((case.resources / _MODEL).read_bytes())
    regression = residual_regression(case)
    features = _features(regression, case.causes)[None]
    named = {name: _probability(model, features) for name, model in models.items()}
    return answer_with(case.causes, named, regression.parameters([]))


def _probability(model: HistGradientBoostingClassifier, features: Floats) -> float:
    return float(model.predict_proba(features)[0, 1])


def _features(regression: ResidualRegression, causes: Causes) -> Floats:
    """Return the evidence of each name alone, nats, and the correlation of the residuals."""
    before = regression.fit([])[0]
    gains = dict.fromkeys(_names(causes), 0.0)
    for term in regression.terms:
        gains[term.cause] = max(gains[term.cause], 0.5 * (before - regression.fit([term])[0]))
    lag = [float(np.corrcoef(one[1:], one[:-1])[0, 1]) for one in regression.residuals.T]
    return np.array([*gains.values(), *lag])


def _names(causes: Causes) -> tuple[str, ...]:
    return (*causes.listed, UNLISTED)
