"""The generalised likelihood ratio of every change from every onset in a sliding window.

The method is that of Willsky and Jones (1976). A change of size v at onset theta adds G(k; theta) v to
innovation k, which is white otherwise. With S = sum G'G and b = sum G' e, the log-likelihood therefore grows
by b' S^-1 b / 2 at the size S^-1 b. With a prior N(0, P) of the size, the evidence is, in nats,

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
"""Number of recent onsets that are all kept: one per block over the last half second. A jump of an encoder
shows only in the block in which it happens."""
KEPT: Final = 30
"""Number of older onsets, the most likely one of each half second: a window of 15 s. Longer: detects slower
fades, and takes more time per step. Shorter: the sizes stay uncertain."""
ONSETS: Final = RECENT + KEPT
WINDOW_s: Final = (KEPT + 1) * RECENT * BLOCK_s
"""Length of the window, s."""
WINDOW_BLOCKS: Final = (KEPT + 2) * RECENT
"""Length of the window plus half a second, in blocks."""
MIN_ZERO_SHIFT_COUNTS: Final = 2.0
"""Smallest jump of an encoder's zero that is reported, counts. Smaller: an angle at the border of a count
looks like a jump by one. Larger: lost edges stay undetected."""


@dataclass(frozen=True)
class ChangeCandidate:
    """A possible change with its most likely onset.

    Parameters
    ----------
    change : Change
        The hypothesis.
    onset_block : int
        Number of the filter's block after which the change began.
    size, std : float
        Estimate and standard error of the first number of the change, SI.
    log_evidence : float
        Log-likelihood ratio of the change, averaged over its onsets, against no change [nats].
    """

    change: Change
    onset_block: int
    size: float
    std: float
    log_evidence: float


@dataclass(frozen=True)
class Innovation:
    """Innovations of the encoders' measurements, axis by axis, and their sensitivity to the changes.

    Parameters
    ----------
    value : ndarray (3,)
        Innovations in their standard deviations; 0 where nothing was measured.
    sensitivity : ndarray (3, columns, onsets)
        Increase of the innovations by one unit of each change from each onset.
    """

    value: Floats
    sensitivity: Floats


class LikelihoodRatio:
    """Generalised likelihood ratio of every change at every onset, updated with each innovation.

    Parameters
    ----------
    changes : sequence of Change
        The hypotheses.
    count_rad : ndarray (3,)
        Angle of one count of each encoder [rad].
    draws : int, optional
        Number of sequences of innovations with the same sensitivities that are followed together; without it
        there is one. The window keeps the onsets of the draw with the largest evidence. The last draw ranks
        the changes.

    Attributes
    ----------
    evidence : ndarray (changes, onsets)
        Log-likelihood ratio of each change at each onset against no change [nats]; the largest of all draws.
    """

    def __init__(self, changes: Sequence[Change], count_rad: Floats, draws: int | None = None) -> None:
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
        self._non_negative = np.array([change.non_negative for change in changes])
        columns = [change.is_ramp for change in changes for _ in change.numbers]
        self.is_ramp: npt.NDArray[np.bool_] = np.array(columns)
        shape = (len(self.changes), ONSETS)
        self._s11, self._s12, self._s22 = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        each = shape if draws is None else (draws, *shape)
        self._b1, self._b2 = np.zeros(each), np.zeros(each)
        # Block of each onset; infinite for unused onsets.
        self._onset: Floats = np.full(shape, np.inf)
        self._column_of = np.repeat(np.arange(len(changes)), [len(c.numbers) for c in changes])
        self._halves = 0
        self.evidence: Floats = np.full(shape, -np.inf)
        self._last_evidence = self._first_evidence = self.evidence
        self._is_jump = np.array([change.is_jump for change in self.changes])

    def ages(self, block: int) -> Floats:
        """Return the age of each onset at the end of `block`, in blocks, (columns, onsets); negative for
        unused onsets.
        """
        return np.asarray(np.maximum(block - self._onset, -1.0)[self._column_of])

    def onset_blocks(self, column: int) -> Integers:
        """Return the block of each onset of a `column` of the sensitivities, (onsets,); -1 if unused."""
        onset = self._onset[self._column_of[column]]
        return np.where(np.isfinite(onset), onset, -1.0).astype(np.int64)

    def begin_onset(self, block: int, state_sensitivity: Floats) -> None:
        """Add the onset after `block` in place of the oldest recent one.

        Every half second the most likely recent onset of each change replaces the oldest one of the window.

        Parameters
        ----------
        block : int
            Number of the block after which a change may have begun.
        state_sensitivity : ndarray (order, columns, onsets)
            Array of the filter. The columns of the replaced onsets are overwritten.
        """
        place = block % RECENT
        if place == 0 and np.isfinite(self._onset[:, :RECENT]).all():
            self._keep(state_sensitivity)
        state_sensitivity[:, :, place] = 0.0
        for sums in (self._s11, self._s12, self._s22, self._b1, self._b2):
            sums[..., place] = 0.0
        self._onset[:, place] = block

    def _keep(self, state_sensitivity: Floats) -> None:
        """Move the most likely recent onset of each change to the older onsets."""
        to = RECENT + self._halves % KEPT
        self._halves += 1
        best = np.argmax(self.evidence[:, :RECENT], axis=1)
        rows = np.arange(len(best))
        for sums in (self._s11, self._s12, self._s22, self._b1, self._b2, self._onset):
            sums[..., to] = sums[..., rows, best]
        columns = np.arange(len(self._column_of))
        state_sensitivity[:, :, to] = state_sensitivity[:, columns, best[self._column_of]]

    def update(self, innovation: Innovation) -> float:
        """Add an innovation; return the evidence of the most likely change and onset [nats]."""
        return float(self.update_draws(innovation.value, innovation.sensitivity))

    def update_cut(self, innovation: Innovation, outlier: float) -> float:
        """Add an innovation to two draws: cut off at `outlier` standard deviations, and as it is. Return
        the evidence of the most likely change [nats]: of the cut draw, but for the jump of an encoder,
        which is an outlier itself.
        """
        values = np.stack((np.clip(innovation.value, -outlier, outlier), innovation.value))
        self.update_draws(values, innovation.sensitivity)
        jumps = self._last_evidence[self._is_jump]
        return float(max(self._first_evidence.max(), jumps.max(initial=-np.inf)))

    def update_draws(self, value: Floats, sensitivity: Floats) -> Floats:
        """Add the innovation `value`, (3,) or (draws, 3), with a `sensitivity` as of `Innovation`; return the
        evidence of the most likely change and onset of each draw [nats].
        """
        direction = sensitivity[:, self._first]
        two = sensitivity[:, self._second]
        self._s11 += np.einsum("aho,aho->ho", direction, direction)
        self._b1 += np.einsum("aho,...a->...ho", direction, value)
        self._s12 += np.where(self._pairs, np.einsum("aho,aho->ho", direction, two), 0.0)
        self._s22 += np.where(self._pairs, np.einsum("aho,aho->ho", two, two), 0.0)
        self._b2 += np.where(self._pairs, np.einsum("aho,...a->...ho", two, value), 0.0)
        size, std, gain, determinant = self._solved()
        evidence = 0.5 * gain - 0.5 * np.log(determinant)
        # A half-normal prior: twice the posterior mass above zero.
        sided = self._non_negative
        evidence[..., sided, :] += np.log(2.0) + log_ndtr(size[..., sided, :] / std[sided])
        evidence = np.where(np.isfinite(self._onset) & (np.abs(size) >= self._least), evidence, -np.inf)
        each = evidence.reshape(-1, *self._onset.shape)
        self.evidence, self._last_evidence = each.max(axis=0), each[-1]
        self._first_evidence = each[0]
        return np.asarray(evidence.max(axis=(-2, -1)))

    def _solved(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Estimates of all changes at all onsets.

        Returns
        -------
        size, std : ndarray (..., changes, onsets)
            Estimate of the first number and its standard error, SI.
        gain : ndarray (..., changes, onsets)
            The form b' (S + 1/P)^-1 b of the evidence.
        determinant : ndarray (changes, onsets)
            The determinant det(1 + P S) of the evidence.
        """
        p1, p2 = self._precision[0][:, None], self._precision[1][:, None]
        a, b, d = self._s11 + p1, self._s12, self._s22 + p2
        determinant = a * d - b**2
        size = (d * self._b1 - b * self._b2) / determinant
        other = (a * self._b2 - b * self._b1) / determinant
        std = np.sqrt(d / determinant)
        return size, std, size * self._b1 + other * self._b2, determinant / (p1 * p2)

    def standard_error(self, change: str, onset_block: float) -> float | None:
        """Return the standard error of the first number of a change, SI; None while the window is empty.

        Parameters
        ----------
        change : str
            Id of the change.
        onset_block : float
            Block near which the change began; the nearest onset counts.
        """
        row = [change_.id for change_ in self.changes].index(change)
        away = np.abs(self._onset[row] - onset_block)
        nearest = int(np.argmin(away))
        return float(self._solved()[1][row, nearest]) if np.isfinite(away[nearest]) else None

    def ranking(self) -> list[ChangeCandidate]:
        """Return all changes, the most likely first; all onsets have the same prior probability."""
        size, std, _, _ = self._solved()
        size = size.reshape(-1, *self._onset.shape)[-1]
        best = np.argmax(self._last_evidence, axis=1)
        used = max(1, int(np.isfinite(self._onset[0]).sum()))
        together = logsumexp(self._last_evidence, axis=1) - np.log(used)
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
