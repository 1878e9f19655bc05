"""Concentrated scores: an event that inflated the disturbances is worth what its refit gains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.explain import forward
from heli_lab.explain.candidates import ScoredCandidate, typical_candidate
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.screening import (
    Screening,
    concentrated_scores,
    hidden_in_disturbances,
    with_concentrated_scores,
)
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = [pytest.mark.diagnosis, pytest.mark.slow]

RIG = load_rig("makki2024")
KIND = catalogue()["counterweight_shift"]
SLIP_m = 0.02


@pytest.fixture(scope="module")
def comparison() -> ModelComparison:
    """A flight in which the counterweight slips."""
    flight = flights(f"counterweight_shift={SLIP_m}@9.3")[0]
    return ModelComparison(MultibodyModel(), RIG, [prepare(flight, RIG, "a")], [])


def test_concentrated_score_of_a_slip_predicts_the_gain_of_its_refit(comparison: ModelComparison) -> None:
    base = comparison.refit([])
    screening = Screening(base.estimate)
    (plain,) = screening.effects([KIND])
    (concentrated,) = concentrated_scores(screening, [plain])
    start = concentrated.candidate.start_values(concentrated.coefficients)
    refit = comparison.refit([concentrated.candidate], start, base)
    gain = refit.log_likelihood - base.log_likelihood
    assert 1.5 * plain.log_likelihood_gain < concentrated.log_likelihood_gain
    assert 0.25 * gain < concentrated.log_likelihood_gain < 1.2 * gain
    assert concentrated.coefficients[0] == pytest.approx(SLIP_m, rel=0.3)


def test_a_low_score_of_an_event_in_large_disturbances_still_leads_to_a_refit(
    comparison: ModelComparison,
) -> None:
    base = comparison.refit([])
    disturbances = base.estimate.disturbances
    gusty = replace(disturbances, fast_std=np.maximum(2.5 * disturbances.fast_std, 0.01), curvature=None)
    screening = Screening(replace(base.estimate, disturbances=gusty))
    plain = screening.effects([KIND, catalogue()["thrust_step.front"], catalogue()["axis_tilt"]])
    concentrated = with_concentrated_scores(screening, lambda screened: [], plain)
    assert concentrated[0].candidate.id == KIND.id
    assert concentrated[0].log_likelihood_gain > 5.0 * plain[0].log_likelihood_gain
    by_id = {scored.candidate.id: scored.log_likelihood_gain for scored in concentrated}
    assert by_id["axis_tilt"] == next(s for s in plain if s.candidate.id == "axis_tilt").log_likelihood_gain
    assert with_concentrated_scores(screening, lambda screened: screened, plain) == plain


def test_effects_that_disturbances_replace_are_worth_a_refit(comparison: ModelComparison) -> None:
    base = comparison.refit([])
    estimated = base.estimate.disturbances
    # Disturbances so large that they explain the torque of the slip.
    inflated = replace(estimated, fast_std=np.maximum(2.5 * estimated.fast_std, 0.01), curvature=None)
    screening = Screening(replace(base.estimate, disturbances=inflated))
    plain = screening.effects([KIND, catalogue()["thrust_step.front"], catalogue()["axis_tilt"]])
    least_nats = 2.0 * plain[0].log_likelihood_gain

    def worth_a_refit(scored: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
        return [candidate for candidate in scored if candidate.log_likelihood_gain > least_nats]

    assert worth_a_refit(plain) == []
    hidden = hidden_in_disturbances(screening, worth_a_refit, plain)
    assert [scored.candidate.id for scored in hidden] == [KIND.id]
    faint = [replace(scored, log_likelihood_gain=1.9) for scored in plain]
    assert hidden_in_disturbances(screening, worth_a_refit, faint) == []


def test_a_round_without_a_cause_refits_what_the_disturbances_hide(monkeypatch: pytest.MonkeyPatch) -> None:
    spring = ScoredCandidate(
        typical_candidate(catalogue()["cable_spring.elevation"]), 4.8, np.zeros(1), np.ones(1), 1
    )
    hidden = replace(spring, log_likelihood_gain=183.0)
    refitted: list[ScoredCandidate] = []
    monkeypatch.setattr(forward, "hidden_in_disturbances", lambda screening, worth, scored: [hidden])
    monkeypatch.setattr(forward, "paused_play", lambda *_: [])
    monkeypatch.setattr(forward, "resting_friction", lambda *_: [])
    acceptance = SimpleNamespace(worth_a_refit=lambda scored: [], accepts=lambda refit: False, kinds={})
    progress = SimpleNamespace(refits_left=lambda: True)
    round_refits = forward.RoundRefits(
        cast(Any, None), cast(Any, acceptance), cast(Any, progress), 0, cast(Any, None), [spring]
    )
    monkeypatch.setattr(round_refits, "_refit", refitted.append)
    round_refits.refit_effects(cast(Any, None))
    assert refitted == [hidden]
