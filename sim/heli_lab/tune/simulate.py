"""Simulates many linear plants along a path at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats

STEP_s: Final = 0.04
"""Between two points of a path; inputs are held as long."""
_BLOCK: Final = 16
"""Points of a block: all blocks are simulated from rest at once, then one after the other from the end of the
one before. With 250 points that is 32 steps in Python instead of 250."""


@dataclass(frozen=True)
class Sampled:
    """Plants between two points of a path, discretised exactly with inputs held.

    Parameters
    ----------
    transition : ndarray (plants, n, n)
        State transition matrices over `STEP_s`.
    inputs : ndarray (plants, n, m)
        Input matrices.
    """

    transition: Floats
    inputs: Floats

    def along(self, inputs: Floats) -> Floats:
        """States along a path from rest, shape (times, plants, n).

        Parameters
        ----------
        inputs : ndarray (times, m)
            The same for all plants, `STEP_s` apart.
        """
        count, size = self.transition.shape[:2]
        blocks = -(-len(inputs) // _BLOCK)
        padded = np.zeros((blocks * _BLOCK, inputs.shape[1]))
        padded[: len(inputs)] = inputs
        # Of each point of all blocks, (plants, n, blocks): what its inputs so far make of rest.
        forced = np.einsum("pnm,bkm->kpnb", self.inputs, padded.reshape(blocks, _BLOCK, -1))
        states = np.zeros((_BLOCK + 1, count, size, blocks))
        powers = np.empty((_BLOCK + 1, count, size, size))
        powers[0] = np.eye(size)
        for index in range(_BLOCK):
            states[index + 1] = self.transition @ states[index] + forced[index]
            powers[index + 1] = self.transition @ powers[index]
        begin = np.empty((count, size, blocks))
        state = np.zeros((count, size, 1))
        for block in range(blocks):
            begin[:, :, block] = state[:, :, 0]
            state = powers[_BLOCK] @ state + states[_BLOCK, :, :, block, None]
        states = states[:_BLOCK] + powers[:_BLOCK] @ begin
        return states.transpose(3, 0, 1, 2).reshape(-1, count, size)[: len(inputs)]

    def step_response(self, times: int) -> Floats:
        """Zero-state response to a step of each input, shape (plants, n, m, times).

        Parameters
        ----------
        times : int
            Number of points, `STEP_s` apart; at the first the step has only begun, and all states are 0.
        """
        count, size, width = self.inputs.shape
        # What m steps have made, and m steps later: as much again, and what became of it meanwhile.
        response, power = self.inputs[..., None], self.transition
        while response.shape[3] < times:
            later = power @ response.reshape(count, size, width * response.shape[3])
            later = later.reshape(response.shape) + response[..., -1:]
            response, power = np.concatenate((response, later), axis=3), power @ power
        at_once = np.zeros((count, size, width, 1))
        return np.concatenate((at_once, response), axis=3)[..., :times]


def sampled(closed: Floats, given: Floats) -> Sampled:
    """Discretise plants.

    Parameters
    ----------
    closed : ndarray (plants, n, n)
        State matrices.
    given : ndarray (plants, n, m)
        Input matrices.
    """
    count, size, width = given.shape
    both = np.zeros((count, size + width, size + width))
    both[:, :size, :size], both[:, :size, size:] = closed, given
    step = _exponential(both * STEP_s)
    return Sampled(step[:, :size, :size], step[:, :size, size:])


def _exponential(matrices: Floats) -> Floats:
    """Exponentials of small matrices, (n, m, m), by scaling and squaring of a Taylor series.

    scipy's hands every matrix to a threaded solver: 3 ms instead of 0.1 for fifteen, on a busy machine.
    """
    halvings = max(0, int(np.ceil(np.log2(np.abs(matrices).sum(axis=2).max() / 0.25))))
    small = matrices / 2.0**halvings
    result = unit = np.broadcast_to(np.eye(matrices.shape[1]), matrices.shape)
    for order in range(9, 0, -1):
        result = unit + small @ result / order
    for _ in range(halvings):
        result = result @ result
    return np.asarray(result)
