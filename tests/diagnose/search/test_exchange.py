"""A lag with a delay gives way to the delay or the lag alone if the flights do not resolve the other."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from heli_lab.explain.candidates import Candidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.forward import Acceptance
from heli_lab.explain.stepwise import BackwardElimination, exchange
from heli_sim.model.effects import catalogue

pytestmark = pytest.mark.diagnosis

KINDS = catalogue()
RECORD = SimpleNamespace(step_s=1e-3, count_rad=np.full(3, 0.0015))
WIDE = "rotor_lag_with_delay"
NATS = {WIDE: 2960.0, "input_delay": 2932.0, "rotor_lag": 1798.0}


def hypothesis(id_: str, lag_s: float, delay_s: float) -> Hypothesis:
    """Return a model with a lag or delay of these sizes, and with a friction that no exchange affects."""
    names = {WIDE: ("lag_s", "delay_s"), "input_delay": ("s",), "rotor_lag": ("s",)}[id_]
    sizes = {WIDE: (lag_s, delay_s), "input_delay": (delay_s,), "rotor_lag": (lag_s,)}[id_]
    values = {KINDS[id_].full(name): size for name, size in zip(names, sizes, strict=True)}
    friction = typical_candidate(KINDS["coulomb_friction.travel"])
    candidates = (friction, typical_candidate(KINDS[id_]))
    stub = SimpleNamespace(
        candidates=candidates,
        ids=tuple(candidate.id for candidate in candidates),
        values={**values, **friction.effect.values},
        std={**dict.fromkeys(values, 3.5e-4), **dict.fromkeys(friction.effect.values, 1e-3)},
        log_likelihood=NATS[id_],
    )
    return cast(Hypothesis, stub)


def exchanged(final: Hypothesis, lag_s: float, delay_s: float) -> tuple[Hypothesis, list[dict[str, float]]]:
    """Return the result of an exchange and the start values of its refits, which all end at these sizes."""
    starts: list[dict[str, float]] = []

    def refit(candidates: list[Candidate], start: dict[str, float], _warm: Hypothesis) -> Hypothesis:
        starts.append(start)
        return hypothesis(candidates[-1].id, lag_s, delay_s)

    comparison = SimpleNamespace(refit=refit, train=[RECORD], rows=30000)
    progress = SimpleNamespace(refits_left=lambda: True)
    acceptance = Acceptance(cast(ModelComparison, comparison), KINDS)
    result = exchange(cast(ModelComparison, comparison), acceptance, cast(Any, progress), final)
    return result, starts


def test_a_lag_below_a_step_is_left_out_although_the_fit_finds_it_significant() -> None:
    result, starts = exchanged(hypothesis(WIDE, 0.0008, 0.0283), 0.0008, 0.0283)
    assert result.ids == ("coulomb_friction.travel", "input_delay")
    assert {"input_delay_s": 0.0283} in starts
    assert {"rotor_lag_s": 0.0008} in starts


def test_a_lag_and_a_delay_that_are_both_resolved_stay() -> None:
    final = hypothesis(WIDE, 0.02, 0.0283)
    result, starts = exchanged(final, 0.02, 0.0283)
    assert result is final
    assert starts == []


@pytest.mark.parametrize(("lag_s", "is_wide"), [(0.0008, False), (0.02, True)])
def test_a_delay_becomes_a_lag_with_delay_only_if_the_lag_is_resolved(lag_s: float, is_wide: bool) -> None:
    result, _ = exchanged(hypothesis("input_delay", 0.0, 0.0295), lag_s, 0.0283)
    assert (WIDE in result.ids) is is_wide


def test_effects_with_sizes_that_no_flight_resolves_are_no_alternatives() -> None:
    comparison = SimpleNamespace(train=[RECORD])
    acceptance = Acceptance(cast(ModelComparison, comparison), KINDS)
    backward = BackwardElimination(cast(Any, comparison), acceptance, cast(Any, None), cast(Any, None), [])
    delay, wide, lag = (typical_candidate(KINDS[id_]) for id_ in ("input_delay", WIDE, "rotor_speed_lag"))
    assert backward._adds_unresolved(delay, wide, hypothesis(WIDE, 0.0008, 0.0283))
    assert not backward._adds_unresolved(delay, wide, hypothesis(WIDE, 0.02, 0.0283))
    assert not backward._adds_unresolved(wide, delay, hypothesis("input_delay", 0.0, 0.0))
    assert not backward._adds_unresolved(delay, lag, hypothesis("rotor_lag", 0.0, 0.0))
