"""The generalised likelihood ratio of every change from every onset in a sliding window.

The method is that of Willsky and Jones (1976). A change of size v at onset theta adds G(k; theta) v to
innovation k, which is white otherwise. With S = sum G'G and b = sum G' e, the log-likelihood therefore grows
by b' S^-1 b / 2 at the size S^-1 b. With a prior N(0, P) of the size, the evidence is, in nats,

    b' (S + 1/P)^-1 b / 2 - log det(1 + P S) / 2.

The determinant lowers the evidence of changes with two parameters, or with a wide prior.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from typing import Final, NamedTuple, Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats, Integers
from heli_sim.model.effect import AXES

from heli_lab.fit.linearised_flight import BLOCK_s
from heli_lab.watch.twin_model import Change

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
PERSISTENCE_BLOCKS: Final = 6
"""Number of measurements, 40 ms apart, over which evidence must persist before it counts: 0.24 s. Fewer:
rounding that a gust makes larger raises an alarm. More: sudden changes are reported that much later."""
CUT_OFF_STD: Final = 4.0
"""Size at which an innovation is cut off for the alarm (Huber), in standard deviations: 8 nats, below every
threshold. The jump of an encoder is seen uncut. Larger: a single kick of a real rig raises an alarm, and
those of nominal flights set the threshold: 38 nats at 5, 15 at 4. Smaller: large changes count little."""
_MIN_ZERO_SHIFT_COUNTS: Final = 2.0
"""Smallest jump of an encoder's zero that is reported, counts. Smaller: an angle at the border of a count
looks like a jump by one. Larger: lost edges stay undetected."""


T = TypeVar("T")


def independent_copy(original: T) -> T:
    """Return a copy with separate arrays. Other attributes are shared; no update changes them in place."""
    other = copy(original)
    for name, value in vars(original).items():
        if isinstance(value, np.ndarray):
            setattr(other, name, value.copy())
    return other


@dataclass(frozen=True)
class ChangeCandidate:
    """A possible change with its most likely onset."""

    change: Change  # The hypothesis
    onset_block: int  # Number of the filter's block after which the change began
    size: float  # size, std: Estimate and standard error of the change of the first parameter, SI
    std: float
    log_evidence: float
    """Log-likelihood ratio of the change, averaged over its onsets, against no change [nats]."""


@dataclass(frozen=True)
class Innovation:
    """Innovations of the encoders' measurements, axis by axis, and their sensitivity to the changes."""

    value: Floats  # (3,): Measured minus predicted angles, in standard deviations; 0 without a measurement
    sensitivity: Floats
    """(3, columns, onsets): Increase of the innovations by one unit of each change from each onset."""


class _Estimates(NamedTuple):
    """Estimates of each change at each onset, with S, b and the prior covariance P of its parameters."""

    size: Floats  # (draws, changes, onsets): Estimate of the first parameter
    std: Floats  # (changes, onsets): Its standard error
    quadratic_form: Floats  # b' (S + 1/P)^-1 b
    determinant: Floats  # (changes, onsets): det(1 + P S)


def _prior_precision(sizes: Sequence[tuple[float, ...]]) -> Floats:
    """Return the prior precision of the first and the second parameter of each change, (2, changes)."""
    # Without a second parameter, any precision will do, because its sums stay zero.
    two_sizes = [(*change_sizes, 1.0)[:2] for change_sizes in sizes]
    return np.array([[size**-2.0 for size in pair] for pair in two_sizes]).T


