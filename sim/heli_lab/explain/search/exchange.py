"""Exchange: a wider effect in the place of one that it contains as a special case, or the other way round."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from heli_sim.model.effects.spec import EffectSpec

from heli_lab.explain import thresholds
from heli_lab.explain.search.acceptance import Acceptance
from heli_lab.explain.search.candidate import Candidate, may_join
from heli_lab.explain.search.hypothesis import Hypothesis
from heli_lab.explain.search.model_comparison import ModelComparison
from heli_lab.explain.search.progress import Progress


def exchange(
    comparison: ModelComparison, acceptance: Acceptance, progress: Progress, final: Hypothesis
) -> Hypothesis:
    """Replace effects by wider ones of which the flights resolve each size, and those of which they do not by
    narrower ones, until nothing changes.
    """
    final = _without_unresolved_sizes(comparison, acceptance, progress, final)
    kinds = acceptance.kinds
    for candidate in final.candidates:
        for kind in kinds.values():
            if candidate.id not in kind.contains or kind.id in final.ids or not progress.refits_left():
                continue
            other_causes = [other for other in final.candidates if other is not candidate]
            if not may_join(kind.id, [other.id for other in other_causes], kinds):
                continue
            wider = Candidate(kind.id, kind.make(kind.from_contained(final.values)), (), {})
            refit = comparison.refit([*other_causes, wider], wider.start_values(np.zeros(0)), final)
            gain = refit.log_likelihood - final.log_likelihood
            margin = gain - acceptance.penalty(wider) + acceptance.penalty(candidate)
            if margin > thresholds.MIN_MARGIN and acceptance.resolves(refit, kind):
                return exchange(comparison, acceptance, progress, refit)
    return final


def _without_unresolved_sizes(
    comparison: ModelComparison, acceptance: Acceptance, progress: Progress, final: Hypothesis
) -> Hypothesis:
    """Replace each effect of which the flights do not resolve all sizes by the likeliest of those that it
    contains.

    A delay of 29 ms without disturbances came out as one of 28 ms with a lag of 0.8 ms, because voltages are
    held over a step of 1 ms.
    """
    kinds = acceptance.kinds
    for candidate in final.candidates:
        kind = kinds.get(candidate.id)
        if kind is None or not kind.contains or acceptance.resolves(final, kind):
            continue
        other_causes = [other for other in final.candidates if other is not candidate]
        narrower = [
            comparison.refit([*other_causes, contained], contained.effect.values, final)
            for contained in _contained(kind, kinds, final.values)
            if progress.refits_left()
        ]
        if narrower:
            final = max(narrower, key=lambda hypothesis: hypothesis.log_likelihood)
    return final


def _contained(
    kind: EffectSpec, kinds: Mapping[str, EffectSpec], values: Mapping[str, float]
) -> Iterator[Candidate]:
    """Yield the effects that an effect contains, at its values."""
    for id_, parameters in kind.contains.items():
        if id_ in kinds:
            contained = kinds[id_]
            own_values = {contained.full(name): values[kind.full(of)] for name, of in parameters.items()}
            yield Candidate(id_, contained.make(own_values), contained.size)
