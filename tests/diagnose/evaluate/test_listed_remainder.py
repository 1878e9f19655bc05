"""A listed effect explains the remainder of a search if all flights together show it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.explain import assessment
from heli_lab.explain.candidates import ScoredCandidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.screening import ScoreStatistics
from heli_lab.explain.stepwise import Search
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
DRAG, STEP = "travel_drag_quadratic", "thrust_step.front"
TRIED = {id_: KINDS[id_] for id_ in (DRAG, "pitch_drag_quadratic", STEP)}


def hypothesis(*ids: str, nats: float = 0.0) -> Hypothesis:
    """A model with these causes."""
    candidates = tuple(typical_candidate(KINDS[id_]) for id_ in ids)
    return cast(
        Hypothesis, SimpleNamespace(candidates=candidates, ids=ids, log_likelihood=nats, estimate=nats)
    )


class Scores:
    """Stand-in for a screening of one set of flights, with given gains of the effects.

    Each coefficient has a Fisher information of 1e6. The gain is score^2 / (2 information), which gives the
    score.
    """

    gains: dict[str, float]

    def __init__(self, gains: dict[str, float]) -> None:
        self.gains = gains

    def effects(self, kinds: Any) -> list[ScoredCandidate]:
        """Candidates of typical size."""
        zeros = np.zeros(1)
        return [ScoredCandidate(typical_candidate(kind), 0.0, zeros, zeros, 1) for kind in kinds]

    def statistics(self, candidates: Any) -> list[ScoreStatistics]:
        """Statistics whose score test has the gains."""
        result = []
        for candidate in candidates:
            size = len(candidate.linear_parameters)
            gain = self.gains.get(candidate.id, 0.0)
            score = np.sign(gain) * np.sqrt(2.0 * abs(gain) * 1e6)
            result.append(ScoreStatistics(np.eye(size) * 1e6, np.full(size, score)))
        return result

    def release(self) -> None:
        """Nothing is kept."""


def explained(
    monkeypatch: pytest.MonkeyPatch,
    fitted: dict[str, float],
    held_out: dict[str, float],
    used_s: float = 30.0,
) -> Any:
    """Return the search with one more cause, or None.

    Parameters
    ----------
    fitted, held_out : dict
        Gain of each effect on the fitted and on the held-out flights, nats. Gains of opposite signs belong to
        sizes of opposite signs.
    used_s : float
        Duration of the fitted flight.
    """
    # The screening of the refitted model is not used.
    monkeypatch.setattr(assessment, "Screening", lambda _: Scores({}))
    monkeypatch.setattr(assessment, "held_out_screening", lambda *_: Scores(held_out))

    def refit(candidates: Any, *_: object) -> Hypothesis:
        return hypothesis(*(candidate.id for candidate in candidates), nats=5.0)

    train, held_out_flight = SimpleNamespace(used_s=used_s), SimpleNamespace()
    comparison = ModelComparison(*cast(Any, (None, None, [train], [held_out_flight])))
    monkeypatch.setattr(comparison, "refit", refit)
    comparison.__dict__["rows"] = 1000
    monkeypatch.setattr(
        comparison, "held_out_estimate", lambda of: SimpleNamespace(log_likelihood=3.0 * of.log_likelihood)
    )
    final = hypothesis("axis_tilt")
    search = Search(final, final, (), (), cast(Any, Scores(fitted)), complete=True)
    return assessment.with_remainder(comparison, search, TRIED)


def test_an_effect_that_all_flights_show_together_is_a_cause_with_little_evidence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    wider = explained(monkeypatch, {DRAG: 8.0}, {DRAG: 12.0})
    (cause,) = wider.causes
    assert wider.final.ids == ("axis_tilt", DRAG)
    assert (cause.effect, cause.train, cause.held_out) == (DRAG, 5.0, 15.0)
    # Another effect is named with it if all flights together do not distinguish them.
    other = "pitch_drag_quadratic"
    (cause,) = explained(monkeypatch, {DRAG: 8.0, other: 7.0}, {DRAG: 12.0, other: 12.0}).causes
    assert cause.ambiguous_with == (other,)


def test_flights_that_contradict_each_other_show_no_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explained(monkeypatch, {DRAG: 12.0}, {DRAG: -12.0}) is None
    assert explained(monkeypatch, {DRAG: 3.0}, {DRAG: 2.0}) is None


def test_remainder_search_skips_events_and_short_flights(monkeypatch: pytest.MonkeyPatch) -> None:
    assert explained(monkeypatch, {STEP: 90.0}, {STEP: 90.0}) is None
    assert explained(monkeypatch, {DRAG: 20.0}, {DRAG: 20.0}, used_s=5.0) is None
