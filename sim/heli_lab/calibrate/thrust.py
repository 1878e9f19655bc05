"""Thrust and dead zone of a rotor, from the pitch angle after short pulses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.optimize
from heli_host.arrays import Floats
from heli_sim.rig import Rig
from heli_sim.rig.inertia import inertias_kg_m2

from heli_lab.matrix_exponential import matrix_exponentials

PULSE_GRID_s: Final = 0.005
"""Step of the times at which the response is compared."""
BEFORE_s: Final = 0.3
PULSE_s: Final = 0.3
"""Length of a pulse. Longer: a strong rotor turns pitch too far. Shorter: a slow rotor gives no thrust."""
AFTER_s: Final = 1.2
"""Time after the pulse that is compared; it holds the impulse of a slow rotor too."""
LEAST_PULSES: Final = 3
"""Pulses that moved, of which a straight line has a standard error."""
MAX_SHARE: Final = 0.2
"""Standard error of a thrust gain, as share of it, above which the rig file's value stays."""
_LOW: Final = (0.0, 0.0, 1e-3)
_HIGH: Final = (100.0, 20.0, 0.5)
"""Bounds of stiffness, damping and lag: of any rig that a hand can carry, with rotors of up to 0.5 s."""
_GAIN_MASSES: Final = ("M_f", "M_b", "M_h", "L_h", "L_phi")


@dataclass(frozen=True)
class Pulse:
    """Pitch around one pulse.

    Parameters
    ----------
    volts_V : float
        Voltage of the output during the pulse.
    pitch_rad : Floats
        Pitch from BEFORE_s before the pulse to AFTER_s after it, in steps of PULSE_GRID_s.
    """

    volts_V: float
    pitch_rad: Floats


@dataclass(frozen=True)
class ThrustLine:
    """Straight line of thrust over voltage: gain (V - dead zone).

    Parameters
    ----------
    gain_N_per_V, gain_std : float
        Slope, and its standard error by the jackknife over the pulses.
    dead_zone_V, dead_zone_std : float
        Voltage at which the line is zero, and its standard error.
    pulses : int
        Pulses that the line is fitted to.
    """

    gain_N_per_V: float
    gain_std: float
    dead_zone_V: float
    dead_zone_std: float
    pulses: int


def response_design(stiffness: float, damping: float, lag_s: float) -> Floats:
    """Return pitch for unit acceleration during the pulse, for an offset, a first angle and a first rate,
    shape (times, 4), by `stiffness` [1/s2], `damping` [1/s] and `lag_s` of the thrust.
    """
    lag_s = max(lag_s, 1e-3)
    rates = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-stiffness, -damping, 1.0, 0.0],
            [0.0, 0.0, -1.0 / lag_s, 1.0 / lag_s],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    before, during, after = (round(span / PULSE_GRID_s) for span in (BEFORE_s, PULSE_s, AFTER_s))
    count = before + during + after
    powers = _powers(matrix_exponentials(rates[np.newaxis] * PULSE_GRID_s)[0], count)
    # States are angle, rate, acceleration by thrust, and the voltage, which only the pulse sets.
    end = powers[during] @ (0.0, 0.0, 0.0, 1.0)
    end[3] = 0.0
    rows = np.zeros((count, 4))
    rows[before : before + during, 0] = powers[:during, 0, 3]
    rows[before + during :, 0] = powers[:after, 0] @ end
    rows[:, 1] = 1.0
    rows[:, 2:] = powers[:, 0, :2]
    return rows


@dataclass(frozen=True)
class _Swing:
    """Response of pitch, common to all pulses: stiffness [1/s2], damping [1/s] and lag of the thrust [s]."""

    stiffness: float
    damping: float
    lag_s: float

    def accelerations(self, measured: Floats) -> Floats:
        """Pitch acceleration that each pulse caused [rad/s2], shape (n,)."""
        design = response_design(self.stiffness, self.damping, self.lag_s)
        pulse_part: Floats = _solve(design, measured)[0]
        return pulse_part


def _stated_swing(rig: Rig) -> _Swing:
    inertia = _pitch_inertia(rig)
    short_kg = rig["M_f"].value + rig["M_b"].value + rig["M_h"].value
    stiffness = short_kg * rig["g"].value * rig["L_phi"].value / inertia
    return _Swing(max(stiffness, 0.1), max(rig["friction_pitch"].value / inertia, 0.05), 0.02)


