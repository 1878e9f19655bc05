"""Spline terms: their basis, and the channels and quantities that are tried."""

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.explain import forward
from heli_lab.explain.candidates import (
    KNOTS,
    Candidate,
    ScoredCandidate,
    bspline_basis,
    channel_quantity_pairs,
    knot_span,
    spline_term,
    typical_candidate,
)
from heli_lab.explain.comparison import Hypothesis, ModelComparison, Refit, Round
from heli_lab.explain.forward import Acceptance, Progress, refit_on_grid
from heli_lab.explain.screening import (
    Screening,
    concentrated_scores,
    hidden_in_disturbances,
    peak_frequencies_Hz,
    with_concentrated_scores,
)
from heli_lab.explain.stepwise import BackwardElimination, with_held_out_moments
from heli_lab.fit.flight_model import RigParameters
from heli_lab.fit.problem import Problem
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import NEVER_s
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis


def test_bspline_basis_has_a_sum_of_one_everywhere() -> None:
    values = np.linspace(-3.0, 5.0, 200)
    low, step = knot_span(values)
    assert bspline_basis(values, low, step).shape == (200, KNOTS)
    assert np.allclose(bspline_basis(values, low, step).sum(axis=1), 1.0)


def test_no_spline_of_a_measurement_on_thrust_is_tried() -> None:
    # The controller feeds the quantisation error back: such a term would be found in any flight.
    assert not [
        pair for pair in channel_quantity_pairs() if pair[0].startswith("measurement") and "thrust" in pair[1]
    ]


STEP_s = 0.04
PERIODIC_Hz = 2.34


def impulse_scores(seed: int, size: float, seconds: float = 45.0) -> Floats:
    """Scores of impulses under slow disturbances, with a periodic torque of this size."""
    t_s = np.arange(0.0, seconds, STEP_s)
    noise = np.random.default_rng(seed).standard_normal((2, len(t_s)))
    slow = np.zeros(len(t_s))
    for i in range(1, len(t_s)):
        slow[i] = 0.97 * slow[i - 1] + noise[0, i]
    scores: Floats = slow + noise[1] + size * np.sin(2.0 * np.pi * PERIODIC_Hz * t_s)
    return scores


@pytest.mark.parametrize("seed", range(5))
def test_a_periodic_torque_far_below_slow_disturbances_is_tried_first(seed: int) -> None:
    first, *_ = peak_frequencies_Hz([impulse_scores(seed, 0.8)], STEP_s)
    assert first == pytest.approx(PERIODIC_Hz, abs=0.02)


def test_a_periodic_torque_in_the_second_flight_alone_is_tried_too() -> None:
    flights = [impulse_scores(6, 0.0), impulse_scores(7, 0.8, 60.0)]
    assert peak_frequencies_Hz(flights, STEP_s)[0] == pytest.approx(PERIODIC_Hz, abs=0.02)


def test_scores_of_a_resting_axis_give_one_default_frequency() -> None:
    assert peak_frequencies_Hz([np.zeros(500)], STEP_s) == (0.5,)


RIG = load_rig("makki2024")
KIND = catalogue()["counterweight_shift"]
SLIP_m = 0.02


@pytest.fixture(scope="module")
def comparison() -> ModelComparison:
    """A flight in which the counterweight slips."""
    flight = flights(f"counterweight_shift={SLIP_m}@9.3")[0]
    return ModelComparison(MultibodyModel(), RIG, [prepare(flight, RIG, "a")], [])


