"""Keeps the angles at the recent onsets, since which the error of a wrong encoder scale grows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.watch.twin.likelihood_ratio import LikelihoodRatio


class AngleHistory:
    """Angles at the ends of the latest blocks. Block k is in row k modulo the number of rows."""

    def __init__(self, blocks: int, scales: Sequence[tuple[int, int]]) -> None:
        self._angles_rad: Floats = np.zeros((blocks, 3))
        self._scales = scales

    def remember(self, block: int, angles_rad: Floats) -> None:
        """Keep the angles `angles_rad` [rad], (3,), at the end of a `block`."""
        self._angles_rad[block % len(self._angles_rad)] = angles_rad

    def at_onsets(self, ratio: LikelihoodRatio) -> Floats:
        """Return for each encoder scale the angle of its axis [rad] at each onset, (scales, onsets)."""
        rows = len(self._angles_rad)
        onset_rows = ((ratio.onset_blocks(column) % rows, axis) for column, axis in self._scales)
        return np.array([self._angles_rad[place] for place in onset_rows])
