"""Progress of a search, and the limit of its work."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from heli_lab.explain.search.model_comparison import ModelComparison

_BASELINE, _FORWARD, _CHECKS, _END = 0.02, 0.1, 0.75, 0.9
"""Shares of a diagnosis at which the refit of the baseline, the forward rounds, the elimination and what
follows the search begin."""
_ROUND_DECAY: Final = 0.6
"""Share of the remaining forward search that remains after another round: their number is not known
beforehand."""


@dataclass
class Progress:
    """Reports what a search does, and says whether it may go on."""

    comparison: ModelComparison  # Counts the refits
    say: Callable[[str, float], None]
    """Called with the present step in words, and with the share of the whole diagnosis that is done, 0 to 1.
    """
    max_refits: float
    """Refits after which no further cause is tried. They include one refit for each accepted cause, which the
    elimination needs."""
    accepted: int = 0  # Causes that were accepted so far
    reached: float = 0.0
    """Largest share that was reported so far; a second turn of the search does not report less."""

    def refits_left(self) -> bool:
        """Whether another candidate may be refitted."""
        return self.comparison.fits + self.accepted < self.max_refits

    def baseline(self) -> None:
        """Report the refit of the baseline."""
        self._report("refitting the baseline", _BASELINE)

    def round(self, number: int) -> None:
        """Report that the forward round `number`, from 0, begins."""
        self._report(f"looking for what is missing, round {number + 1}", _forward_share(number))

    def trial(self, candidate_id: str, number: int) -> None:
        """Report the refit of the candidate `candidate_id` in the forward round `number`, from 0."""
        self._report(f"trying {candidate_id}", _forward_share(number + 0.5))

    def check(self, candidate_id: str, number: int, count: int) -> None:
        """Report the refit without the cause `candidate_id`, the `number`-th, from 0, of `count`."""
        self._report(f"checking whether {candidate_id} is needed", _CHECKS + 0.1 * number / count)

    def _report(self, step: str, share: float) -> None:
        # A search that runs into its limit ends there: the time left is no longer than the work left.
        work = _END * min(1.0, self.comparison.fits / max(self.max_refits, 1.0))
        self.reached = max(self.reached, share, work)
        self.say(step, self.reached)


def _forward_share(rounds: float) -> float:
    return float(_FORWARD + 0.6 * (1.0 - _ROUND_DECAY**rounds))
