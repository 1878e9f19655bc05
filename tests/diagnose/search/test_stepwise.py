"""Selection and elimination take turns: a cause that a false one hid is found after the false one is gone."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest
from heli_lab.explain import stepwise
from heli_lab.explain.comparison import Hypothesis
from heli_lab.explain.forward import ForwardSelection
from heli_lab.explain.stepwise import BackwardElimination


def hypothesis(*ids: str) -> Hypothesis:
    """A model with these causes."""
    candidates = tuple(SimpleNamespace(id=id_) for id_ in ids)
    return cast(Hypothesis, SimpleNamespace(ids=ids, candidates=candidates, estimate=None))


def searched(monkeypatch: pytest.MonkeyPatch, kept: list[str]) -> tuple[tuple[str, ...], list[str]]:
    """Return the causes, and where each selection began, if only the `kept` causes are needed.

    The selection adds a play first; it hides a lag until held-out flights contradict it.
    """
    starts: list[str] = []

    def select(forward: Any, start: Hypothesis) -> tuple[Hypothesis, None, bool]:
        starts.append(" ".join(start.ids))
        if "backlash.pitch" not in forward.excluded_ids:
            return hypothesis("backlash.pitch"), None, True
        return (start if start.ids else hypothesis("rotor_lag")), None, True

    def eliminate(backward: Any, final: Hypothesis) -> tuple[Hypothesis, list[str]]:
        backward.contradicted_ids |= set(final.ids) - set(kept)
        ids = [id_ for id_ in final.ids if id_ in kept]
        return hypothesis(*ids), ids

    monkeypatch.setattr(ForwardSelection, "select", select)
    monkeypatch.setattr(BackwardElimination, "eliminate", eliminate)
    monkeypatch.setattr(stepwise, "exchange", lambda *given: given[-1])
    monkeypatch.setattr(stepwise, "Screening", lambda _: None)
    comparison = SimpleNamespace(refit=lambda _: hypothesis(), fits=0)
    result = stepwise.search(cast(Any, comparison), {})
    return result.final.ids, starts


def test_a_cause_is_found_after_the_play_that_hid_it_was_contradicted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert searched(monkeypatch, ["rotor_lag"]) == (("rotor_lag",), ["", ""])


def test_causes_that_are_all_needed_take_one_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    assert searched(monkeypatch, ["backlash.pitch"]) == (("backlash.pitch",), [""])
