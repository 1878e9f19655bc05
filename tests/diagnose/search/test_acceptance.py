"""Acceptance of candidates: friction and play that no score shows, and sizes that the Wald test misses."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.explain import forward, thresholds
from heli_lab.explain.candidates import ScoredCandidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit
from heli_lab.explain.forward import (
    Acceptance,
    Progress,
    RoundRefits,
    min_margin,
    paused_play,
    resting_friction,
)
from heli_lab.explain.screening import Screening
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()


def dry_friction(resting: list[float], *, there: tuple[str, ...] = ()) -> list[str]:
    """Return the ids of the dry frictions that are proposed if the axes rest for these shares of the time.

    Each must start from its typical size. `there` has the ids of the model's causes.
    """
    at_rest = np.arange(100)[:, None] < 100 * np.array(resting)
    reference = SimpleNamespace(at_rest=at_rest, rows=np.arange(100))
    screening = SimpleNamespace(
        filtered=SimpleNamespace(linearised_flights=[SimpleNamespace(reference=reference)])
    )
    base = cast(Hypothesis, SimpleNamespace(ids=there))
    proposed = resting_friction(base, cast(Screening, screening), KINDS, ())
    for scored in proposed:
        start = scored.candidate.start_values(scored.coefficients)
        assert start == pytest.approx(KINDS[scored.candidate.id].typical)
    return [scored.candidate.id for scored in proposed]


def test_friction_of_typical_size_is_proposed_for_axes_that_rest() -> None:
    assert dry_friction([0.9, 0.1, 0.2]) == ["coulomb_friction.elevation"]
    assert dry_friction([0.9, 0.1, 0.7]) == ["coulomb_friction.elevation", "coulomb_friction.travel"]
    assert dry_friction([0.9, 0.1, 0.7], there=("coulomb_friction.elevation",)) == ["coulomb_friction.travel"]
    assert dry_friction([0.3, 0.1, 0.2]) == []


@pytest.mark.parametrize("there", [(), ("backlash.pitch",)])
def test_play_is_proposed_for_axes_whose_count_pauses(there: tuple[str, ...]) -> None:
    # Elevation pauses for a tenth of the time, pitch for a fifth; travel stops often, but only briefly.
    pause_s = np.where(np.arange(100)[:, None] < [10, 20, 90], [2.0, 0.3, 0.1], 0.05)
    reference = SimpleNamespace(pause_s=pause_s, rows=np.arange(100))
    screening = SimpleNamespace(
        filtered=SimpleNamespace(linearised_flights=[SimpleNamespace(reference=reference)])
    )
    base = cast(Hypothesis, SimpleNamespace(ids=there))
    proposed = paused_play(base, cast(Screening, screening), KINDS, ())
    assert [scored.candidate.id for scored in proposed] == ([] if there else ["backlash.pitch"])


@pytest.mark.parametrize(
    ("play_margin", "refitted_ids"),
    [
        (5.0, ["rotor_lag", "backlash.pitch"]),
        (9.0, ["rotor_lag", "backlash.pitch", "coulomb_friction.pitch"]),
    ],
)
def test_play_is_refitted_and_then_friction_if_the_play_is_best(
    monkeypatch: pytest.MonkeyPatch, play_margin: float, refitted_ids: list[str]
) -> None:
    reference = SimpleNamespace(
        pause_s=np.tile([0.1, 0.3, 0.1], (9, 1)), at_rest=np.zeros((9, 3), bool), rows=np.arange(9)
    )
    screening = SimpleNamespace(
        filtered=SimpleNamespace(linearised_flights=[SimpleNamespace(reference=reference)])
    )
    acceptance = SimpleNamespace(kinds=KINDS, worth_a_refit=list, accepts=lambda _: True)
    progress = SimpleNamespace(refits_left=lambda: True, trial=lambda *_: None)
    margins = {"rotor_lag": 7.0, "backlash.pitch": play_margin, "coulomb_friction.pitch": 11.0}

    def refit(
        _comparison: object, _acceptance: object, _base: object, scored: ScoredCandidate, *_: Any
    ) -> SimpleNamespace:
        candidate = scored.candidate
        return SimpleNamespace(candidate=candidate, margin=margins[candidate.id])

    monkeypatch.setattr(forward, "refit_on_grid", refit)
    lag = ScoredCandidate(typical_candidate(KINDS["rotor_lag"]), 90.0, np.zeros(1), np.ones(1), 1)
    base = cast(Hypothesis, SimpleNamespace(ids=()))
    round_refits = RoundRefits(
        cast(ModelComparison, SimpleNamespace(held_out=())),
        cast(Acceptance, acceptance),
        cast(Progress, progress),
        0,
        base,
        [lag],
    )
    round_refits.refit_effects(cast(Screening, screening))
    assert [refit.candidate.id for refit in round_refits.refits] == refitted_ids
    assert round_refits.tried_ids == set(refitted_ids)


def test_a_clear_log_likelihood_ratio_overrides_the_wald_test() -> None:
    kind = KINDS["coulomb_friction.elevation"]
    size = kind.size[0]
    hypothesis = cast(Hypothesis, SimpleNamespace(values={size: 0.03}, std={size: 0.05}))
    candidate = typical_candidate(kind)
    record = SimpleNamespace(step_s=0.01, count_rad=np.full(3, 0.0015))
    acceptance = Acceptance(cast(ModelComparison, SimpleNamespace(train=[record])), KINDS)
    assert acceptance.is_significant(Refit(hypothesis, 1300.0, 11.0, 0.0), candidate)
    assert not acceptance.is_significant(Refit(hypothesis, 30.0, 11.0, 0.0), candidate)


def test_a_play_needs_more_evidence_next_to_friction_about_its_axis() -> None:
    assert min_margin("backlash.pitch", ["coulomb_friction.pitch"]) == thresholds.PLAY_NEXT_TO_FRICTION_NATS
    assert min_margin("backlash.pitch", ["coulomb_friction.travel"]) == thresholds.MIN_MARGIN
    assert min_margin("coulomb_friction.pitch", ["backlash.pitch"]) == thresholds.MIN_MARGIN
