"""Dry friction and play of one axis: both make its count pause, so either may explain much of what the other
one does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from heli_lab.explain.search.hypothesis import Refit
from heli_lab.explain.search.model_comparison import ModelComparison

PAUSE_FAMILIES: Final = ("coulomb_friction", "backlash")
"""Families of effects that make the count of an axis pause."""


def better_rival(comparison: ModelComparison, best: Refit, accepted: Sequence[Refit]) -> Refit:
    """Return the more likely one on all flights of `best` and its rival, the other effect that makes the same
    count pause.

    The fitted flights alone may prefer the wrong effect, because it fits their peculiarities. While each
    measurement of a rest counted, friction of 0.03 N m gained 207 nats more there than the play that was
    hidden in a measured flight, and 516 nats less on the held-out flight. Since a rest counts once, the
    fitted flights alone would have made the same choice in 16 simulated and measured flights; in one of
    them, it is wrong (2026-11).
    """
    family, _, axis = best.candidate.id.partition(".")
    if family not in PAUSE_FAMILIES or not comparison.held_out:
        return best
    ids = {f"{rival}.{axis}" for rival in PAUSE_FAMILIES}
    rivals = [refit for refit in accepted if refit.candidate.id in ids]
    if len(rivals) < len(PAUSE_FAMILIES):
        return best

    def on_all_flights(refit: Refit) -> float:
        return refit.margin + comparison.held_out_estimate(refit.hypothesis).log_likelihood

    return max(rivals, key=on_all_flights)