@pytest.mark.slow
def test_concentrated_score_of_a_slip_predicts_the_gain_of_its_refit(comparison: ModelComparison) -> None:
    base = comparison.refit([])
    screening = Screening(base.estimate)
    (plain,) = screening.effects([KIND])
    (concentrated,) = concentrated_scores(screening, [plain])
    start = concentrated.candidate.start_values(concentrated.coefficients)
    refit = comparison.refit([concentrated.candidate], start, base)
    gain = refit.log_likelihood - base.log_likelihood
    # 51 and 76 nats (2026-11).
    assert 1.4 * plain.log_likelihood_gain < concentrated.log_likelihood_gain
    assert 0.25 * gain < concentrated.log_likelihood_gain < 1.2 * gain
    assert concentrated.coefficients[0] == pytest.approx(SLIP_m, rel=0.3)


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_round_without_a_cause_refits_what_the_disturbances_hide(monkeypatch: pytest.MonkeyPatch) -> None:
    spring = ScoredCandidate(
        typical_candidate(catalogue()["cable_spring.elevation"]),
        log_likelihood_gain=4.8,
        coefficients=np.zeros(1),
        std=np.ones(1),
        grid_points=1,
    )
    hidden = replace(spring, log_likelihood_gain=183.0)
    refitted: list[ScoredCandidate] = []
    monkeypatch.setattr(forward, "hidden_in_disturbances", lambda screening, worth, scored: [hidden])
    monkeypatch.setattr(forward, "paused_play", lambda *_: [])
    monkeypatch.setattr(forward, "resting_friction", lambda *_: [])
    acceptance = SimpleNamespace(worth_a_refit=lambda scored: [], accepts=lambda refit: False, kinds={})
    progress = SimpleNamespace(refits_left=lambda: True)
    round_refits = forward.RoundRefits(
        cast(Any, None),
        acceptance=cast(Any, acceptance),
        progress=cast(Any, progress),
        number=0,
        base=cast(Any, None),
        screened=[spring],
    )
    monkeypatch.setattr(round_refits, "_refit", refitted.append)
    round_refits.refit_effects(cast(Any, None))
    assert refitted == [hidden]


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
            params={candidate.id: float(n) for n, candidate in enumerate(candidates)},
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
    listed = Refit(hypothesis([first, second, third]), gain=40.0, penalty=10.0, score=30.0)
    bases = [hypothesis([]), hypothesis([first]), hypothesis([first, second])]
    refits = (Refit(hypothesis([spline]), gain=99.0, penalty=10.0, score=99.0), listed)
    rounds = [
        Round(bases[0], screened=(), splines=(), refits=(), accepted_id=first.id),
        Round(bases[1], screened=(), splines=(), refits=(), accepted_id=second.id),
        Round(bases[2], screened=(), splines=(), refits=refits, accepted_id=spline.id),
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
    assert np.isfinite(list(restored.params.values())).all()


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
    backward = BackwardElimination(
        nothing, acceptance=cast(Acceptance, acceptance), progress=nothing, baseline=hypothesis([]), rounds=[]
    )
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
    scored = ScoredCandidate(
        second, log_likelihood_gain=48.0, coefficients=np.full(2, 0.01), std=np.ones(2), grid_points=2
    )
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
    scored = ScoredCandidate(
        play, log_likelihood_gain=0.0, coefficients=np.zeros(1), std=np.ones(1), grid_points=1
    )
    refit = refit_on_grid(comparison, acceptance, hypothesis([friction]), scored)
    assert refit.candidate.id == "backlash.pitch"


EVENT_FLIGHTS_MOMENT_s, OTHER_s = 9.3, 6.2


def test_moment_of_an_event_belongs_to_its_flight() -> None:
    records = [
        replace(prepare(flights("rotor_lag=0.1")[0], RIG, "x"), label=label) for label in ("a", "b", "c")
    ]
    effect = replace(KIND.make(KIND.typical), flight="a", other_moments_s={"b": 6.0})
    model = MultibodyModel((effect,))
    vector, problem = RigParameters(model, RIG, records), Problem(model, RIG, records)
    index_of_moment = model.parameter_names.index("counterweight_shift_at_s")
    for parameters in (vector, problem.parameter_vector):
        theta = parameters.started_from({"counterweight_shift_at_s": 11.0})
        source = vector if parameters is vector else problem
        moments_s = [source.parameters(theta, flight)[index_of_moment] for flight in range(3)]
        assert moments_s == [11.0, 6.0, NEVER_s]
    shared = MultibodyModel((replace(effect, flight=""),))
    theta = RigParameters(shared, RIG, records).started_from({"counterweight_shift_at_s": 11.0})
    assert RigParameters(shared, RIG, records).parameters(theta, 2)[index_of_moment] == 11.0


@pytest.mark.slow
@pytest.mark.parametrize("held_out_s", [None, OTHER_s])
def test_a_slip_is_found_in_the_flight_where_it_happened(held_out_s: float | None) -> None:
    fitted = flights(f"counterweight_shift={SLIP_m}@{EVENT_FLIGHTS_MOMENT_s}")[0]
    other = flights(*([f"counterweight_shift={SLIP_m}@{held_out_s}"] if held_out_s else []))[1]
    comparison = ModelComparison(
        MultibodyModel(), RIG, [prepare(fitted, RIG, "a")], [prepare(other, RIG, "b")]
    )
    base = comparison.refit([])
    (scored,) = Screening(base.estimate).effects([KIND])
    assert scored.candidate.effect.flight == "a"
    refit = comparison.refit([scored.candidate], scored.candidate.start_values(scored.coefficients), base)
    # The clock of a log starts a little before that of the simulation.
    assert refit.params["counterweight_shift_at_s"] == pytest.approx(EVENT_FLIGHTS_MOMENT_s, abs=0.2)
    final = with_held_out_moments(comparison, refit)
    moments_s = final.candidates[0].effect.other_moments_s
    if held_out_s is None:
        assert not moments_s
    else:
        assert moments_s["b"] == pytest.approx(held_out_s, abs=0.2)
    # If the event had the same moment in both flights, the held-out flight would contradict it.
    with_event, without_event = (
        comparison.held_out_estimate(model).log_likelihood for model in (final, base)
    )
    assert with_event > without_event + 10.0
    assert np.isfinite([with_event, without_event]).all()


def test_effects_without_a_flight_happen_in_every_flight() -> None:
    (effect,) = parse_effects(["counterweight_shift=0.01@12"])
    assert effect.values_in("any", effect.values) == dict(effect.values)
