"""A step is found though weather stands for it; what a spline displaced comes back where it does not hold."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_lab.diagnose.candidate import Candidate, typical_candidate
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.screening import Scored, Screening
from heli_lab.diagnose.search import _Searcher
from heli_lab.diagnose.search_record import Refit, Round
from heli_lab.diagnose.spline_term import spline_term
from heli_lab.identify import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
MOMENT_s = 13.7


@pytest.mark.slow
def test_a_step_that_passes_for_weather_is_scored_where_the_missing_torque_jumps() -> None:
    rig = load_rig("makki2024")
    record = prepare(flights(f"counterweight_shift=0.009@{MOMENT_s}")[0], rig, "fit")
    base = ModelComparison(MultibodyModel(), rig, [record], []).refit([])
    slow = base.estimate.disturbances
    assert slow.slow_std[0] > 0.01 or slow.fast_std[0] > 0.01
    (found,) = Screening(base.estimate).effects([KINDS["counterweight_shift"]])
    assert found.candidate.grid["counterweight_shift_at_s"] == pytest.approx(MOMENT_s, abs=0.3)
    assert found.log_likelihood_gain > 30.0


def hypothesis(candidates: list[Candidate]) -> Hypothesis:
    """Some causes, without an estimate."""
    return cast(
        Hypothesis,
        SimpleNamespace(
            candidates=tuple(candidates),
            ids=tuple(one.id for one in candidates),
            values={one.id: float(n) for n, one in enumerate(candidates)},
        ),
    )


def test_what_a_spline_displaced_comes_back_where_the_flights_held_out_speak_against_it() -> None:
    first, second, third = (
        typical_candidate(KINDS[id_]) for id_ in ("rotor_lag", "encoder_eccentricity.travel", "axis_tilt")
    )
    made = spline_term("measurement.travel", "travel", -1.0, 0.25, 1)
    spline = Candidate("spline:measurement.travel:travel", made, tuple(made.priors))
    asked: list[list[str]] = []

    def refit(candidates: list[Candidate], start: dict[str, float], warm_start: Hypothesis) -> Hypothesis:
        asked.append([one.id for one in candidates])
        assert start.keys() >= {second.id}
        return hypothesis(candidates)

    listed = Refit(hypothesis([first, second, third]), 40.0, 10.0, 30.0)
    rounds = [
        Round((), (), (), first.id),
        Round((), (), (), second.id),
        Round((), (), (Refit(hypothesis([spline]), 99.0, 10.0, 99.0), listed), spline.id),
    ]
    bases = [hypothesis([]), hypothesis([first]), hypothesis([first, second])]
    searcher = cast(
        _Searcher,
        SimpleNamespace(
            rounds=rounds,
            bases=bases,
            comparison=SimpleNamespace(refit=refit),
            _accepted=lambda one: one is listed,
        ),
    )
    final, less = hypothesis([first, spline]), hypothesis([first])
    found = _Searcher._instead(searcher, final, spline.id, less)
    assert asked == [[first.id, second.id, third.id]]
    assert found.ids == (first.id, second.id, third.id)
    # A cause that is no spline is dropped, and nothing comes in its place.
    assert _Searcher._instead(searcher, final, first.id, hypothesis([spline])).ids == (spline.id,)
    assert len(asked) == 1
    assert np.isfinite(list(found.values.values())).all()


def test_a_number_that_only_a_grid_searches_is_tried_on_both_sides_of_the_best_score() -> None:
    kind = KINDS["encoder_eccentricity.travel"]
    order = kind.full("order")
    gain = {1.0: 182.0, 2.0: 125.0}
    asked: list[float] = []

    def refit(candidates: list[Candidate], start: dict[str, float], warm_start: Hypothesis) -> Hypothesis:
        asked.append(candidates[-1].effect.values[order])
        found = hypothesis(candidates)
        found.log_likelihood = gain[asked[-1]]  # type: ignore[misc]
        return found

    second = Candidate(kind.id, kind.make({order: 2.0}), kind.size, {order: 2.0})
    searcher = cast(
        _Searcher,
        SimpleNamespace(
            kinds=KINDS, comparison=SimpleNamespace(refit=refit), penalty=lambda candidate, tried: 10.0
        ),
    )
    searcher._on_grid = lambda scored: _Searcher._on_grid(searcher, scored)  # type: ignore[method-assign]
    base = hypothesis([])
    base.log_likelihood = 0.0  # type: ignore[misc]
    found = _Searcher.attempt(searcher, base, [], Scored(second, 48.0, np.full(2, 0.01), np.ones(2), 2))
    assert asked == [2.0, 1.0]
    assert found.candidate.effect.values[order] == 1.0
    assert found.gain == 182.0
