"""The ghost, a second helicopter on the dashboard: an open-loop simulation of the last seconds."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.fit import _kalman
from heli_lab.watch.twin.twin_model import ZEROS, TwinModel

FREE_RUN_s: Final = 2.0
"""Length of the open-loop simulation, s. A rotor that lost 5 % of its thrust moves the ghost by 5 degrees of
pitch in that time, disturbances by 1 degree. Longer: disturbances alone move it away. Shorter: it shows no
difference."""
_RUNS: Final = 10
"""Number of simulations at the same time. More: the ghost moves more smoothly, and takes more time."""


class Ghost:
    """Overlapping open-loop simulations, called runs.

    A run starts from the filter's state every 0.2 s. The oldest run, of `FREE_RUN_s`, is shown.
    """

    def __init__(self, twin: TwinModel, step_s: float) -> None:
        self._twin, self._step_s = twin, step_s
        self._steps_between_runs = max(1, round(FREE_RUN_s / _RUNS / step_s))
        # State of each run, oldest first, with the torques and zeros that the filter had at its start.
        self._runs: Floats = np.empty((0, twin.states))
        self._torque_Nm: Floats = np.empty((0, 3))
        self._zero_rad: Floats = np.empty((0, len(ZEROS)))
        self._steps = 0

    def begin(self) -> None:
        """Discard all runs, because the flight was interrupted."""
        self._runs, self._steps = self._runs[:0], 0
        self._torque_Nm, self._zero_rad = self._torque_Nm[:0], self._zero_rad[:0]

    def step(self, t_s: float, volts_V: Floats, state: Floats, torque_Nm: Floats, zero_rad: Floats) -> None:
        """Start a run if one is due, and advance all runs by a step. Shapes: `volts_V` (2,), `state`
        (states,), `torque_Nm, zero_rad` (3,).
        """
        if self._steps % self._steps_between_runs == 0:
            newest = slice(max(0, len(self._runs) + 1 - _RUNS), None)
            self._runs = np.vstack((self._runs[newest], state))
            self._torque_Nm = np.vstack((self._torque_Nm[newest], torque_Nm))
            self._zero_rad = np.vstack((self._zero_rad[newest], zero_rad))
        self._steps += 1
        twin, h = self._twin, self._step_s
        rates, jacobian, by_torque, _, _, _ = twin.functions_without_derivatives.along(
            twin.at(t_s + 0.5 * h, self._runs, volts_V, h)
        )
        _, gamma = _kalman.midpoint(jacobian, h)
        # k numbers the runs, i and j the rows and columns of their matrices.
        rates_with_torque = rates[:, :, 0] + np.einsum("kij,kj->ki", by_torque, self._torque_Nm)
        self._runs = self._runs + np.einsum("kij,kj->ki", gamma, rates_with_torque)

    @property
    def angles_rad(self) -> Floats | None:
        """Angles that the encoders would show for the oldest run [rad], (3,); None before `FREE_RUN_s`."""
        if len(self._runs) < _RUNS:
            return None
        angles_rad = self._runs[0, :3].copy()
        angles_rad[: len(ZEROS)] += self._zero_rad[0]
        return np.asarray(angles_rad + np.deg2rad([*(self._twin.rig[name].value for name in ZEROS), 0.0]))
