"""Stepwise search: a step hidden by disturbances, effects that a spline displaced, parameters on a grid."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.explain.candidates import Candidate, ScoredCandidate, spline_term, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit, Round
from heli_lab.explain.forward import Acceptance, Progress, refit_on_grid
from heli_lab.explain.screening import Screening
from heli_lab.explain.stepwise import BackwardElimination
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
MOMENT_s = 13.7


@pytest.mark.slow
def test_a_step_hidden_by_disturbances_is_scored_where_the_torque_jumps() -> None:
    rig = load_rig("makki2024")
    record = prepare(flights(f"counterweight_shift=0.009@{MOMENT_s}")[0], rig, "fit")
    base = ModelComparison(MultibodyModel(), rig, [record], []).refit([])
    # The disturbances of the base have explained the step.
    disturbances = base.estimate.disturbances
    assert disturbances.slow_std[0] > 0.01 or disturbances.fast_std[0] > 0.01
    (score,) = Screening(base.estimate).effects([KINDS["counterweight_shift"]])
    assert score.candidate.grid["counterweight_shift_at_s"] == pytest.approx(MOMENT_s, abs=0.3)
    assert score.log_likelihood_gain > 30.0


def hypothesis(candidates: list[Candidate]) -> Hypothesis:
    """Return a model with some causes, without an estimate; each value is the number of a cause."""
    return cast(
        Hypothesis,
        SimpleNamespace(
            candidates=tuple(candidates),
            ids=tuple(candidate.id for candidate in candidates),
            values={candidate.id: float(n) for n, candidate in enumerate(candidates)},
            log_likelihood=0.0,
        ),
    )


def test_effects_come_back_if_held_out_flights_contradict_a_spline() -> None:
    first, second, third = (
        typical_candidate(KINDS[id_]) for id_ in ("rotor_lag", "encoder_eccentricity.travel", "axis_tilt")
    )
    term = spline_term("measurement.travel", "travel", -1.0, 0.25, 1)
    spline = Candidate("spline:measurement.travel:travel", term, tuple(term.priors))
    refitted_ids: list[list[str]] = []

    def refit(candidates: list[Candidate], start: dict[str, float], warm_start: Hypothesis) -> Hypothesis:
        refitted_ids.append([candidate.id for candidate in candidates])
        assert start.keys() >= {second.id}
        return hypothesis(candidates)

    # The search accepted the first and the second effect. In the third round, a spline was better than the
    # third effect, and made the second one superfluous.
    listed = Refit(hypothesis([first, second, third]), 40.0, 10.0, 30.0)
    bases = [hypothesis([]), hypothesis([first]), hypothesis([first, second])]
    refits = (Refit(hypothesis([spline]), 99.0, 10.0, 99.0), listed)
    rounds = [
        Round(bases[0], (), (), (), first.id),
        Round(bases[1], (), (), (), second.id),
        Round(bases[2], (), (), refits, spline.id),
    ]
    comparison = cast(ModelComparison, SimpleNamespace(refit=refit))
    acceptance = cast(Acceptance, SimpleNamespace(accepts=lambda candidate: candidate is listed, kinds=KINDS))
    backward = BackwardElimination(comparison, acceptance, cast(Progress, None), bases[0], rounds)
    final, without_spline = hypothesis([first, spline]), hypothesis([first])
    restored = backward.restore_displaced(final, spline.id, without_spline)
    assert refitted_ids == [[first.id, second.id, third.id]]
    assert restored.ids == (first.id, second.id, third.id)
    # A cause that is not a spline is dropped, and nothing replaces it.
    assert backward.restore_displaced(final, first.id, hypothesis([spline])).ids == (spline.id,)
    assert len(refitted_ids) == 1
    assert np.isfinite(list(restored.values.values())).all()


@pytest.mark.parametrize(("ratio", "kept"), [(-1.0, ["axis_tilt"]), (1.0, ["axis_tilt", "spline:a:b"])])
def test_a_spline_must_gain_on_held_out_flights_but_an_effect_need_not(
    monkeypatch: pytest.MonkeyPatch, ratio: float, kept: list[str]
) -> None:
    def reduced(_: object, final: Hypothesis) -> tuple[Hypothesis, dict[str, Hypothesis]]:
        return final, {"axis_tilt": final, "spline:a:b": hypothesis([typical_candidate(KINDS["axis_tilt"])])}

    monkeypatch.setattr(BackwardElimination, "_remove_superfluous", reduced)
    monkeypatch.setattr(
        BackwardElimination,
        "_held_out_ratios",
        lambda _self, final, _reduced: {id_: -1.0 if id_ == "axis_tilt" else ratio for id_ in final.ids},
    )
    acceptance = SimpleNamespace(penalty=lambda _: 1.0, kinds=KINDS)
    nothing: Any = None
    backward = BackwardElimination(nothing, cast(Acceptance, acceptance), nothing, hypothesis([]), [])
    spline = Candidate("spline:a:b", typical_candidate(KINDS["axis_tilt"]).effect, ())
    final = hypothesis([typical_candidate(KINDS["axis_tilt"]), spline])
    result, _ = backward.eliminate(final)
    assert list(result.ids) == kept
    assert backward.contradicted_ids == {"axis_tilt", "spline:a:b"} - set(kept)


def test_grid_parameter_is_refitted_on_both_sides_of_the_best_score() -> None:
    kind = KINDS["encoder_eccentricity.travel"]
    order = kind.full("order")
    # The second order has the higher score, and the first order the higher likelihood.
    log_likelihoods = {1.0: 182.0, 2.0: 125.0}
    refitted_orders: list[float] = []

    def refit(candidates: list[Candidate], start: dict[str, float], warm_start: Hypothesis) -> Hypothesis:
        refitted_orders.append(candidates[-1].effect.values[order])
        refitted = hypothesis(candidates)
        refitted.log_likelihood = log_likelihoods[refitted_orders[-1]]  # type: ignore[misc]
        return refitted

    second = Candidate(kind.id, kind.make({order: 2.0}), kind.size, {order: 2.0})
    comparison = cast(ModelComparison, SimpleNamespace(refit=refit))
    acceptance = cast(Acceptance, SimpleNamespace(kinds=KINDS, penalty=lambda candidate, tried: 10.0))
    base = hypothesis([])
    base.log_likelihood = 0.0  # type: ignore[misc]
    scored = ScoredCandidate(second, 48.0, np.full(2, 0.01), np.ones(2), 2)
    best = refit_on_grid(comparison, acceptance, base, scored)
    assert refitted_orders == [2.0, 1.0]
    assert best.candidate.effect.values[order] == 1.0
    assert best.gain == 182.0


def test_added_candidate_is_the_one_scored_in_any_order_of_the_model() -> None:
    play, friction = (typical_candidate(KINDS[f"{name}.pitch"]) for name in ("backlash", "coulomb_friction"))
    # The cached model has the added play first, and not last as a new refit has.
    cached = hypothesis([play, friction])
    comparison = cast(ModelComparison, SimpleNamespace(refit=lambda *_: cached))
    acceptance = cast(Acceptance, SimpleNamespace(kinds=KINDS, penalty=lambda *_: 7.0))
    scored = ScoredCandidate(play, 0.0, np.zeros(1), np.ones(1), 1)
    refit = refit_on_grid(comparison, acceptance, hypothesis([friction]), scored)
    assert refit.candidate.id == "backlash.pitch"
