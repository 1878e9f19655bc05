"""Concentrated scores: an event that inflated the disturbances is worth what its refit gains."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heli_lab.diagnose.search import ModelComparison, Screening
from heli_lab.diagnose.search.concentrated_score import concentrated_scores, with_concentrated_scores
from heli_lab.identify import prepare
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
    (found,) = concentrated_scores(screening, [plain])
    made = comparison.refit([found.candidate], found.candidate.start_values(found.coefficients), base)
    gain = made.log_likelihood - base.log_likelihood
    assert 1.5 * plain.log_likelihood_gain < found.log_likelihood_gain
    assert 0.25 * gain < found.log_likelihood_gain < 1.2 * gain
    assert found.coefficients[0] == pytest.approx(SLIP_m, rel=0.3)


def test_a_low_score_of_an_event_in_large_disturbances_still_leads_to_a_refit(
    comparison: ModelComparison,
) -> None:
    base = comparison.refit([])
    own = base.estimate.disturbances
    gusty = replace(own, fast_std=np.maximum(2.5 * own.fast_std, 0.01), curvature=None)
    screening = Screening(replace(base.estimate, disturbances=gusty))
    plain = screening.effects([KIND, catalogue()["thrust_step.front"], catalogue()["axis_tilt"]])
    found = with_concentrated_scores(screening, lambda screened: [], plain)
    assert found[0].candidate.id == KIND.id
    assert found[0].log_likelihood_gain > 5.0 * plain[0].log_likelihood_gain
    by_id = {scored.candidate.id: scored.log_likelihood_gain for scored in found}
    assert by_id["axis_tilt"] == next(s for s in plain if s.candidate.id == "axis_tilt").log_likelihood_gain
    assert with_concentrated_scores(screening, lambda screened: screened, plain) == plain
