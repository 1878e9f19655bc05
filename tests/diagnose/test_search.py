"""Acceptance of candidates: friction and play that no score shows, and sizes that the Wald test misses."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab import code_digest
from heli_lab.errors import IdentifyError
from heli_lab.explain import forward, stepwise, thresholds
from heli_lab.explain.candidates import Candidate, ScoredCandidate, spline_term, typical_candidate
from heli_lab.explain.comparison import EstimateCache, Hypothesis, ModelComparison, Refit, Round, fingerprint
from heli_lab.explain.forward import (
    Acceptance,
    ForwardSelection,
    Progress,
    RoundRefits,
    Selection,
    better_rival,
    is_neutral,
    is_resolved,
    limited_std,
    min_margin,
    paused_play,
    resting_friction,
    time_std_s,
)
from heli_lab.explain.regression import ListedEffects
from heli_lab.explain.run import _is_candidate
from heli_lab.explain.screening import Screening
from heli_lab.explain.stepwise import BackwardElimination, exchange
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

from tests.diagnose.hidden import hovering

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()


def dry_friction(resting: list[float], *, there: tuple[str, ...] = ()) -> list[str]:
    """Return the ids of the dry frictions that are proposed if the axes rest for these shares of the time."""
    # Each must start from its typical size. `there` has the ids of the model's causes.
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
    lag = ScoredCandidate(
        typical_candidate(KINDS["rotor_lag"]),
        log_likelihood_gain=90.0,
        coefficients=np.zeros(1),
        std=np.ones(1),
        grid_points=1,
    )
    base = cast(Hypothesis, SimpleNamespace(ids=()))
    round_refits = RoundRefits(
        cast(ModelComparison, SimpleNamespace(held_out=())),
        acceptance=cast(Acceptance, acceptance),
        progress=cast(Progress, progress),
        number=0,
        base=base,
        screened=[lag],
    )
    round_refits.refit_effects(cast(Screening, screening))
    assert [refit.candidate.id for refit in round_refits.refits] == refitted_ids
    assert round_refits.tried_ids == set(refitted_ids)


def test_a_clear_log_likelihood_ratio_overrides_the_wald_test() -> None:
    kind = KINDS["coulomb_friction.elevation"]
    size = kind.size[0]
    hypothesis = cast(Hypothesis, SimpleNamespace(params={size: 0.03}, std={size: 0.05}))
    candidate = typical_candidate(kind)
    record = SimpleNamespace(step_s=0.01, count_rad=np.full(3, 0.0015))
    acceptance = Acceptance(cast(ModelComparison, SimpleNamespace(train=[record])), KINDS)
    assert acceptance.is_significant(Refit(hypothesis, gain=1300.0, penalty=11.0, score=0.0), candidate)
    assert not acceptance.is_significant(Refit(hypothesis, gain=30.0, penalty=11.0, score=0.0), candidate)


def test_a_play_needs_more_evidence_next_to_friction_about_its_axis() -> None:
    assert min_margin("backlash.pitch", ["coulomb_friction.pitch"]) == thresholds.PLAY_NEXT_TO_FRICTION_NATS
    assert min_margin("backlash.pitch", ["coulomb_friction.travel"]) == thresholds.MIN_MARGIN
    assert min_margin("coulomb_friction.pitch", ["backlash.pitch"]) == thresholds.MIN_MARGIN


TORQUE, ZERO, SLIP = "rotor_reaction_torque", "zero_offset.pitch", "counterweight_shift"


def hypothesis(candidates: Sequence[Candidate], gains: dict[str, float]) -> Hypothesis:
    """Return a model whose log-likelihood is the sum of the `gains` of its causes."""
    ids = tuple(candidate.id for candidate in candidates)
    nats = sum(gains.get(id_, 0.0) for id_ in ids)
    made = SimpleNamespace(
        candidates=tuple(candidates), ids=ids, params={}, log_likelihood=nats, estimate=None
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
    """Return the causes after the elimination, and the lead of each over its alternatives."""
    # `gains`: Log-likelihood ratio of each effect on the fitted flights.
    # `causes`: Causes that the selection ends with; each was accepted in a round that refitted the effects
    # `refitted` too.
    # `held_out`: The same as `gains` on the held-out flights.
    # `refits_left`: Whether the limit of refits allows more.
    # `refused`: Effects that are not significant.

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
    refits = tuple(
        Refit(of, gain=of.log_likelihood, penalty=8.0, score=of.log_likelihood, added_id=of.ids[0])
        for of in tried
    )
    base = hypothesis([], gains)
    rounds = [Round(base, screened=(), splines=(), refits=refits, accepted_id=id_) for id_ in causes]
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


def combinations_hypothesis(*ids: str) -> Hypothesis:
    """Return a model with typical causes, without an estimate."""
    candidates = tuple(typical_candidate(KINDS[id_]) for id_ in ids)
    return cast(Hypothesis, SimpleNamespace(candidates=candidates, ids=ids, params={}))


def test_effects_in_the_place_of_an_equation_may_join_its_causes() -> None:
    listed = ListedEffects(cast(Any, None), combinations_hypothesis("input_delay"), KINDS, lambda _: None)
    ids = {kind.id for kind in listed.eligible_effects}
    assert not ids & {"input_delay", "rotor_lag_with_delay"}
    assert ids >= {"rotor_lag", "rotor_speed_lag", "axis_tilt"}


def test_effects_of_the_given_model_exclude_candidates() -> None:
    model = MultibodyModel(parse_effects(["input_delay=0.02"]))
    tried = [id_ for id_, kind in KINDS.items() if _is_candidate(kind, model, {"input_delay"}, KINDS)]
    assert not {"input_delay", "rotor_lag_with_delay"} & set(tried)
    assert "rotor_lag" in tried


def test_displaced_effect_stays_out_if_a_later_cause_excludes_it() -> None:
    made = spline_term("measurement.travel", "travel", -1.0, 0.25, 1)
    spline = Candidate("spline:measurement.travel:travel", made, tuple(made.priors))
    refitted: list[tuple[str, ...]] = []

    def refit(candidates: list[Candidate], *_: object) -> Hypothesis:
        refitted.append(tuple(candidate.id for candidate in candidates))
        MultibodyModel(tuple(candidate.effect for candidate in candidates))
        return combinations_hypothesis(*refitted[-1])

    best = Refit(combinations_hypothesis("rotor_lag_with_delay"), gain=40.0, penalty=10.0, score=30.0)
    base = combinations_hypothesis("axis_tilt")
    round_ = Round(base, screened=(), splines=(), refits=(best,), accepted_id=spline.id)
    acceptance = SimpleNamespace(accepts=lambda _: True, kinds=KINDS)
    backward = BackwardElimination(
        cast(Any, SimpleNamespace(refit=refit)),
        acceptance=cast(Any, acceptance),
        progress=cast(Any, None),
        baseline=base,
        rounds=[round_],
    )
    final = cast(
        Hypothesis, SimpleNamespace(candidates=(spline, *combinations_hypothesis("input_delay").candidates))
    )
    backward.restore_displaced(final, spline.id, combinations_hypothesis("input_delay"))
    assert refitted == [("input_delay", "axis_tilt")]


RECORD = SimpleNamespace(step_s=1e-3, count_rad=np.full(3, 0.0015))
WIDE = "rotor_lag_with_delay"
NATS = {WIDE: 2960.0, "input_delay": 2932.0, "rotor_lag": 1798.0}


def exchange_hypothesis(id_: str, lag_s: float, delay_s: float) -> Hypothesis:
    """Return a model with a lag or delay of these sizes, and with a friction that no exchange affects."""
    names = {WIDE: ("lag_s", "delay_s"), "input_delay": ("s",), "rotor_lag": ("s",)}[id_]
    sizes = {WIDE: (lag_s, delay_s), "input_delay": (delay_s,), "rotor_lag": (lag_s,)}[id_]
    values = {KINDS[id_].full(name): size for name, size in zip(names, sizes, strict=True)}
    friction = typical_candidate(KINDS["coulomb_friction.travel"])
    candidates = (friction, typical_candidate(KINDS[id_]))
    stub = SimpleNamespace(
        candidates=candidates,
        ids=tuple(candidate.id for candidate in candidates),
        params={**values, **friction.effect.values},
        std={**dict.fromkeys(values, 3.5e-4), **dict.fromkeys(friction.effect.values, 1e-3)},
        log_likelihood=NATS[id_],
    )
    return cast(Hypothesis, stub)


def exchanged(final: Hypothesis, lag_s: float, delay_s: float) -> tuple[Hypothesis, list[dict[str, float]]]:
    """Return the result of an exchange and the start values of its refits, which all end at these sizes."""
    starts: list[dict[str, float]] = []

    def refit(candidates: list[Candidate], start: dict[str, float], _warm: Hypothesis) -> Hypothesis:
        starts.append(start)
        return exchange_hypothesis(candidates[-1].id, lag_s, delay_s)

    comparison = SimpleNamespace(refit=refit, train=[RECORD], rows=30000)
    progress = SimpleNamespace(refits_left=lambda: True)
    acceptance = Acceptance(cast(ModelComparison, comparison), KINDS)
    result = exchange(cast(ModelComparison, comparison), acceptance, cast(Any, progress), final)
    return result, starts


def test_a_lag_below_a_step_is_left_out_although_the_fit_finds_it_significant() -> None:
    result, starts = exchanged(exchange_hypothesis(WIDE, 0.0008, 0.0283), 0.0008, 0.0283)
    assert result.ids == ("coulomb_friction.travel", "input_delay")
    assert {"input_delay_s": 0.0283} in starts
    assert {"rotor_lag_s": 0.0008} in starts


def test_a_lag_and_a_delay_that_are_both_resolved_stay() -> None:
    final = exchange_hypothesis(WIDE, 0.02, 0.0283)
    result, starts = exchanged(final, 0.02, 0.0283)
    assert result is final
    assert starts == []


@pytest.mark.parametrize(("lag_s", "is_wide"), [(0.0008, False), (0.02, True)])
def test_a_delay_becomes_a_lag_with_delay_only_if_the_lag_is_resolved(lag_s: float, is_wide: bool) -> None:
    result, _ = exchanged(exchange_hypothesis("input_delay", 0.0, 0.0295), lag_s, 0.0283)
    assert (WIDE in result.ids) is is_wide


def test_effects_with_sizes_that_no_flight_resolves_are_no_alternatives() -> None:
    comparison = SimpleNamespace(train=[RECORD])
    acceptance = Acceptance(cast(ModelComparison, comparison), KINDS)
    backward = BackwardElimination(
        cast(Any, comparison), acceptance, progress=cast(Any, None), baseline=cast(Any, None), rounds=[]
    )
    delay, wide, lag = (typical_candidate(KINDS[id_]) for id_ in ("input_delay", WIDE, "rotor_speed_lag"))
    assert backward._adds_unresolved(delay, wide, exchange_hypothesis(WIDE, 0.0008, 0.0283))
    assert not backward._adds_unresolved(delay, wide, exchange_hypothesis(WIDE, 0.02, 0.0283))
    assert not backward._adds_unresolved(wide, delay, exchange_hypothesis("input_delay", 0.0, 0.0))
    assert not backward._adds_unresolved(delay, lag, exchange_hypothesis("rotor_lag", 0.0, 0.0))


STEP_s = 0.004
COUNT_rad = {"elevation": 0.002, "pitch": 0.002, "travel": 0.001}
RESOLUTION_RECORD = cast(Record, SimpleNamespace(step_s=STEP_s, count_rad=np.array([*COUNT_rad.values()])))


def stds_of(id_: str, **numbers: tuple[float, float]) -> dict[str, float]:
    """Return limited standard errors by name; `numbers` has estimate and standard error of the fit."""
    values = {name: value for name, (value, _) in numbers.items()}
    std = {name: std for name, (_, std) in numbers.items()}
    return limited_std(KINDS[id_], values, {**std, "thrust_gain": 0.1}, RESOLUTION_RECORD)


def test_no_standard_error_is_finer_than_steps_samples_and_counts_resolve() -> None:
    lag = stds_of("rotor_lag", rotor_lag_s=(0.1, 1e-6))
    # Half a sample, and 0.7 % of a size.
    assert lag == {"rotor_lag_s": pytest.approx(np.hypot(0.002, 0.0007), rel=1e-3)}
    step = stds_of(
        "thrust_step.front", thrust_step_front_share=(-0.2, 1e-6), thrust_step_front_at_s=(20.0, 0.03)
    )
    assert step["thrust_step_front_share"] == pytest.approx(0.0014, rel=1e-3)
    # A moment is no size.
    assert step["thrust_step_front_at_s"] == pytest.approx(np.hypot(1.4 * 0.03, 0.002))
    for axis, count_rad in COUNT_rad.items():
        (std,) = stds_of(f"backlash.{axis}", **{f"backlash_{axis}_rad": (0.0, 1e-6)}).values()
        assert std == pytest.approx(0.5 * count_rad, rel=1e-3)
    spring = stds_of("cable_spring.travel", cable_spring_travel_rest_rad=(0.3, 1e-6))
    assert spring["cable_spring_travel_rest_rad"] == 1e-6


def test_a_time_is_no_more_certain_than_half_a_step() -> None:
    assert time_std_s(0.0, STEP_s) == pytest.approx(0.5 * STEP_s)
    assert time_std_s(0.01, STEP_s) == pytest.approx(np.hypot(0.014, 0.5 * STEP_s))


@pytest.mark.parametrize(
    ("id_", "size", "too_small", "large_enough"),
    [
        # Two standard errors: a step of the voltages, or a count of the encoder.
        ("input_delay", "input_delay_s", 0.9 * STEP_s, 1.1 * STEP_s),
        ("backlash.travel", "backlash_travel_rad", 0.9 * COUNT_rad["travel"], 1.1 * COUNT_rad["travel"]),
        ("backlash.pitch", "backlash_pitch_rad", 0.9 * COUNT_rad["pitch"], 1.1 * COUNT_rad["pitch"]),
    ],
)
def test_delays_below_a_step_and_plays_below_a_count_are_not_significant(
    id_: str, size: str, too_small: float, large_enough: float
) -> None:
    comparison = cast(ModelComparison, SimpleNamespace(train=(RESOLUTION_RECORD,)))
    acceptance = Acceptance(comparison, KINDS)
    candidate = typical_candidate(KINDS[id_])
    for value, is_visible in ((too_small, False), (large_enough, True)):
        hypothesis = cast(Hypothesis, SimpleNamespace(params={size: value}, std={size: 1e-6}))
        assert is_resolved(hypothesis, KINDS[id_], RESOLUTION_RECORD) is is_visible
        assert (
            acceptance.is_significant(Refit(hypothesis, gain=30.0, penalty=8.0, score=0.0), candidate)
            is is_visible
        )
        # Evidence that is large for any size overrides the resolution: flights without disturbances.
        large = Refit(hypothesis, gain=thresholds.WALD_OVERRIDE_NATS + 9.0, penalty=8.0, score=0.0)
        assert acceptance.is_significant(large, candidate)


@pytest.mark.parametrize(
    "id_",
    [
        *("elevation_drag_quadratic", "pitch_drag_quadratic", "travel_drag_quadratic"),
        *("inflow_damping", "supply_sag", "ground_effect", "edgewise_flow"),
    ],
)
def test_effects_that_physics_allows_in_one_direction_have_no_negative_size(id_: str) -> None:
    (size,) = KINDS[id_].size
    assert KINDS[id_].priors[size].low == 0.0


HELD_OUT_NATS = {"coulomb_friction.pitch": 254.0, "backlash.pitch": 771.0, "backlash.travel": 5000.0}


def refit(id_: str, margin: float) -> Refit:
    """A refit with an effect of the catalogue."""
    candidate = typical_candidate(KINDS[id_])
    hypothesis = cast(Hypothesis, SimpleNamespace(candidates=(candidate,)))
    return Refit(hypothesis, gain=margin + 10.0, penalty=10.0, score=0.0, added_id=id_)


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
        hypothesis = cast(Hypothesis, SimpleNamespace(params=values, std={size: 1e-5}))
        assert is_neutral(hypothesis, candidate, KINDS) is is_absent
        assert (
            acceptance.is_significant(Refit(hypothesis, gain=289.0, penalty=7.0, score=0.0), candidate)
            is not is_absent
        )
    without_free_size = cast(Hypothesis, SimpleNamespace(params={}, std={}))
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
        SimpleNamespace(candidates=(friction, typical_candidate(kind)), params={size: 0.0}, std={size: 1e-5}),
    )
    stub = SimpleNamespace(refit=lambda candidates, start, warm_start: estimate_without_play)
    round_refits = RoundRefits(
        cast(ModelComparison, stub),
        acceptance=Acceptance(cast(ModelComparison, stub), KINDS),
        progress=cast(Any, None),
        number=0,
        base=base,
        screened=[],
        refits=[Refit(absent, gain=289.0, penalty=7.0, score=0.0, added_id="backlash.pitch")],
    )
    assert (round_refits.better_base() is estimate_without_play) is is_better


def stepwise_hypothesis(*ids: str) -> Hypothesis:
    """A model with these causes."""
    candidates = tuple(SimpleNamespace(id=id_) for id_ in ids)
    return cast(Hypothesis, SimpleNamespace(ids=ids, candidates=candidates, estimate=None))


def searched(monkeypatch: pytest.MonkeyPatch, kept: list[str]) -> tuple[tuple[str, ...], list[str]]:
    """Return the causes, and where each selection began, if only the `kept` causes are needed."""
    # The selection adds a play first; it hides a lag until held-out flights contradict it.
    starts: list[str] = []

    def select(forward: Any, start: Hypothesis) -> Selection:
        starts.append(" ".join(start.ids))
        if "backlash.pitch" not in forward.excluded_ids:
            selected = stepwise_hypothesis("backlash.pitch")
        else:
            selected = start if start.ids else stepwise_hypothesis("rotor_lag")
        return Selection(selected, cast(Any, None), complete=True)

    def eliminate(backward: Any, final: Hypothesis) -> tuple[Hypothesis, list[str]]:
        backward.contradicted_ids |= set(final.ids) - set(kept)
        ids = [id_ for id_ in final.ids if id_ in kept]
        return stepwise_hypothesis(*ids), ids

    monkeypatch.setattr(ForwardSelection, "select", select)
    monkeypatch.setattr(BackwardElimination, "eliminate", eliminate)
    monkeypatch.setattr(stepwise, "exchange", lambda *given: given[-1])
    monkeypatch.setattr(stepwise, "Screening", lambda _: None)
    comparison = SimpleNamespace(refit=lambda _: stepwise_hypothesis(), fits=0)
    result = stepwise.search(cast(Any, comparison), {})
    return result.final.ids, starts


def test_a_cause_is_found_after_the_play_that_hid_it_was_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert searched(monkeypatch, ["rotor_lag"]) == (("rotor_lag",), ["", ""])


def test_causes_that_are_all_needed_take_one_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    assert searched(monkeypatch, ["backlash.pitch"]) == (("backlash.pitch",), [""])


def _record() -> Record:
    """Return a short record."""
    return prepare(hovering(4.0), load_rig("makki2024"), "still")


def test_flights_rigs_models_and_parts_have_different_digests() -> None:
    rig, record = load_rig("makki2024"), _record()
    start, stop = record.segments[0]
    variants = (
        (MultibodyModel(), rig, [record]),
        (MultibodyModel(parse_effects(["rotor_lag=0.05"])), rig, [record]),
        (MultibodyModel(), rig.replace(thrust_gain=0.5), [record]),
        (MultibodyModel(), rig, [replace(record, angles_rad=record.angles_rad + 1e-9)]),
        (MultibodyModel(), rig, [replace(record, segments=((start, stop - 1),))]),
        (MultibodyModel(), rig, [record, record]),
    )
    digests = [fingerprint(*variant) for variant in variants]
    assert len(set(digests)) == len(digests)
    assert fingerprint(*variants[0]) == digests[0]


def test_fingerprint_changes_with_the_compiled_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = MultibodyModel(), load_rig("makki2024"), [_record()]
    before, read = fingerprint(*arguments), Path.read_bytes

    def rebuilt(path: Path) -> bytes:
        return read(path) + (b"rebuilt" if path.name.startswith("_kalman.") else b"")

    monkeypatch.setattr(Path, "read_bytes", rebuilt)
    code_digest.package_digest.cache_clear()
    after = fingerprint(*arguments)
    code_digest.package_digest.cache_clear()
    assert after != before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"search_of": "other"}\n', "is from a search with other flights"),
        (b"t_s,front_V\n0,1\n", "is not a --resume file"),
        (b"[1, 2]\n", "is not a --resume file"),
        (b"\xff\xfe\n", "is not a --resume file"),
    ],
)
def test_file_of_another_kind_is_refused_and_not_changed(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "search").write_bytes(content)
    with pytest.raises(IdentifyError, match=words):
        EstimateCache(tmp_path / "search", "mine")
    assert (tmp_path / "search").read_bytes() == content


def test_incomplete_last_line_is_dropped_and_earlier_lines_stay(tmp_path: Path) -> None:
    path = tmp_path / "search"
    EstimateCache(path, "mine")
    head = path.read_bytes()
    path.write_bytes(head + b'{"key": "a"}\n{"key": "b", "the')
    EstimateCache(path, "mine")
    assert path.read_bytes() == head + b'{"key": "a"}\n'
