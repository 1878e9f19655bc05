"""The search never combines effects whose declarations exclude each other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from heli_lab.explain.candidates import Candidate, spline_term, typical_candidate
from heli_lab.explain.comparison import Hypothesis, Refit, Round
from heli_lab.explain.regression import ListedEffects
from heli_lab.explain.run import _is_candidate
from heli_lab.explain.stepwise import BackwardElimination
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, parse_effects

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()


def hypothesis(*ids: str) -> Hypothesis:
    """Return a model with typical causes, without an estimate."""
    candidates = tuple(typical_candidate(KINDS[id_]) for id_ in ids)
    return cast(Hypothesis, SimpleNamespace(candidates=candidates, ids=ids, values={}))


def test_effects_in_the_place_of_an_equation_may_join_its_causes() -> None:
    listed = ListedEffects(cast(Any, None), hypothesis("input_delay"), KINDS, lambda _: None)
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
        return hypothesis(*refitted[-1])

    best = Refit(hypothesis("rotor_lag_with_delay"), 40.0, 10.0, 30.0)
    base = hypothesis("axis_tilt")
    round_ = Round(base, (), (), (best,), spline.id)
    acceptance = SimpleNamespace(accepts=lambda _: True, kinds=KINDS)
    backward = BackwardElimination(
        cast(Any, SimpleNamespace(refit=refit)), cast(Any, acceptance), cast(Any, None), base, [round_]
    )
    final = cast(Hypothesis, SimpleNamespace(candidates=(spline, *hypothesis("input_delay").candidates)))
    backward.restore_displaced(final, spline.id, hypothesis("input_delay"))
    assert refitted == [("input_delay", "axis_tilt")]
