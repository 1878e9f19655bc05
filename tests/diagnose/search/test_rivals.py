"""Dry friction and play of one axis: the more likely one on all flights is accepted. A refit that ends
without its candidate gives a better estimate of the base, and no cause.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from heli_lab.explain.candidates import typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit
from heli_lab.explain.forward import Acceptance, RoundRefits, better_rival, is_neutral
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
HELD_OUT_NATS = {"coulomb_friction.pitch": 254.0, "backlash.pitch": 771.0, "backlash.travel": 5000.0}


def refit(id_: str, margin: float) -> Refit:
    """A refit with an effect of the catalogue."""
    candidate = typical_candidate(KINDS[id_])
    hypothesis = cast(Hypothesis, SimpleNamespace(candidates=(candidate,)))
    return Refit(hypothesis, margin + 10.0, 10.0, 0.0, id_)


def comparison(*, held_out: bool) -> ModelComparison:
    """Stand-in for a comparison that knows the log-likelihoods on the held-out flights."""

    def held_out_estimate(hypothesis: Any) -> SimpleNamespace:
        return SimpleNamespace(log_likelihood=HELD_OUT_NATS[hypothesis.candidates[-1].id])

    stub = SimpleNamespace(held_out=("a flight",) if held_out else (), held_out_estimate=held_out_estimate)
    return cast(ModelComparison, stub)


@pytest.mark.parametrize(
    ("friction", "play", "held_out", "accepted_id"),
    [
        (1080.0, 872.0, True, "backlash.pitch"),
        (1080.0, 872.0, False, "coulomb_friction.pitch"),
        (1480.0, 872.0, True, "coulomb_friction.pitch"),
        (100.0, 872.0, True, "backlash.pitch"),
    ],
)
def test_friction_and_play_of_an_axis_are_compared_on_all_flights(
    friction: float, play: float, held_out: bool, accepted_id: str
) -> None:
    refits = [refit("coulomb_friction.pitch", friction), refit("backlash.pitch", play)]
    best = max(refits, key=lambda refit: refit.margin)
    chosen = better_rival(comparison(held_out=held_out), best, refits)
    assert chosen.candidate.id == accepted_id


def test_effects_of_other_axes_are_no_rivals() -> None:
    refits = [refit("coulomb_friction.pitch", 80.0), refit("backlash.travel", 70.0)]
    assert better_rival(comparison(held_out=True), refits[0], refits) is refits[0]
    lag = refit("rotor_lag", 90.0)
    assert better_rival(comparison(held_out=True), lag, [lag, *refits]) is lag


def test_refit_that_makes_its_candidate_negligible_is_not_a_cause() -> None:
    kind = KINDS["backlash.pitch"]
    (size,) = kind.size
    candidate = typical_candidate(kind)
    acceptance = Acceptance(cast(ModelComparison, None), KINDS)
    for share, is_absent in ((1e-3, True), (0.5, False)):
        values = {size: share * kind.typical[size]}
        hypothesis = cast(Hypothesis, SimpleNamespace(values=values, std={size: 1e-5}))
        assert is_neutral(hypothesis, candidate, KINDS) is is_absent
        assert acceptance.is_significant(Refit(hypothesis, 289.0, 7.0, 0.0), candidate) is not is_absent
    without_free_size = cast(Hypothesis, SimpleNamespace(values={}, std={}))
    assert not is_neutral(without_free_size, candidate, KINDS)


@pytest.mark.parametrize(("nats", "is_better"), [(1289.0, True), (1003.0, False)])
def test_round_restarts_from_a_better_estimate_of_the_base(nats: float, is_better: bool) -> None:
    kind = KINDS["backlash.pitch"]
    (size,) = kind.size
    friction = typical_candidate(KINDS["coulomb_friction.pitch"])
    base = cast(Hypothesis, SimpleNamespace(candidates=(friction,), log_likelihood=1000.0))
    estimate_without_play = SimpleNamespace(log_likelihood=nats)
    absent = cast(
        Hypothesis,
        SimpleNamespace(candidates=(friction, typical_candidate(kind)), values={size: 0.0}, std={size: 1e-5}),
    )
    stub = SimpleNamespace(refit=lambda candidates, start, warm_start: estimate_without_play)
    round_refits = RoundRefits(
        cast(ModelComparison, stub),
        Acceptance(cast(ModelComparison, stub), KINDS),
        cast(Any, None),
        0,
        base,
        [],
        [Refit(absent, 289.0, 7.0, 0.0, "backlash.pitch")],
    )
    assert (round_refits.better_base() is estimate_without_play) is is_better
