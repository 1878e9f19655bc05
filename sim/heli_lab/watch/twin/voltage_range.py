"""Decides which moments of a flight the twin judges: not those after voltages of no nominal flight."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.watch.twin.parameter_uncertainty import ParameterUncertainty

UNKNOWN_s: Final = 1.0
"""Time after a voltage that no nominal flight shows for which measurements carry no evidence, s: the filter
has to settle again. Longer: aggressive flights hide changes. Shorter: what an unknown voltage does is taken
for a change."""
EXTRAPOLATED_SHARE: Final = 0.1
"""Distance from the range of the nominal flights up to which measurements still carry evidence, as a share of
the width of that range. The filter adds process noise for such voltages. Larger: what an unknown voltage does
is taken for a change; with 0.25, two of eight healthy measured flights have a false alarm. Smaller: a change
hides itself, because the controller answers it with unusual voltages. With 0, a zero error of pitch of 74
standard errors was missed, because the back rotor got 2.3 V instead of at most 2.2 V (2026-11)."""
_ROTORS: Final = ("front", "back")


class VoltageRange:
    """Compares the voltages of a flight with those of the nominal flights.

    Voltages that are outside of their range by less than `EXTRAPOLATED_SHARE` of its width count as known.
    """

    def __init__(self, uncertainty: ParameterUncertainty, step_s: float) -> None:
        self._uncertainty = uncertainty
        self._unknown_steps = round(UNKNOWN_s / step_s)
        tolerance_V = EXTRAPOLATED_SHARE * (uncertainty.high_V - uncertainty.low_V)
        # A rotor that reverses follows another curve, so no range is extrapolated across 0 V.
        min_V = np.where(uncertainty.low_V < 0.0, -np.inf, 0.0)
        self._extrapolated = replace(
            uncertainty,
            low_V=np.maximum(uncertainty.low_V - tolerance_V, min_V),
            high_V=uncertainty.high_V + tolerance_V,
        )
        self._last_unknown_step: int | None = None

    def update(self, index: int, volts_V: Floats) -> str:
        """Take the acting voltages `volts_V` [V], (2,), of the step `index`.

        Returns the reason why the twin does not judge them if these voltages are the first outside the range;
        otherwise the empty string.
        """
        outside_V = self._extrapolated.outside_V(volts_V)
        if not np.any(outside_V > 0.0):
            return ""
        is_first = self._last_unknown_step is None
        self._last_unknown_step = index + self._unknown_steps
        return self._unknown_voltage_text(volts_V, int(np.argmax(outside_V))) if is_first else ""

    def is_known(self, index: int) -> bool:
        """Whether the measurement at the step `index` carries evidence."""
        return self._last_unknown_step is None or index > self._last_unknown_step

    def _unknown_voltage_text(self, volts_V: Floats, rotor: int) -> str:
        """State the voltage of a `rotor`, and the range of the nominal flights."""
        low_V, high_V = self._uncertainty.low_V[rotor], self._uncertainty.high_V[rotor]
        reverses = volts_V[rotor] < 0.0 <= low_V
        return (
            f"the {_ROTORS[rotor]} rotor gets {volts_V[rotor]:.1f} V{' (it reverses)' if reverses else ''}; "
            f"the twin knows {low_V:.1f} V to {high_V:.1f} V from its nominal flights"
        )
