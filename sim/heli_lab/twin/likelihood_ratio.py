"""The generalised likelihood ratio of every change from every onset in a sliding window.

After Willsky and Jones (1976): a change of size v at onset theta adds G(k; theta) v to innovation k, which is
white otherwise, so with S = sum G'G and b = sum G' e the log-likelihood grows by b' S^-1 b / 2 at the size
S^-1 b. A prior N(0, P) of the size makes evidence of it, nats:

    b' (S + 1/P)^-1 b / 2 - log det(1 + P S) / 2,

so that hypotheses with more, or with vaguer, numbers do not win by having them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats, Integers
from heli_sim.model.parts import AXES
from scipy.special import log_ndtr, logsumexp

from heli_lab.estimation import BLOCK_s
from heli_lab.twin.changes import Change

RECENT: Final = 12
"""Onsets that are all kept: those of the last half second, one a block. An encoder that jumps shows in the
block in which it jumps or in none."""
KEPT: Final = 30
"""Onsets further back, the likeliest of each half second: a window of 15 s. Longer: slower fades are found,
for as much more time. Shorter: a size has no time to become known."""
ONSETS: Final = RECENT + KEPT
WINDOW_s: Final = (KEPT + 1) * RECENT * BLOCK_s
"""How far back the window reaches, s."""
WINDOW_BLOCKS: Final = (KEPT + 2) * RECENT
"""The same in blocks, and half a second more."""
MIN_ZERO_SHIFT_COUNTS: Final = 2.0
"""Jump of an encoder's zero from which on it is believed, counts. Smaller: an angle that dwells at the
border of a count looks like a jump by one. Larger: lost edges stay unseen."""


@dataclass(frozen=True)
class ChangeCandidate:
    """A change at its likeliest onset.

    Parameters
    ----------
    change : Change
        What changed.
    onset_block : int
        Block of the filter after which.
    size, std : float
        Its first number and the standard error of it.
    log_evidence : float
        Of the change at any onset against none, nats.
    """

    change: Change
    onset_block: int
    size: float
    std: float
    log_evidence: float


@dataclass(frozen=True)
class Innovation:
    """One encoder's measurement and what foretold it, for the axes one after the other.

    Parameters
    ----------
    value : ndarray (3,)
        Innovations in their standard deviations; 0 where nothing was measured.
    sensitivity : ndarray (3, columns, onsets)
        What one unit of each change from each onset adds to them.
    """

    value: Floats
    sensitivity: Floats


class LikelihoodRatio:
    """Sums for every change and onset, beside a filter.

    Parameters
    ----------
    changes : sequence of Change
        The hypotheses.
    count_rad : ndarray (3,)
        One count of each encoder.
    """

    def __init__(self, changes: Sequence[Change], count_rad: Floats) -> None:
        self.changes = tuple(changes)
        least = {
            f"zero_offset.{axis}": MIN_ZERO_SHIFT_COUNTS * count
            for axis, count in zip(AXES, count_rad, strict=True)
        }
        self._least: Floats = np.array([[least.get(change.id, 0.0)] for change in changes])
        firsts = np.cumsum([0, *(len(change.numbers) for change in changes)])
        self._first: Integers = firsts[:-1].astype(np.int64)
        pairs = np.array([len(change.numbers) > 1 for change in changes])
        self._second: Integers = np.where(pairs, self._first + 1, self._first)
        self._pairs = pairs[:, None]
        self._precision = np.array([[size**-2.0 for size in (*c.sizes, 1.0)[:2]] for c in changes]).T
        self._one_way = np.array([change.non_negative for change in changes])
        columns = [change.grows for change in changes for _ in change.numbers]
        self.grows: npt.NDArray[np.bool_] = np.array(columns)
        shape = (len(self.changes), ONSETS)
        self._s11, self._s12, self._s22 = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        self._b1, self._b2 = np.zeros(shape), np.zeros(shape)
        # Block of each onset; those that are not in use lie at infinity.
        self._onset: Floats = np.full(shape, np.inf)
        self._column_of = np.repeat(np.arange(len(changes)), [len(c.numbers) for c in changes])
        self._halves = 0
        self.evidence: Floats = np.full(shape, -np.inf)
        """Of each change from each onset, nats, shape (changes, onsets)."""

    def ages(self, block: int) -> Floats:
        """Blocks since each onset at the end of number `block`, (columns, onsets); below 0 where none is."""
        return np.asarray(np.maximum(block - self._onset, -1.0)[self._column_of])

    def onset_blocks(self, column: int) -> Integers:
        """Block of each onset of a `column` of the sensitivities, (onsets,); -1 where none is."""
        onset = self._onset[self._column_of[column]]
        return np.where(np.isfinite(onset), onset, -1.0).astype(np.int64)

    def begin_onset(self, block: int, moved: Floats) -> None:
        """Let a change begin after block number `block`; one that is half a second old is kept if it is the
        likeliest of its time, and then takes the place of one that leaves the window. `moved` is what
        the filter keeps of each onset, and is written.
        """
        place = block % RECENT
        if place == 0 and np.isfinite(self._onset[:, :RECENT]).all():
            self._keep(moved)
        moved[:, :, place] = 0.0
        for sums in (self._s11, self._s12, self._s22, self._b1, self._b2):
            sums[:, place] = 0.0
        self._onset[:, place] = block

    def _keep(self, moved: Floats) -> None:
        to = RECENT + self._halves % KEPT
        self._halves += 1
        best = np.argmax(self.evidence[:, :RECENT], axis=1)
        rows = np.arange(len(best))
        for sums in (self._s11, self._s12, self._s22, self._b1, self._b2, self._onset):
            sums[:, to] = sums[rows, best]
        columns = np.arange(len(self._column_of))
        moved[:, :, to] = moved[:, columns, best[self._column_of]]

    def take(self, innovation: Innovation) -> float:
        """Add an innovation; returns the evidence of the likeliest change at its likeliest onset, nats."""
        direction = innovation.sensitivity[:, self._first]
        two = innovation.sensitivity[:, self._second]
        value = innovation.value
        self._s11 += np.einsum("aho,aho->ho", direction, direction)
        self._b1 += np.einsum("aho,a->ho", direction, value)
        self._s12 += np.where(self._pairs, np.einsum("aho,aho->ho", direction, two), 0.0)
        self._s22 += np.where(self._pairs, np.einsum("aho,aho->ho", two, two), 0.0)
        self._b2 += np.where(self._pairs, np.einsum("aho,a->ho", two, value), 0.0)
        size, std, gain, determinant = self._solved()
        evidence = 0.5 * gain - 0.5 * np.log(determinant)
        # Of a prior on one side of zero half the mass is on the right one.
        inside = np.log(2.0) + log_ndtr(size[self._one_way] / std[self._one_way])
        evidence[self._one_way] += inside
        self.evidence = np.where(np.isfinite(self._onset) & (np.abs(size) >= self._least), evidence, -np.inf)
        return float(self.evidence.max())

    def _solved(self) -> tuple[Floats, Floats, Floats, Floats]:
        """First number and its standard error, b' (S + 1/P)^-1 b, and det(1 + P S)."""
        p1, p2 = self._precision[0][:, None], self._precision[1][:, None]
        a, b, d = self._s11 + p1, self._s12, self._s22 + p2
        determinant = a * d - b**2
        size = (d * self._b1 - b * self._b2) / determinant
        other = (a * self._b2 - b * self._b1) / determinant
        std = np.sqrt(d / determinant)
        return size, std, size * self._b1 + other * self._b2, determinant / (p1 * p2)

    def standard_error(self, change: str, onset_block: float) -> float | None:
        """Standard error of a change's first number; None while no onset lies in the window.

        Parameters
        ----------
        change : str
            Id of the change.
        onset_block : float
            Number of the block whose nearest onset is meant.
        """
        row = [change_.id for change_ in self.changes].index(change)
        away = np.abs(self._onset[row] - onset_block)
        nearest = int(np.argmin(away))
        return float(self._solved()[1][row, nearest]) if np.isfinite(away[nearest]) else None

    def ranking(self) -> list[ChangeCandidate]:
        """Changes, the likeliest first; each onset is as probable as another."""
        size, std, _, _ = self._solved()
        best = np.argmax(self.evidence, axis=1)
        used = max(1, int(np.isfinite(self._onset[0]).sum()))
        together = logsumexp(self.evidence, axis=1) - np.log(used)
        candidates = [
            ChangeCandidate(
                change,
                int(self._onset[i, best[i]]) if np.isfinite(self._onset[i, best[i]]) else 0,
                float(size[i, best[i]]),
                float(std[i, best[i]]),
                float(together[i]),
            )
            for i, change in enumerate(self.changes)
        ]
        return sorted(candidates, key=lambda candidate: -candidate.log_evidence)
