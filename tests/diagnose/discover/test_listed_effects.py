"""A proposed equation is dropped if an effect of the catalogue explains the flights equally well."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import pytest
from heli_lab.explain.candidates import Candidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.regression import ListedEffects
from heli_lab.explain.terms import Equation, EquationTerm, Factor, Term, equation_effect
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
PENALTY = 10.0


def equivalent_effect(hidden: str, equation: Equation, *ids: str, unlisted: bool = False) -> list[str | None]:
    """Return the effect that is equivalent to an `equation`, for several catalogues of a single effect each.

    Parameters
    ----------
    hidden : str
        Effect that is hidden in the flight.
    equation : Equation
        The proposed equation.
    *ids : str
        The only effect of each catalogue.
    unlisted : bool
        Whether an effect that no catalogue has is hidden too.
    """
    rig = load_rig("makki2024")
    flight = flights(hidden, unlisted=unlisted)[0]
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(flight, rig, "fit")], [])
    base = comparison.refit([])
    effect = equation_effect(equation, dict.fromkeys(equation.coefficients, 0.1))
    warm_start = comparison.refit(
        [Candidate(effect.name, effect, tuple(effect.priors))], {**effect.values, **base.values}, base
    )
    assert warm_start.log_likelihood > base.log_likelihood + 50.0 + PENALTY
    return [
        ListedEffects(comparison, base, {id_: KINDS[id_]}, lambda _: None).equivalent_effect(
            equation, warm_start, PENALTY
        )
        for id_ in ids
    ]


@pytest.mark.slow
def test_listed_effect_of_the_same_form_is_equivalent() -> None:
    equation = Equation((EquationTerm("torque.travel", Term((Factor("linear", "travel"),))),))
    equivalent_ids = equivalent_effect(
        "cable_spring.travel=0.1", equation, "coulomb_friction.pitch", "cable_spring.travel"
    )
    assert equivalent_ids == [None, "cable_spring.travel"]


@pytest.mark.slow
def test_equation_is_dropped_while_a_stronger_listed_effect_is_missing() -> None:
    equation = Equation((EquationTerm("torque.pitch", Term((Factor("linear", "elevation"),))),))
    equivalent_ids = equivalent_effect(
        "cable_spring.travel=0.3", equation, "cable_spring.travel", unlisted=True
    )
    assert equivalent_ids == ["cable_spring.travel"]


@pytest.mark.parametrize(
    ("equation_nats", "effect_nats", "both_nats", "stays"),
    [
        (100.0, 80.0, 104.0, True),
        (100.0, 80.0, 130.0, True),
        (100.0, 80.0, 94.0, False),  # With the effect, the equation adds 14 nats and needs 16.
        (80.0, 100.0, 130.0, False),  # The effect adds more to the equation than the reverse.
    ],
)
def test_equation_that_encompasses_the_effect_stays(
    equation_nats: float, effect_nats: float, both_nats: float, stays: bool
) -> None:
    def model(nats: float) -> Hypothesis:
        """Return a model of this log-likelihood; its last candidate is the equation."""
        return cast(Hypothesis, SimpleNamespace(log_likelihood=nats, values={}, candidates=("equation",)))

    comparison = SimpleNamespace(
        rows=1500, held_out=(), refit=lambda candidates, start, warm_start: model(both_nats)
    )
    base = cast(Hypothesis, SimpleNamespace(candidates=(), log_likelihood=0.0))
    listed = ListedEffects(cast(ModelComparison, comparison), base, KINDS, lambda _: None)
    effect = typical_candidate(KINDS["input_delay"])
    assert listed.encompasses(model(equation_nats), model(effect_nats), effect, PENALTY) is stays
