"""Evidence of each cause alone in many targets of a regression, measured or simulated with its terms."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_benchmark.methods.terms import ResidualRegression
from heli_benchmark.task import NOTHING, UNLISTED, Causes

_SMALLEST_STD, _LARGEST_STD = 5.0, 80.0
"""Range of simulated effects in standard deviations of the noise, log-uniform. By judgement: an effect of 5
can be seen, and one of 80 cannot be overlooked."""
_MIN_NORM: Final = 1e-6


class TermEvidence:
    """Evidence of the terms of a case.

    Parameters
    ----------
    regression : ResidualRegression
        Its terms.
    causes : Causes
        Names of all causes.
    """

    def __init__(self, regression: ResidualRegression, causes: Causes) -> None:
        self._regression, self._causes = regression, causes
        known = regression.nuisance
        self._known = known
        # The rig parameters are projected out, within their priors.
        self._onto = np.linalg.solve(known.T @ known + np.eye(known.shape[1]), known.T)
        self._bases = [self._basis(term.columns) for term in regression.terms]
        self._columns_by_cause: dict[str, list[Floats]] = {}
        for term in regression.terms:
            self._columns_by_cause.setdefault(term.cause, []).append(term.columns)

    def _basis(self, columns: Floats) -> Floats:
        residual = columns - self._known @ (self._onto @ columns)
        vectors, singular_values, _ = np.linalg.svd(residual, full_matrices=False)
        return np.asarray(vectors[:, singular_values > _MIN_NORM * max(float(singular_values[0]), _MIN_NORM)])

    def features(self, targets: Floats) -> Floats:
        """Return the evidence of each name in each target, nats, and its difference to the highest.

        Parameters
        ----------
        targets : ndarray (n, k)
            Whitened residuals.

        Returns
        -------
        ndarray (k, 2 names)
            Features of a classifier.
        """
        residual = targets - self._known @ (self._onto @ targets)
        n, total = len(residual), (residual**2).sum(axis=0)
        names = [*self._causes.listed, UNLISTED]
        gains = np.zeros((len(names), residual.shape[1]))
        for term, basis in zip(self._regression.terms, self._bases, strict=True):
            explained = ((basis.T @ residual) ** 2).sum(axis=0)
            gain = -0.5 * n * np.log1p(-np.minimum(explained / total, 0.999999)) - 0.5 * basis.shape[
                1
            ] * np.log(n)
            place = names.index(term.cause)
            gains[place] = np.maximum(gains[place], gain)
        return np.vstack([gains, gains - gains.max(axis=0)]).T

    def simulated(self, count: int, rng: np.random.Generator) -> tuple[Floats, list[set[str]]]:
        """Simulate targets: white noise, errors of the rig parameters, and effects of drawn causes.

        Parameters
        ----------
        count : int
            Number of targets.
        rng : numpy.random.Generator
            Draws the noise, the errors and the effects.

        Returns
        -------
        tuple of ndarray (n, count) and list of set of str
            The targets, and the names that are true of each.
        """
        targets = rng.standard_normal((len(self._known), count))
        targets += self._known @ rng.standard_normal((self._known.shape[1], count))
        rates, hidden = self._causes.base_rates, []
        names = sorted(self._columns_by_cause)
        for k in range(count):
            drawn, something = set[str](), rng.random() > rates[NOTHING]
            while something and not drawn:
                drawn = {name for name in names if rng.random() < rates[name] / (1.0 - rates[NOTHING])}
            for name in drawn:
                alternatives = self._columns_by_cause[name]
                columns = alternatives[int(rng.integers(len(alternatives)))]
                effect = columns @ (rng.standard_normal(columns.shape[1]) / np.linalg.norm(columns, axis=0))
                size = np.exp(rng.uniform(np.log(_SMALLEST_STD), np.log(_LARGEST_STD)))
                targets[:, k] += size * effect / np.linalg.norm(effect)
            hidden.append(drawn or {NOTHING})
        return targets, hidden
