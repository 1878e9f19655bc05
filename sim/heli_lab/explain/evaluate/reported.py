"""Parameters of a cause as a report states them: estimates with standard errors that are not too small."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from heli_sim.model.effects import EffectSpec
from heli_sim.model.effects.spec import format_estimate

from heli_lab.explain.search.resolution import limited_std
from heli_lab.fit.problem import Fit


@dataclass(frozen=True)
class CauseParameter:
    """An estimated parameter of a cause."""

    value: float  # value, std: Estimate and standard error, in `unit`
    std: float
    unit: str  # SI unit; ``1`` for a parameter without one


def cause_parameters(fit: Fit, kind: EffectSpec, start: Mapping[str, float]) -> dict[str, CauseParameter]:
    """Parameters of an effect by full name, as they are reported."""
    std = limited_std(kind, fit.values, fit.std, fit.problem.records[0])
    return {
        q.name: CauseParameter(fit.values.get(q.name, start[q.name]), std.get(q.name, 0.0), q.unit)
        for q in kind.parameters
    }


@dataclass(frozen=True)
class FamilyNumber:
    """The number that a cause shares with the effects that may replace it, such as the lag of the rotors."""

    name: str  # Name of the family
    value: float  # value, std: Estimate and standard error, in `unit`
    std: float
    unit: str  # SI unit
    sentence: str  # The number in words
    unclear: str  # Statement that flights do not distinguish its members
    members: tuple[str, ...]  # Ids of the family's effects


def family_number(
    fit: Fit,
    kind: EffectSpec,
    kinds: Mapping[str, EffectSpec],
    parameters: Mapping[str, CauseParameter],
    ambiguous_with: Collection[str] = (),
) -> FamilyNumber | None:
    """Compute the number that an effect shares with its family, such as the sum of a lag and a delay.

    The number is a weighted sum of the effect's parameters. Its standard error follows from their covariance.
    """
    family = kind.family
    members = tuple(other.id for other in kinds.values() if other.family == family)
    if family is None or not family.sentence or (family.in_part and not {*members} & {*ambiguous_with}):
        return None
    divisor = _value_of(kind.family_divisor, fit) if kind.family_divisor else 1.0
    weights = {kind.full(name): weight / divisor for name, weight in kind.family_numbers.items()}
    estimated_names = [name for name in weights if name in fit.problem.names]
    indices = [fit.problem.names.index(name) for name in estimated_names]
    estimated_weights = np.array([weights[name] for name in estimated_names])
    # The covariance counts, because a lag and a delay compensate each other.
    variance = float(estimated_weights @ fit.covariance[np.ix_(indices, indices)] @ estimated_weights)
    # Reported standard errors are at least as large as those of the fit: add the difference.
    added_variance = sum(
        weight**2 * (parameters[name].std ** 2 - fit.std.get(name, 0.0) ** 2)
        for name, weight in weights.items()
    )
    value = sum(weight * parameters[name].value for name, weight in weights.items())
    std = math.sqrt(max(variance + added_variance, 0.0))
    return FamilyNumber(
        name=family.name,
        value=value,
        std=std,
        unit=family.unit,
        sentence=family.sentence.format(format_estimate(value, std, family.unit)),
        unclear=family.unclear,
        members=members,
    )


def _value_of(name: str, fit: Fit) -> float:
    """Return the estimate of a rig parameter, or its value in the rig file if it was not estimated."""
    return float(fit.values.get(name, fit.problem.rig[name].value))
