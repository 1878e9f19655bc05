"""Alternatives of a cause: which effects are compared with it, and which of them replaces it."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any, cast

import pytest
from heli_lab.explain.candidates import Candidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, Refit, Round
from heli_lab.explain.stepwise import BackwardElimination
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
TORQUE, ZERO, SLIP = "rotor_reaction_torque", "zero_offset.pitch", "counterweight_shift"


def hypothesis(candidates: Sequence[Candidate], gains: dict[str, float]) -> Hypothesis:
    """Return a model whose log-likelihood is the sum of the `gains` of its causes."""
    ids = tuple(candidate.id for candidate in candidates)
    nats = sum(gains.get(id_, 0.0) for id_ in ids)
    made = SimpleNamespace(
        candidates=tuple(candidates), ids=ids, values={}, log_likelihood=nats, estimate=None
    )
    return cast(Hypothesis, made)


def eliminated(
    gains: dict[str, float],
    *causes: str,
    held_out: dict[str, float] | None = None,
    refits_left: bool = True,
    refitted: Sequence[str] = (),
    refused: Sequence[str] = (),
) -> dict[str, dict[str, float]]:
    """Return the causes after the elimination, and the lead of each over its alternatives.

    Parameters
    ----------
    gains : dict
        Log-likelihood ratio of each effect on the fitted flights.
    *causes : str
        Causes that the selection ends with; each was accepted in a round that refitted the effects
        `refitted` too.
    held_out : dict, optional
        The same as `gains` on the held-out flights.
    refits_left : bool
        Whether the limit of refits allows more.
    refused : sequence of str
        Effects that are not significant.
    """

    def refit(candidates: Sequence[Candidate], *_: object) -> Hypothesis:
        return hypothesis(candidates, gains)

    def held_out_estimate(of: Hypothesis) -> Any:
        return hypothesis(of.candidates, held_out or gains)

    candidates = [typical_candidate(KINDS[id_]) for id_ in causes]
    comparison = SimpleNamespace(
        refit=refit, held_out=("flight",), held_out_estimate=held_out_estimate, in_flight=lambda _: True
    )
    acceptance = SimpleNamespace(
        kinds=KINDS,
        penalty=lambda candidate: 4.0 + 4.0 * len(candidate.effect.priors),
        is_significant=lambda *_: True,
        accepts=lambda refit: refit.margin > 6.0 and refit.candidate.id not in refused,
    )
    progress = SimpleNamespace(check=lambda *_: None, refits_left=lambda: refits_left)
    tried = [hypothesis([typical_candidate(KINDS[id_])], gains) for id_ in (*causes, *refitted)]
    refits = tuple(Refit(of, of.log_likelihood, 8.0, of.log_likelihood, of.ids[0]) for of in tried)
    base = hypothesis([], gains)
    rounds = [Round(base, (), (), refits, id_) for id_ in causes]
    given: Any = (comparison, acceptance, progress, base, rounds)
    _, kept = BackwardElimination(*given).eliminate(hypothesis(candidates, gains))
    return {
        cause.effect: {other.id: other.log_likelihood_ratio for other in cause.alternatives} for cause in kept
    }


def test_equivalent_effect_with_a_low_score_is_compared() -> None:
    assert eliminated({TORQUE: 60.0, ZERO: 52.0}, TORQUE) == {TORQUE: {ZERO: 4.0}}


def test_equivalent_effect_is_compared_even_without_refits_left() -> None:
    kept = eliminated({TORQUE: 60.0, ZERO: 52.0, SLIP: 90.0}, SLIP, TORQUE, refits_left=False)
    assert kept[TORQUE] == {ZERO: 4.0}


def test_more_probable_effect_replaces_a_cause() -> None:
    gains = {TORQUE: 60.0, ZERO: 63.0, SLIP: 90.0}
    kept = eliminated(gains, SLIP, TORQUE)
    assert kept.keys() == {SLIP, ZERO}
    assert kept[ZERO] == {TORQUE: 7.0}


def test_held_out_flights_may_forbid_the_exchange() -> None:
    gains = {TORQUE: 60.0, ZERO: 63.0}
    assert eliminated(gains, TORQUE, held_out={TORQUE: 20.0, ZERO: -20.0}) == {TORQUE: {ZERO: -7.0}}


def test_insignificant_effect_does_not_replace_a_cause() -> None:
    assert eliminated({TORQUE: 60.0, ZERO: 63.0}, TORQUE, refused=[ZERO]) == {TORQUE: {ZERO: -7.0}}


def test_causes_after_an_exchange_have_the_alternatives_of_its_round() -> None:
    gains = {TORQUE: 60.0, ZERO: 63.0, "axis_tilt": 20.0}
    kept = eliminated(gains, TORQUE, refitted=["axis_tilt"])
    assert kept.keys() == {ZERO}
    assert kept[ZERO].keys() == {TORQUE, "axis_tilt"}


def test_a_lag_is_not_ambiguous_with_the_wider_effect_that_contains_it() -> None:
    kept = eliminated(
        {"rotor_lag": 200.0, "rotor_lag_with_delay": 200.5, "rotor_speed_lag": 90.0}, "rotor_lag"
    )
    assert kept["rotor_lag"].keys() == {"rotor_speed_lag"}


@pytest.mark.parametrize(
    ("cause", "other"), [("flywheel", "gyroscopic_torque"), ("supply_fade", "thrust_fade"), (TORQUE, ZERO)]
)
def test_effects_that_imitate_each_other_are_declared_as_a_family(cause: str, other: str) -> None:
    gains = {cause: 50.0, other: 45.0}
    assert other in eliminated(gains, cause)[cause]