def _fitted_swing(measured: Floats, start: _Swing) -> _Swing:
    """Fit the common response to pitch around all pulses, shape (times, n)."""

    def residual(unknown: Floats) -> Floats:
        design = response_design(*unknown)
        return np.asarray((measured - design @ _solve(design, measured)).ravel())

    first = np.clip([start.stiffness, start.damping, start.lag_s], _LOW, _HIGH)
    fit = scipy.optimize.least_squares(
        residual, first, bounds=(_LOW, _HIGH), x_scale=[1.0, 1.0, 0.05], xtol=1e-4
    )
    return _Swing(*map(float, fit.x))


def response_counts(pulse: Pulse, count_rad: float) -> tuple[float, float]:
    """Return how far the pulse turned pitch, signed, and the scatter of the readings before it [counts]."""
    before, during = round(BEFORE_s / PULSE_GRID_s), round(PULSE_s / PULSE_GRID_s)
    base, scatter = pulse.pitch_rad[:before].mean(), pulse.pitch_rad[:before].std()
    change = pulse.pitch_rad[before : before + 2 * during] - base
    return float(change[np.argmax(np.abs(change))] / count_rad), float(scatter / count_rad)


def thrust_of(pulses: Sequence[Pulse], sign: int, rig: Rig) -> ThrustLine | str:
    """Infer thrust gain and dead zone of a rotor from the pulses that moved pitch.

    Parameters
    ----------
    pulses : sequence of Pulse
        Pulses with positive thrust.
    sign : int
        Sign of the pitch that this rotor's thrust causes: 1 for the front rotor.
    rig : Rig
        Rig whose inertia and lever turn an acceleration into thrust.

    Returns
    -------
    ThrustLine or str
        The line, or the reason why there is none.
    """
    if len(pulses) < LEAST_PULSES:
        return f"{len(pulses)} pulses moved pitch, and a line needs {LEAST_PULSES}"
    volts = np.array([pulse.volts_V for pulse in pulses])
    newton_per_acceleration = sign * _pitch_inertia(rig) / rig["L_h"].value
    measured = np.column_stack([pulse.pitch_rad for pulse in pulses])
    swing = _fitted_swing(measured, _stated_swing(rig))
    lines = [_line(volts, newton_per_acceleration * swing.accelerations(measured))]
    for index in range(len(pulses)):
        others_rad = np.delete(measured, index, axis=1)
        other = _fitted_swing(others_rad, swing)
        lines.append(
            _line(np.delete(volts, index), newton_per_acceleration * other.accelerations(others_rad))
        )
    (gain, zero), *others = lines
    spread = np.array(others) - np.mean(others, axis=0)
    gain_std, zero_std = np.sqrt((len(others) - 1) / len(others) * np.sum(spread**2, axis=0))
    if not gain > 0.0:
        return f"thrust does not grow with the voltage ({gain:.3g} N/V)"
    if gain_std > MAX_SHARE * gain:
        return f"the pulses scatter: {gain:.3g} N/V with a standard error of {gain_std:.2g} N/V"
    return ThrustLine(gain, float(gain_std), zero, float(zero_std), len(pulses))


def geometry_share(rig: Rig) -> float:
    """Return the half width, as share of the gain, that the tolerances of masses and lengths add."""
    reference = _pitch_inertia(rig) / rig["L_h"].value
    shares = []
    for name in _GAIN_MASSES:
        other = rig.replace(**{name: rig[name].value + rig[name].tolerance})
        shares.append(_pitch_inertia(other) / other["L_h"].value / reference - 1.0)
    return float(np.sqrt(np.sum(np.square(shares))))


def _line(volts: Floats, thrust_N: Floats) -> tuple[float, float]:
    slope, constant = np.polyfit(volts, thrust_N, 1)
    return float(slope), float(-constant / slope) if slope else 0.0


def _pitch_inertia(rig: Rig) -> float:
    return inertias_kg_m2({name: number.value for name, number in rig.items()})["J_phi"]


def _solve(design: Floats, measured: Floats) -> Floats:
    return np.asarray(np.linalg.lstsq(design, measured, rcond=1e-10)[0])


def _powers(matrix: Floats, count: int) -> Floats:
    """Powers 0 to count - 1 of a matrix, shape (count, n, n)."""
    powers = np.eye(len(matrix))[np.newaxis]
    while len(powers) < count:
        powers = np.concatenate((powers, powers @ matrix))
        matrix = matrix @ matrix
    return powers[:count]