class LikelihoodRatio:
    """Generalised likelihood ratio of every change at every onset, updated with each innovation. `count_rad`
    has shape (3,). `evidence` has shape (changes, onsets).
    """

    def __init__(self, changes: Sequence[Change], count_rad: Floats, draws: int | None = None) -> None:
        # `draws`: Number of innovations per measurement, each with sums of its own; None for one.
        self.changes = tuple(changes)
        # Properties of each change. A change has one or two parameters, each with a column of sensitivities.
        min_sizes_rad = {
            f"zero_offset.{axis}": _MIN_ZERO_SHIFT_COUNTS * count
            for axis, count in zip(AXES, count_rad, strict=True)
        }
        self._min_size: Floats = np.array([[min_sizes_rad.get(change.id, 0.0)] for change in changes])
        counts = [len(change.parameters) for change in changes]
        has_second = np.array([count > 1 for count in counts])
        self._first_column: Integers = np.cumsum([0, *counts])[:-1].astype(np.int64)
        self._second_column: Integers = np.where(has_second, self._first_column + 1, self._first_column)
        self._has_second = has_second[:, None]
        self._change_of_column = np.repeat(np.arange(len(changes)), counts)
        self._precision = _prior_precision([change.sizes for change in changes])
        self._precision_from_start = _prior_precision([change.sizes_from_start for change in changes])
        self._non_negative = np.array([change.non_negative for change in changes])
        self._is_jump_change = np.array([change.is_jump for change in changes])
        self.is_ramp: npt.NDArray[np.bool_] = np.repeat([change.is_ramp for change in changes], counts)
        # Sums over innovations e with the sensitivities s1 and s2 to the first and the second parameter:
        # S = sum of s s', (changes, onsets), and b = sum of s e, (draws, changes, onsets).
        shape = (len(self.changes), ONSETS)
        self._s11, self._s12, self._s22 = np.zeros(shape), np.zeros(shape), np.zeros(shape)
        draws_shape = shape if draws is None else (draws, *shape)
        self._b1, self._b2 = np.zeros(draws_shape), np.zeros(draws_shape)
        # Block of each onset; infinite for unused onsets.
        self._onset: Floats = np.full(shape, np.inf)
        self._kept_count = 0
        self.evidence: Floats = np.full(shape, -np.inf)
        self._last_evidence = self._first_evidence = self.evidence  # of the last and the first draw

    def copy(self) -> LikelihoodRatio:
        """Return a ratio with the same sums, which develops independently."""
        return independent_copy(self)

    def ages(self, block: int) -> Floats:
        """Return the age of each onset at the end of `block`, in blocks, (columns, onsets); negative for
        unused onsets.
        """
        return np.asarray(np.maximum(block - self._onset, -1.0)[self._change_of_column])

    def onset_blocks(self, column: int) -> Integers:
        """Return the block of each onset of a `column` of the sensitivities, (onsets,); -1 if unused."""
        onset = self._onset[self._change_of_column[column]]
        return np.where(np.isfinite(onset), onset, -1.0).astype(np.int64)

    def begin_onset(self, block: int, state_sensitivity: Floats) -> None:
        """Add the onset after `block` in place of the oldest recent one. Shapes: `state_sensitivity` (order,
        columns, onsets).
        """
        # Every half second the most likely recent onset of each change replaces the oldest one of the window.
        # The recent onsets are a ring of the places 0 to RECENT - 1, the kept ones a ring of those after it.
        place = block % RECENT
        if place == 0 and np.isfinite(self._onset[:, :RECENT]).all():
            self._keep_best_onset(state_sensitivity)
        state_sensitivity[:, :, place] = 0.0
        for sums in (self._s11, self._s12, self._s22, self._b1, self._b2):
            sums[..., place] = 0.0
        self._onset[:, place] = block

    def _keep_best_onset(self, state_sensitivity: Floats) -> None:
        """Copy the most likely recent onset of each change over the oldest kept one."""
        oldest = RECENT + self._kept_count % KEPT
        self._kept_count += 1
        best = np.argmax(self.evidence[:, :RECENT], axis=1)
        changes = np.arange(len(best))
        for sums in (self._s11, self._s12, self._s22, self._b1, self._b2, self._onset):
            sums[..., oldest] = sums[..., changes, best]
        columns = np.arange(len(self._change_of_column))
        state_sensitivity[:, :, oldest] = state_sensitivity[:, columns, best[self._change_of_column]]

    def update(self, innovation: Innovation) -> float:
        """Add an innovation; return the evidence of the most likely change and onset [nats]."""
        return float(self.update_draws(innovation.value, innovation.sensitivity))

    def update_cut(self, innovation: Innovation, outlier: float) -> float:
        """Add an innovation to two draws: cut off at `outlier` standard deviations, and uncut."""
        # Returns the evidence of the most likely change of the cut draw [nats]. A jump of an encoder is
        # itself an outlier, so its evidence is that of the uncut draw.
        values = np.stack((np.clip(innovation.value, -outlier, outlier), innovation.value))
        self.update_draws(values, innovation.sensitivity)
        cut_evidence, uncut_evidence = self._first_evidence, self._last_evidence
        jump_evidence = uncut_evidence[self._is_jump_change]
        return float(max(cut_evidence.max(), jump_evidence.max(initial=-np.inf)))

    def update_draws(self, value: Floats, sensitivity: Floats) -> Floats:
        """Add an innovation, and return the evidence of the most likely change and onset of each draw
        [nats]. Shapes: `value` (3,), `sensitivity` (3, columns, onsets).
        """
        self._add_to_sums(value, sensitivity)
        evidence = self._evidence_of_onsets(self._estimates(self._precision))
        evidence_by_draw = evidence.reshape(-1, *self._onset.shape)
        self.evidence, self._last_evidence = evidence_by_draw.max(axis=0), evidence_by_draw[-1]
        self._first_evidence = evidence_by_draw[0]
        return np.asarray(evidence.max(axis=(-2, -1)))

    def _add_to_sums(self, value: Floats, sensitivity: Floats) -> None:
        """Add the products of an innovation and its sensitivity to S and b."""
        # Subscripts: a is the axis, h the hypothesis (change), o the onset.
        first = sensitivity[:, self._first_column]
        second = sensitivity[:, self._second_column]
        self._s11 += np.einsum("aho,aho->ho", first, first)
        self._b1 += np.einsum("aho,...a->...ho", first, value)
        self._s12 += np.where(self._has_second, np.einsum("aho,aho->ho", first, second), 0.0)
        self._s22 += np.where(self._has_second, np.einsum("aho,aho->ho", second, second), 0.0)
        self._b2 += np.where(self._has_second, np.einsum("aho,...a->...ho", second, value), 0.0)

    def _evidence_of_onsets(self, estimates: _Estimates) -> Floats:
        """Return the evidence [nats] of each change at each onset, (changes, onsets) or with draws in
        front.
        """
        # The import takes a fifth of a second of CPU time; forecasts need this module, and no evidence.
        from scipy.special import log_ndtr

        # Unused onsets and jumps of an encoder below the smallest reported one have the evidence -inf.
        # Log of the Bayes factor with normal priors: 1/2 b' (S + 1/P)^-1 b - 1/2 log det(1 + P S).
        evidence = 0.5 * estimates.quadratic_form - 0.5 * np.log(estimates.determinant)
        # A half-normal prior has twice the density of a normal one, above zero only. The evidence therefore
        # grows by the logarithm of twice the posterior probability of a positive size.
        non_negative = self._non_negative
        z = estimates.size[..., non_negative, :] / estimates.std[non_negative]
        evidence[..., non_negative, :] += np.log(2.0) + log_ndtr(z)
        is_candidate = np.isfinite(self._onset) & (np.abs(estimates.size) >= self._min_size)
        return np.where(is_candidate, evidence, -np.inf)

    def _estimates(self, precision: Floats) -> _Estimates:
        """Solve the normal equations (S + 1/P) v = b of each change at each onset, by Cramer's rule."""
        # The `precision` 1/P has shape (2, changes). Without a second parameter, its sums are zero and its
        # solution is zero.
        precision1, precision2 = precision[0][:, None], precision[1][:, None]
        a11, a12, a22 = self._s11 + precision1, self._s12, self._s22 + precision2
        determinant = a11 * a22 - a12**2
        size = (a22 * self._b1 - a12 * self._b2) / determinant
        second_size = (a11 * self._b2 - a12 * self._b1) / determinant
        return _Estimates(
            size=size,
            std=np.sqrt(a22 / determinant),
            quadratic_form=size * self._b1 + second_size * self._b2,
            determinant=determinant / (precision1 * precision2),
        )

    def standard_error(self, change: str, onset_block: float) -> float | None:
        """Return the standard error of the first parameter of a change, SI; None while the window is
        empty.
        """
        row = [change_.id for change_ in self.changes].index(change)
        distance_blocks = np.abs(self._onset[row] - onset_block)
        nearest = int(np.argmin(distance_blocks))
        if not np.isfinite(distance_blocks[nearest]):
            return None
        return float(self._estimates(self._precision).std[row, nearest])

    def ranking(self, *, from_start: bool = False) -> list[ChangeCandidate]:
        """Return all changes, the most likely first."""
        from scipy.special import logsumexp

        # The evidence of a change is the mean of its likelihood ratios over the onsets, which have the same
        # prior probability. Size and onset are those of the most likely onset. The last draw counts. The
        # priors are those of changes in flight, or of differences with which a flight begins (`from_start`).
        estimates = self._estimates(self._precision_from_start if from_start else self._precision)
        # The shape is (changes, onsets), or has draws in front: the reshape adds them.
        size = estimates.size.reshape(-1, *self._onset.shape)[-1]
        evidence = self._evidence_of_onsets(estimates).reshape(-1, *self._onset.shape)[-1]
        best_places = np.argmax(evidence, axis=1)
        onset_count = max(1, int(np.isfinite(self._onset[0]).sum()))
        log_evidence = logsumexp(evidence, axis=1) - np.log(onset_count)
        candidates = []
        for row, (change, place) in enumerate(zip(self.changes, best_places, strict=True)):
            onset_block = self._onset[row, place]
            candidates.append(
                ChangeCandidate(
                    change,
                    onset_block=int(onset_block) if np.isfinite(onset_block) else 0,
                    size=float(size[row, place]),
                    std=float(estimates.std[row, place]),
                    log_evidence=float(log_evidence[row]),
                )
            )
        return sorted(candidates, key=lambda candidate: -candidate.log_evidence)


class Evidence(Protocol):
    """Collects the evidence of changes during a comparison."""

    ratio: LikelihoodRatio

    def add(self, innovation: Innovation, t_s: float) -> float:
        """Add the innovation of the measurement at `t_s` [s]; return the evidence that counts [nats]."""


class PersistentEvidence:
    """Evidence that persists, and does not come from single outliers."""

    def __init__(self, ratio: LikelihoodRatio) -> None:
        self.ratio = ratio
        self._recent_nats = deque([-math.inf] * PERSISTENCE_BLOCKS, maxlen=PERSISTENCE_BLOCKS)

    def add(self, innovation: Innovation, t_s: float) -> float:
        """Add the innovation of the measurement at `t_s` [s]; return the persistent evidence [nats]."""
        self._recent_nats.append(self.ratio.update_cut(innovation, CUT_OFF_STD))
        return min(self._recent_nats)
