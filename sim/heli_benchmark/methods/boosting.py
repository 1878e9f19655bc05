"""Gradient boosting (scikit-learn), trained on residuals that are simulated with the terms of other cases."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from scipy.special import expit, logit
from sklearn.ensemble import HistGradientBoostingClassifier

from heli_benchmark.methods.terms import ResidualRegression, residual_regression
from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, Causes, answer_with, read_case, read_split

_SMALLEST_STD, _LARGEST_STD = 5.0, 80.0
"""Range of simulated effects in standard deviations of the noise, log-uniform. By judgement: an effect of 5
can be seen, and one of 80 cannot be overlooked."""
_MIN_NORM: Final = 1e-6


class TermEvidence:
    """Evidence of the terms of a case."""

    def __init__(self, regression: ResidualRegression, causes: Causes) -> None:
        self._regression, self._causes = regression, causes
        nuisance = regression.nuisance
        self._nuisance = nuisance
        # The rig parameters are projected out, within their priors.
        self._to_nuisance = np.linalg.solve(nuisance.T @ nuisance + np.eye(nuisance.shape[1]), nuisance.T)
        self._bases = [self._orthonormal_basis(term.columns) for term in regression.terms]
        self._columns_by_cause: dict[str, list[Floats]] = {}
        for term in regression.terms:
            self._columns_by_cause.setdefault(term.cause, []).append(term.columns)

    def _orthonormal_basis(self, columns: Floats) -> Floats:
        """Return an orthonormal basis of the part of `columns` that rig parameters cannot imitate."""
        residual = columns - self._nuisance @ (self._to_nuisance @ columns)
        vectors, singular_values, _ = np.linalg.svd(residual, full_matrices=False)
        return np.asarray(vectors[:, singular_values > _MIN_NORM * max(float(singular_values[0]), _MIN_NORM)])

    def features(self, targets: Floats) -> Floats:
        """Return the evidence of each name in each target, nats, and its difference to the highest. Shapes:
        `targets` (n, k); returns (k, 2 names).
        """
        residual = targets - self._nuisance @ (self._to_nuisance @ targets)
        n, total = len(residual), (residual**2).sum(axis=0)
        names = [*self._causes.listed, UNLISTED]
        evidence_nats = np.zeros((len(names), residual.shape[1]))
        for term, basis in zip(self._regression.terms, self._bases, strict=True):
            explained = ((basis.T @ residual) ** 2).sum(axis=0)
            # Half the decrease of the BIC: log-likelihood ratio minus the penalty of the parameters.
            explained_share = np.minimum(explained / total, 0.999999)
            penalty = 0.5 * basis.shape[1] * np.log(n)
            term_evidence = -0.5 * n * np.log1p(-explained_share) - penalty
            row = names.index(term.cause)
            evidence_nats[row] = np.maximum(evidence_nats[row], term_evidence)
        return np.vstack([evidence_nats, evidence_nats - evidence_nats.max(axis=0)]).T

    def simulated(self, count: int, rng: np.random.Generator) -> tuple[Floats, list[set[str]]]:
        """Simulate targets: white noise, errors of the rig parameters, and effects of drawn causes. Returns
        shape (n, count).
        """
        targets = rng.standard_normal((len(self._nuisance), count))
        targets += self._nuisance @ rng.standard_normal((self._nuisance.shape[1], count))
        rates, hidden = self._causes.base_rates, []
        names = sorted(self._columns_by_cause)
        for k in range(count):
            # Given that something is hidden, draw until at least one cause is.
            hidden_causes, is_hidden = set[str](), rng.random() > rates[NOTHING]
            while is_hidden and not hidden_causes:
                hidden_causes = {
                    name for name in names if rng.random() < rates[name] / (1.0 - rates[NOTHING])
                }
            for name in hidden_causes:
                alternatives = self._columns_by_cause[name]
                columns = alternatives[int(rng.integers(len(alternatives)))]
                effect = columns @ (rng.standard_normal(columns.shape[1]) / np.linalg.norm(columns, axis=0))
                size = np.exp(rng.uniform(np.log(_SMALLEST_STD), np.log(_LARGEST_STD)))
                targets[:, k] += size * effect / np.linalg.norm(effect)
            hidden.append(hidden_causes or {NOTHING})
        return targets, hidden


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
