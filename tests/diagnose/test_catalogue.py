"""What the list explains is no law; friction that holds an axis is tried though no score sees it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_lab.diagnose.candidate import Candidate, typical_candidate
from heli_lab.diagnose.equation_discovery.catalogue import Catalogue
from heli_lab.diagnose.equation_discovery.equation import Equation, EquationTerm, equation_effect
from heli_lab.diagnose.equation_discovery.terms import Factor, Term
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.search import _Searcher
from heli_lab.diagnose.search_record import Refit
from heli_lab.identify import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
PENALTY = 10.0


def equivalent_effect(hidden: str, equation: Equation, *ids: str, unlisted: bool = False) -> list[str | None]:
    """What does as well as an `equation` in a flight with `hidden` effects, each id listed alone."""
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
        Catalogue(comparison, base, {one: KINDS[one]}, lambda _: None).equivalent_effect(
            equation, warm_start, PENALTY
        )
        for one in ids
    ]


@pytest.mark.slow
def test_a_law_that_an_effect_of_the_list_explains_as_well_is_none() -> None:
    equation = Equation((EquationTerm("torque.travel", Term((Factor("linear", "travel"),))),))
    found = equivalent_effect(
        "cable_spring.travel=0.1", equation, "coulomb_friction.pitch", "cable_spring.travel"
    )
    assert found == [None, "cable_spring.travel"]


@pytest.mark.slow
def test_a_law_goes_while_an_effect_of_the_list_that_matters_more_is_missing_beside_it() -> None:
    equation = Equation((EquationTerm("torque.pitch", Term((Factor("linear", "elevation"),))),))
    found = equivalent_effect("cable_spring.travel=0.3", equation, "cable_spring.travel", unlisted=True)
    assert found == ["cable_spring.travel"]


@pytest.mark.parametrize(
    ("law_nats", "effect_nats", "both_nats", "stays"),
    [
        (100.0, 80.0, 104.0, True),
        (100.0, 80.0, 130.0, True),
        (100.0, 80.0, 94.0, False),  # Beside the effect the law is worth 14, of 16 that it must.
        (80.0, 100.0, 130.0, False),  # Beside the law the effect is worth more than the law beside it.
    ],
)
def test_a_law_stays_that_is_worth_more_beside_an_effect_than_the_effect_beside_it(
    law_nats: float, effect_nats: float, both_nats: float, stays: bool
) -> None:
    def made(nats: float) -> Hypothesis:
        return cast(Hypothesis, SimpleNamespace(log_likelihood=nats, values={}, candidates=("law",)))

    comparison = SimpleNamespace(
        rows=1500, held_out=(), refit=lambda candidates, start, warm_start: made(both_nats)
    )
    base = cast(Hypothesis, SimpleNamespace(candidates=(), log_likelihood=0.0))
    listed = Catalogue(cast(ModelComparison, comparison), base, KINDS, lambda _: None)
    effect = typical_candidate(KINDS["input_delay"])
    assert listed.encompasses(made(law_nats), made(effect_nats), effect, PENALTY) is stays


def dry_friction(resting: list[float], *, there: tuple[str, ...] = ()) -> list[str]:
    """Ids of the frictions that are tried where the axes rest for these shares of the time."""
    at_rest = np.arange(100)[:, None] < 100 * np.array(resting)
    reference = SimpleNamespace(at_rest=at_rest, rows=np.arange(100))
    screening = SimpleNamespace(
        filtered=SimpleNamespace(linearised_flights=[SimpleNamespace(reference=reference)])
    )
    searcher = cast(_Searcher, SimpleNamespace(kinds=KINDS))
    base = cast(Hypothesis, SimpleNamespace(ids=there))
    found = _Searcher._dry_friction(searcher, base, cast(Screening, screening), ())
    for one in found:
        assert one.candidate.start_values(one.coefficients) == pytest.approx(KINDS[one.candidate.id].typical)
    return [one.candidate.id for one in found]


def test_friction_is_tried_from_its_usual_size_where_an_axis_is_held() -> None:
    assert dry_friction([0.9, 0.1, 0.2]) == ["coulomb_friction.elevation"]
    assert dry_friction([0.9, 0.1, 0.7]) == ["coulomb_friction.elevation", "coulomb_friction.travel"]
    assert dry_friction([0.9, 0.1, 0.7], there=("coulomb_friction.elevation",)) == ["coulomb_friction.travel"]
    assert dry_friction([0.3, 0.1, 0.2]) == []


def test_a_size_that_the_likelihood_tells_from_nothing_is_told_whatever_its_standard_error() -> None:
    kind = KINDS["coulomb_friction.elevation"]
    size = kind.size[0]
    estimate = SimpleNamespace(
        parameter_vector=SimpleNamespace(names=[size]),
        covariance=np.array([[0.05**2]]),
        theta=np.array([0.03]),
    )
    hypothesis = cast(Hypothesis, SimpleNamespace(estimate=estimate, values={size: 0.03}))
    candidate = typical_candidate(kind)
    searcher = cast(_Searcher, SimpleNamespace(kinds=KINDS))
    assert _Searcher._told(searcher, Refit(hypothesis, 1300.0, 11.0, 0.0), candidate)
    assert not _Searcher._told(searcher, Refit(hypothesis, 30.0, 11.0, 0.0), candidate)
