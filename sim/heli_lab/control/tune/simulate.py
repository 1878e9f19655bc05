"""Simulate many linear plants along the same path together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.state_space import matrix_exponentials

SIMULATION_STEP_s: Final = 0.04
"""Time between two points of a path; inputs are constant in between."""
_BLOCK: Final = 16
"""Points per block. All blocks are simulated together, from rest; then the final state of each block is
carried over to the next. 250 points take 32 steps in Python instead of 250."""


@dataclass(frozen=True)
class DiscretePlants:
    """Linear plants in discrete time, with inputs constant over a step of `SIMULATION_STEP_s`."""

    transition: Floats  # (plants, n, n): State transition matrices over one step
    inputs: Floats  # (plants, n, m): Input matrices over one step

    def simulate(self, inputs: Floats) -> Floats:
        """Simulate all plants from rest, and return the states, shape (times, plants, n). Shapes: `inputs`
        (times, m).
        """
        count, size = self.transition.shape[:2]
        blocks = -(-len(inputs) // _BLOCK)
        padded = np.zeros((blocks * _BLOCK, inputs.shape[1]))
        padded[: len(inputs)] = inputs
        # Indices: plant p, state n, input m, block b, point k of a block.
        forced = np.einsum("pnm,bkm->kpnb", self.inputs, padded.reshape(blocks, _BLOCK, -1))
        # First from rest: states of each block, and powers of the transition matrix.
        states = np.zeros((_BLOCK + 1, count, size, blocks))
        powers = np.empty((_BLOCK + 1, count, size, size))
        powers[0] = np.eye(size)
        for index in range(_BLOCK):
            states[index + 1] = self.transition @ states[index] + forced[index]
            powers[index + 1] = self.transition @ powers[index]
        # Then the state at the beginning of each block, from block to block.
        initial = np.empty((count, size, blocks))
        state = np.zeros((count, size, 1))
        for block in range(blocks):
            initial[:, :, block] = state[:, :, 0]
            state = powers[_BLOCK] @ state + states[_BLOCK, :, :, block, None]
        states = states[:_BLOCK] + powers[:_BLOCK] @ initial
        return states.transpose(3, 0, 1, 2).reshape(-1, count, size)[: len(inputs)]

    def step_response(self, times: int) -> Floats:
        """Return the zero-state response to a unit step of each input, shape (plants, n, m, times)."""
        count, size, width = self.inputs.shape
        # Doubling: the response after 2 m steps is that after m steps, propagated by m steps, plus itself.
        response, power = self.inputs[..., None], self.transition
        while response.shape[3] < times:
            later = power @ response.reshape(count, size, width * response.shape[3])
            later = later.reshape(response.shape) + response[..., -1:]
            response, power = np.concatenate((response, later), axis=3), power @ power
        initial = np.zeros((count, size, width, 1))
        return np.concatenate((initial, response), axis=3)[..., :times]


def discretise(closed: Floats, input_matrices: Floats) -> DiscretePlants:
    """Discretise plants exactly for inputs that are constant over a step. Shapes: `closed` (plants, n, n),
    `input_matrices` (plants, n, m).
    """
    count, size, width = input_matrices.shape
    augmented = np.zeros((count, size + width, size + width))
    augmented[:, :size, :size], augmented[:, :size, size:] = closed, input_matrices
    step = matrix_exponentials(augmented * SIMULATION_STEP_s)
    return DiscretePlants(step[:, :size, :size], step[:, :size, size:])
