"""Inputs of the model at each step: the voltages that act, and the time since the motors started."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.watch.twin.samples import Step
from heli_lab.watch.twin.twin_model import TwinModel

_HISTORY_s: Final = 2.0
"""Length of the flight before the filter begins from which the states of effects are integrated, s: far
longer than the lag of any rotor."""


class Motion(NamedTuple):
    """Measured motion and acting voltages over some steps."""

    times_s: Floats  # (n,): Times since the motors started [s]
    angles_rad: Floats  # (n, 3): Measured angles [rad]
    volts_V: Floats  # (n, 2): Acting voltages [V]


@dataclass(frozen=True)
class BlockEnd:
    """The end of a block of steps, at which the filter uses a measurement."""

    step: Step  # The step that begins there, with the measured angles
    motor_time_s: float  # Time since the motors started [s]
    acting_V: Floats  # (2,): Voltages that act there [V]


class InputHistory:
    """Inputs of the latest steps, with the delay between a voltage and its action. `acting_V` has shape
    (2,).
    """

    def __init__(self, model: TwinModel, step_s: float) -> None:
        self.motor_time_s = 0.0
        self.acting_V: Floats = np.zeros(2)
        self._min_thrust_V = model.min_thrust_V
        self._delayed_volts_V: deque[Floats] = deque(maxlen=round(model.delay_s / step_s) + 1)
        self._motor_start_s = math.nan
        self._motion: deque[tuple[float, Floats, Floats]] = deque(maxlen=round(_HISTORY_s / step_s))

    def update(self, step: Step, t_s: float) -> None:
        """Compute the inputs of a `step` at time `t_s` [s]."""
        mean_volts_V = np.maximum(step.volts_V, self._min_thrust_V).mean(axis=0)
        self._delayed_volts_V.append(mean_volts_V)
        # The queue is as long as the delay: its oldest voltage acts now.
        self.acting_V = self._delayed_volts_V[0]
        if not step.flying:
            self._motor_start_s = math.nan
        elif math.isnan(self._motor_start_s) and np.any(step.volts_V):
            self._motor_start_s = t_s
        self.motor_time_s = 0.0 if math.isnan(self._motor_start_s) else t_s - self._motor_start_s

    def remember(self, measured_rad: Floats) -> None:
        """Keep the present inputs with angles that were measured at the same step. Shapes: `measured_rad`
        (3,).
        """
        self._motion.append((self.motor_time_s, measured_rad, self.acting_V))

    def forget_motion(self) -> None:
        """Discard the kept inputs."""
        self._motion.clear()

    def restart(self) -> None:
        """Discard everything, because samples are missing."""
        self._motion.clear()
        self._delayed_volts_V.clear()
        self._motor_start_s = math.nan

    def initial_motion(self) -> Motion:
        """Return the motion before the present step, from which the filter starts."""
        times_s, angles_rad, volts_V = (np.array(values) for values in zip(*self._motion, strict=True))
        return Motion(times_s, angles_rad, volts_V)
