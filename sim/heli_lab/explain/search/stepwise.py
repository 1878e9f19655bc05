"""Stepwise search for causes: forward selection on the fitted flights, then exchange and elimination, and
once more if a cause was removed.

Each round scores all candidates about the current estimate, refits the best, and accepts one whose
log-likelihood ratio exceeds its BIC penalty. A spline term (`splines.py`) competes in every round. If it
beats every effect refitted over its grid, the cause is not in the catalogue: the spline stays in its place,
and the search goes on. Held-out flights have a part in one choice only, between play and friction of an axis
(`rivals.py`). Otherwise they only remove what they contradict.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.model.effects.spec import EffectSpec

from heli_lab.explain.search.acceptance import Acceptance
from heli_lab.explain.search.backward import BackwardElimination
from heli_lab.explain.search.exchange import exchange
from heli_lab.explain.search.forward import ForwardSelection
from heli_lab.explain.search.hypothesis import Cause, Hypothesis, Round
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.progress import Progress
from heli_lab.explain.search.screening import Screening

_MAX_TURNS: Final = 2
"""Turns of selection and elimination. Fewer: causes are missed that a false one hid until it was removed.
More: time."""


@dataclass(frozen=True)
class Search:
    """Result of a search."""

    baseline: Hypothesis  # The refitted model without causes
    final: Hypothesis  # The model with all causes, spline terms included
    causes: tuple[Cause, ...]
    """Effects and spline terms of the final model with their evidence, the strongest first."""
    rounds: tuple[Round, ...]  # Rounds of the forward selection
    screening: Screening  # Scores of candidates about the final model
    complete: bool  # False if the limit of refits ended the search


def search(
    comparison: ModelComparison,
    kinds: Mapping[str, EffectSpec],
    *,
    removable: Sequence[EffectSpec] = (),
    say: Callable[[str, float], None] | None = None,
    refits: float = math.inf,
) -> Search:
    """Search for the causes of what a model lacks."""
    progress = Progress(comparison, say or (lambda _step, _share: None), refits)
    acceptance = Acceptance(comparison, kinds)
    progress.baseline()
    baseline = comparison.refit([])
    forward = ForwardSelection(comparison, acceptance, progress, removable)
    backward = BackwardElimination(comparison, acceptance, progress, baseline, forward.rounds)
    forward.excluded_ids = backward.contradicted_ids
    final, causes = baseline, list[Cause]()
    for _ in range(_MAX_TURNS):
        progress.accepted = len(final.candidates)
        selected, screening, complete = forward.select(final)
        if selected is final:
            break
        exchanged = exchange(comparison, acceptance, progress, selected)
        final, causes = backward.eliminate(exchanged)
        if set(exchanged.ids) <= {*final.ids, *backward.replaced_ids}:
            break
    if final is not selected:
        screening = Screening(final.estimate)
    return Search(baseline, final, tuple(causes), tuple(forward.rounds), screening, complete)
