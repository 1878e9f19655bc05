"""Gradient boosting (scikit-learn), trained on residuals that are simulated with the terms of other cases."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy.special import expit, logit
from sklearn.ensemble import HistGradientBoostingClassifier

from heli_benchmark.methods.evidence import TermEvidence
from heli_benchmark.methods.terms import residual_regression
from heli_benchmark.task import NOTHING, BenchmarkCase, answer_with, read_case, read_split

SIMULATED: Final = 10_000
"""Simulated flights, spread over the cases of the training split."""
_FEWEST: Final = 20
"""Simulated flights with a cause from which a classifier learns it; other causes keep their base rates."""
_SHARPNESS: Final = 0.5
"""Factor on the log-odds: simulated noise is white, that of flights is not. Tuned."""
_MODEL: Final = "boosting.pickle"


def train(resources: Path) -> None:
    """Train one classifier per name, and keep them in the folder of the training split."""
    split, rng = read_split(resources), np.random.default_rng(0)
    features, hidden = [], []
    for folder in split.cases:
        evidence = TermEvidence(residual_regression(read_case(folder)), split.causes)
        targets, names = evidence.simulated(SIMULATED // len(split.cases), rng)
        features.append(evidence.features(targets))
        hidden += names
    inputs, models = np.concatenate(features), {}
    for name in split.causes.names:
        labels = np.array([name in hidden_causes for hidden_causes in hidden])
        if labels.sum() >= _FEWEST:
            boosting = HistGradientBoostingClassifier(max_iter=60, early_stopping=False, random_state=0)
            models[name] = boosting.fit(inputs, labels)
    (resources / _MODEL).write_bytes(pickle.dumps(models))


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Answer with the probabilities of the classifiers."""
    if case.resources is None:
        raise ValueError("boosting needs a training split: give it with --resources")
    models = pickle.loads((case.resources / _MODEL).read_bytes())
    regression = residual_regression(case)
    features = TermEvidence(regression, case.causes).features(regression.target[:, None])
    odds = {name: float(logit(model.predict_proba(features)[0, 1])) for name, model in models.items()}
    named = {name: float(expit(_SHARPNESS * value)) for name, value in odds.items()}
    chosen = [name for name, probability in named.items() if probability >= 0.5 and name != NOTHING]
    terms = [regression.best_term(name) for name in chosen]
    return answer_with(case.causes, named, regression.parameters(terms))
