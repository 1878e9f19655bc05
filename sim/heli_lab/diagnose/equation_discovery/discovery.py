"""What a search for a law found: the law, its numbers, its evidence and its rivals."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from heli_lab.diagnose.equation_discovery.equation import Equation, EquationEffect, EquationTerm
from heli_lab.diagnose.equation_discovery.terms import Term
from heli_lab.diagnose.model_comparison import Hypothesis
from heli_lab.estimation import Estimate


@dataclass(frozen=True)
class Rival:
    """Another term in the place of the last one.

    Parameters
    ----------
    key : str
        The term as text.
    log_likelihood_ratio : float
        Of the law proposed over the law with it, penalties included, nats.
    """

    key: str
    log_likelihood_ratio: float


@dataclass(frozen=True, eq=False)
class Discovery:
    """A law that explains what a model lacks; compared by identity.

    Parameters
    ----------
    equation : Equation
        Its terms.
    base, hypothesis : Hypothesis
        The model without the law and with it, each with the weather that suits it best.
    penalty : float
        What the law pays for its numbers and for the search, nats.
    held_out : float or None
        Log-likelihood ratio on the flights held out, nats; None without any.
    curve : float or None
        What curves in the law's place gained on the flights fitted, nats; None where none was fitted.
    rivals : tuple of Rival
        Other terms in the place of those of the law, closest first.
    tried : int
        Groups of terms that were scored.
    superfluous : tuple of str
        Causes named beside it that the law makes superfluous.
    elsewhere : (Estimate, Estimate) or None
        The flights held out without the law and with it; None without any.
    """

    equation: Equation
    base: Hypothesis
    hypothesis: Hypothesis
    penalty: float
    held_out: float | None
    curve: float | None
    rivals: tuple[Rival, ...]
    tried: int
    superfluous: tuple[str, ...] = ()
    elsewhere: tuple[Estimate, Estimate] | None = None

    @property
    def effect(self) -> EquationEffect:
        """The law as an effect of the model."""
        effect = self.hypothesis.candidates[-1].effect
        assert isinstance(effect, EquationEffect)
        return effect

    @property
    def train(self) -> float:
        """Log-likelihood ratio over the model without the law on the flights fitted, nats."""
        return self.hypothesis.log_likelihood - self.base.log_likelihood

    @property
    def values(self) -> dict[str, tuple[float, float, str]]:
        """Numbers of the law by name without prefix: value, standard error (0 where fixed) and unit."""
        estimate = self.hypothesis.estimate
        std = dict(zip(estimate.parameter_vector.names, np.sqrt(np.diag(estimate.covariance)), strict=True))
        estimates = self.hypothesis.values
        return {
            q.name.removeprefix(f"{self.effect.prefix}_"): (
                float(estimates.get(q.name, self.effect.values[q.name])),
                float(std.get(q.name, 0.0)),
                q.unit,
            )
            for q in self.effect.parameters
        }

    def with_numbers(self, number: int) -> EquationTerm:
        """Term `number` of the law with the inner numbers that the refit found."""
        term, values = self.equation.terms[number], self.values
        factors = tuple(
            replace(
                factor,
                numbers=tuple(
                    (inner_name, values[name][0])
                    for inner_name, name in self.equation.numbers_of(number, j).items()
                ),
            )
            for j, factor in enumerate(term.term.factors)
        )
        return EquationTerm(term.channel, Term(factors))
