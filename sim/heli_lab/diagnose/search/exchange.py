"""Exchange: a wider effect in the place of one that it contains as a special case."""

from __future__ import annotations

import numpy as np

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.search.acceptance import Acceptance, is_significant
from heli_lab.diagnose.search.candidate import Candidate, may_join
from heli_lab.diagnose.search.hypothesis import Hypothesis
from heli_lab.diagnose.search.model_comparison import ModelComparison
from heli_lab.diagnose.search.progress import Progress


def exchange(
    comparison: ModelComparison, acceptance: Acceptance, progress: Progress, final: Hypothesis
) -> Hypothesis:
    """Replace effects by wider ones until no replacement is significant.

    Parameters
    ----------
    final : Hypothesis
        The model that forward selection ended with.
    """
    kinds = acceptance.kinds
    for candidate in final.candidates:
        for kind in kinds.values():
            if candidate.id not in kind.contains or kind.id in final.ids or not progress.refits_left():
                continue
            others = [other for other in final.candidates if other is not candidate]
            if not may_join(kind.id, [other.id for other in others], kinds):
                continue
            wider = Candidate(kind.id, kind.make(kind.from_contained(final.values)), (), {})
            refit = comparison.refit([*others, wider], wider.start_values(np.zeros(0)), final)
            gain = refit.log_likelihood - final.log_likelihood
            margin = gain - acceptance.penalty(wider) + acceptance.penalty(candidate)
            if margin > thresholds.MIN_MARGIN and all(
                is_significant(refit, wider, kinds, name) for name in kind.size
            ):
                return exchange(comparison, acceptance, progress, refit)
    return final
