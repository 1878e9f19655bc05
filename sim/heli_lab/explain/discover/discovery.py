"""Result of a search for an equation: terms, parameters, evidence and rivals."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from heli_lab.explain.discover.equation import Equation, EquationEffect, EquationTerm
from heli_lab.explain.discover.terms import Term
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.fit.estimator import Estimate


class EquationParameter(NamedTuple):
    """Estimate and standard error of a parameter in its unit; the error is 0 if the parameter is fixed."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class Rival:
    """A term that was not accepted."""

    key: str  # The term as text, such as ``torque.pitch: elevation``
    log_likelihood_ratio: float
    """Log-likelihood ratio of the proposed equation over the one with this term, penalties included, nats."""


@dataclass(frozen=True, eq=False)
class Discovery:
    """An equation that explains what a model lacks; compared by identity."""

    equation: Equation  # The terms
    base: Hypothesis
    """base, hypothesis: The model without and with the equation, each with its own estimate of the
    disturbances."""
    hypothesis: Hypothesis
    penalty: float  # Complexity penalty for the parameters and for multiple testing, nats
    held_out: float | None  # Log-likelihood ratio on the held-out flights, nats; None without such flights
    curve: float | None
    """Gain of spline terms in the place of the equation on the fitted flights, nats; None if there were none.
    """
    rivals: tuple[Rival, ...]  # Terms that were not accepted, the closest first
    tried: int  # Number of groups of terms that were scored
    superfluous: tuple[str, ...] = ()
    """Ids of causes that are not significant any more in the model with the equation."""
    elsewhere: tuple[Estimate, Estimate] | None = None
    """(Estimate, Estimate): Estimates of the held-out flights, without and with the equation; None without
    such flights."""

    @property
    def effect(self) -> EquationEffect:
        """The equation as an effect of the model."""
        effect = self.hypothesis.candidates[-1].effect
        assert isinstance(effect, EquationEffect)
        return effect

    @property
    def train(self) -> float:
        """Log-likelihood ratio over the model without the equation on the fitted flights, nats."""
        return self.hypothesis.log_likelihood - self.base.log_likelihood

    @property
    def values(self) -> dict[str, EquationParameter]:
        """Parameters of the equation by name, without the effect's prefix."""
        values, std = {**self.effect.values, **self.hypothesis.values}, self.hypothesis.std
        return {
            q.name.removeprefix(f"{self.effect.prefix}_"): EquationParameter(
                values[q.name], std.get(q.name, 0.0), q.unit
            )
            for q in self.effect.parameters
        }

    def with_estimated_parameters(self, number: int) -> EquationTerm:
        """Return term `number`, from 0, with the estimates of its inner parameters."""
        term, values = self.equation.terms[number], self.values
        factors = tuple(
            replace(
                factor,
                parameters=tuple(
                    (inner_name, values[name].value)
                    for inner_name, name in self.equation.inner_names(number, j).items()
                ),
            )
            for j, factor in enumerate(term.term.factors)
        )
        return EquationTerm(term.channel, Term(factors))
