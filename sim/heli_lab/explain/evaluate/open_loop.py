"""How an additional torque changes the open-loop prediction of a flight, to first order.

A refit of a model with the torque would also estimate other initial states and constant torques. Only the
change that these cannot make is a change of the prediction.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.data.arrays import Floats, Integers

from heli_lab.fit.linearised_flight import LinearisedFlight

_WINDOW_s: Final = 2.0
"""Length of a prediction [s], as in the free runs of an evaluation."""
_RIDGE: Final = 1e-9
"""Share of the largest diagonal element that is added, because an output may not depend on a state."""


def open_loop_squares(linear: LinearisedFlight, rates: Floats) -> tuple[Floats, int]:
    """Sum up the squares of the change of the outputs in all windows of a flight. Shapes: `rates` (n,
    states); returns `squares` (m,).
    """
    length = max(1, round(_WINDOW_s / linear.reference.step_s))
    starts = np.array(
        [start for w in linear.windows for start in range(w.start, w.stop - length + 1, length)], int
    )
    outputs = len(linear.model.outputs)
    if not starts.size:
        return np.zeros(outputs), 0
    rows = starts[:, None] + np.arange(length)
    response = _responses(linear, rows, rates) / linear.reference.record.resolution[:, None]
    # Windows, then all outputs at all steps of a window, then the signals.
    signals = response.reshape(len(starts), length * outputs, -1)
    states = linear.states
    initial, others = signals[:, :, :states], signals[:, :, states:]
    remaining = others - initial @ _solve(initial, others)
    # The constant torques are the same in all windows.
    stacked = remaining.reshape(-1, remaining.shape[2])
    constants, change = stacked[:, :outputs], stacked[:, outputs:]
    change = change - constants @ _solve(constants, change)
    squares = np.sum(change.reshape(-1, outputs) ** 2, axis=0)
    return squares, rows.size


def _responses(linear: LinearisedFlight, rows: Integers, rates: Floats) -> Floats:
    """Simulate the deviation of each window from 0, shape (windows, length, m, states + m + 1).

    The signals are: unit initial states, unit constant torques, and the additional rates.
    """
    steps, (windows, length), states = linear.steps, rows.shape, linear.states
    outputs = len(linear.model.outputs)
    deviation = np.zeros((windows, states, states + outputs + 1))
    deviation[:, :, :states] = np.eye(states)
    response = np.empty((windows, length, outputs, deviation.shape[2]))
    for number in range(length):
        at = rows[:, number]
        response[:, number] = steps.C[at] @ deviation
        deviation = steps.Phi[at] @ deviation
        deviation[:, :, states:-1] += steps.Gamma[at] @ steps.by_disturbance[at][:, :, :outputs]
        deviation[:, :, -1:] += steps.Gamma[at] @ rates[at][:, :, None]
    return response


def _solve(design: Floats, target: Floats) -> Floats:
    """Return the least-squares coefficients of the columns of `design` for those of `target`; both may have
    a leading dimension.
    """
    transposed = np.swapaxes(design, -1, -2)
    normal = transposed @ design
    size = normal.shape[-1]
    diagonal = np.einsum("...ii->...i", normal).max(axis=-1)[..., None, None]
    return np.asarray(
        np.linalg.solve(normal + _RIDGE * (diagonal + 1e-300) * np.eye(size), transposed @ target)
    )
