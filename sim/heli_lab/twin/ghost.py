"""Where the twin would be had it flown by itself for the last seconds: what a page draws beside the rig."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_lab.estimation import _kalman
from heli_lab.twin.kalman_filter import ZEROS, TwinModel

ALONE_s: Final = 2.0
"""How long it flies by itself, s. A rotor that lost 5 % of its thrust moves the ghost by 5 degrees of pitch
in that time, weather by one. Longer: the weather alone moves it away. Shorter: it sticks to the rig."""
_RUNS: Final = 10


class Ghost:
    """Free runs that begin one after the other where the filter is; the oldest is shown.

    Parameters
    ----------
    twin : TwinModel
        Equations.
    step_s : float
        Length of a step.
    """

    def __init__(self, twin: TwinModel, step_s: float) -> None:
        self._twin, self._step_s = twin, step_s
        self._every = max(1, round(ALONE_s / _RUNS / step_s))
        self._runs: Floats = np.empty((0, twin.states))
        self._torque_Nm: Floats = np.empty((0, 3))
        self._zero_rad: Floats = np.empty((0, len(ZEROS)))
        self._steps = 0

    def begin(self) -> None:
        """Begin anew: the flight was not free."""
        self._runs, self._steps = self._runs[:0], 0
        self._torque_Nm, self._zero_rad = self._torque_Nm[:0], self._zero_rad[:0]

    def step(self, t_s: float, volts_V: Floats, state: Floats, torque_Nm: Floats, zero_rad: Floats) -> None:
        """Go on by a step that begins at `t_s`, with the voltages `volts_V`, (2,), that acted; the filter is
        at `state` then, with a steady `torque_Nm` about each axis, (3,), and encoder zeros `zero_rad`, (2,).
        """
        if self._steps % self._every == 0:
            kept = slice(max(0, len(self._runs) + 1 - _RUNS), None)
            self._runs = np.vstack((self._runs[kept], state))
            self._torque_Nm = np.vstack((self._torque_Nm[kept], torque_Nm))
            self._zero_rad = np.vstack((self._zero_rad[kept], zero_rad))
        self._steps += 1
        twin, h = self._twin, self._step_s
        rates, a, by_torque, _, _, _ = twin.plain.along(twin.at(t_s + 0.5 * h, self._runs, volts_V, h))
        _, gamma = _kalman.midpoint(a, h)
        push = rates[:, :, 0] + np.einsum("kij,kj->ki", by_torque, self._torque_Nm)
        self._runs = self._runs + np.einsum("kij,kj->ki", gamma, push)

    @property
    def angles_rad(self) -> Floats | None:
        """Angles that the encoders would show of it, (3,); None before a run is old enough to be shown."""
        if len(self._runs) < _RUNS:
            return None
        shown = self._runs[0, :3].copy()
        shown[: len(ZEROS)] += self._zero_rad[0]
        return np.asarray(shown + np.deg2rad([*(self._twin.rig[name].value for name in ZEROS), 0.0]))
