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
MIN_PULSES: Final = 3
"""Pulses that moved, of which a straight line has a standard error."""
MAX_SHARE: Final = 0.2
"""Standard error of a thrust gain, as share of it, above which the rig file's value stays."""
_LOWER_BOUNDS: Final = (0.0, 0.0, 1e-3)
_UPPER_BOUNDS: Final = (100.0, 20.0, 0.5)
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
    """Return the design matrix of pitch around a pulse, shape (times, 4).

    Its columns are the responses to a unit acceleration during the pulse, to an offset, to an initial angle
    and to an initial rate. Pitch obeys phi'' = -`stiffness` phi - `damping` phi' + a, in 1/s2 and 1/s; the
    acceleration a follows the voltage with the lag `lag_s`.
    """
    lag_s = max(lag_s, 1e-3)
    state_matrix = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-stiffness, -damping, 1.0, 0.0],
            [0.0, 0.0, -1.0 / lag_s, 1.0 / lag_s],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    before, during, after = (round(duration_s / PULSE_GRID_s) for duration_s in (BEFORE_s, PULSE_s, AFTER_s))
    count = before + during + after
    powers = _matrix_powers(matrix_exponentials(state_matrix[np.newaxis] * PULSE_GRID_s)[0], count)
    # States are angle, rate, acceleration by thrust, and the voltage, which only the pulse sets.
    state_after_pulse = powers[during] @ (0.0, 0.0, 0.0, 1.0)
    state_after_pulse[3] = 0.0
    design = np.zeros((count, 4))
    design[before : before + during, 0] = powers[:during, 0, 3]
    design[before + during :, 0] = powers[:after, 0] @ state_after_pulse
    design[:, 1] = 1.0
    design[:, 2:] = powers[:, 0, :2]
    return design


@dataclass(frozen=True)
class _PitchDynamics:
    """Dynamics of pitch, common to all pulses: stiffness [1/s2], damping [1/s] and lag of the thrust [s]."""

    stiffness: float
    damping: float
    lag_s: float

    def accelerations(self, measured: Floats) -> Floats:
        """Return the pitch acceleration that each pulse caused [rad/s2], shape (n,).

        `measured` is pitch around each pulse [rad], shape (times, n).
        """
        design = response_design(self.stiffness, self.damping, self.lag_s)
        return np.asarray(_least_squares(design, measured)[0])


def _pitch_dynamics_of_rig(rig: Rig) -> _PitchDynamics:
    """Return the pitch dynamics by the rig file's masses and friction, with a lag of 0.02 s."""
    inertia_kg_m2 = _pitch_inertia(rig)
    tilting_kg = rig["M_f"].value + rig["M_b"].value + rig["M_h"].value
    stiffness = tilting_kg * rig["g"].value * rig["L_phi"].value / inertia_kg_m2
    return _PitchDynamics(max(stiffness, 0.1), max(rig["friction_pitch"].value / inertia_kg_m2, 0.05), 0.02)


def _fit_pitch_dynamics(measured: Floats, start: _PitchDynamics) -> _PitchDynamics:
    """Fit the dynamics to pitch around all pulses, shape (times, n), by separable least squares.

    The linear coefficients of each pulse are eliminated inside the residual.
    """

    def residual(parameters: Floats) -> Floats:
        design = response_design(*parameters)
        return np.asarray((measured - design @ _least_squares(design, measured)).ravel())

    first = np.clip([start.stiffness, start.damping, start.lag_s], _LOWER_BOUNDS, _UPPER_BOUNDS)
    fit = scipy.optimize.least_squares(
        residual, first, bounds=(_LOWER_BOUNDS, _UPPER_BOUNDS), x_scale=[1.0, 1.0, 0.05], xtol=1e-4
    )
    return _PitchDynamics(*map(float, fit.x))


def response_counts(pulse: Pulse, count_rad: float) -> tuple[float, float]:
    """Return the response of pitch to a `pulse`, in counts of `count_rad`.

    Returns
    -------
    float
        Largest change of pitch after the pulse began, with its sign.
    float
        Standard deviation of the readings before the pulse.
    """
    before, during = round(BEFORE_s / PULSE_GRID_s), round(PULSE_s / PULSE_GRID_s)
    start_rad, std_rad = pulse.pitch_rad[:before].mean(), pulse.pitch_rad[:before].std()
    change_rad = pulse.pitch_rad[before : before + 2 * during] - start_rad
    return float(change_rad[np.argmax(np.abs(change_rad))] / count_rad), float(std_rad / count_rad)


def thrust_of(pulses: Sequence[Pulse], sign: int, rig: Rig) -> ThrustLine | str:
    """Estimate thrust gain and dead zone of a rotor from the pulses that moved pitch.

    Standard errors are those of the jackknife: the estimate is repeated without each pulse.

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
    if len(pulses) < MIN_PULSES:
        return f"{len(pulses)} pulses moved pitch, and a line needs {MIN_PULSES}"
    volts_V = np.array([pulse.volts_V for pulse in pulses])
    newton_per_acceleration = sign * _pitch_inertia(rig) / rig["L_h"].value
    measured = np.column_stack([pulse.pitch_rad for pulse in pulses])
    dynamics = _fit_pitch_dynamics(measured, _pitch_dynamics_of_rig(rig))
    gain_N_per_V, dead_zone_V = _gain_and_zero(
        volts_V, newton_per_acceleration * dynamics.accelerations(measured)
    )
    estimates = []
    for index in range(len(pulses)):
        other_pulses = np.delete(measured, index, axis=1)
        refit = _fit_pitch_dynamics(other_pulses, dynamics)
        thrust_N = newton_per_acceleration * refit.accelerations(other_pulses)
        estimates.append(_gain_and_zero(np.delete(volts_V, index), thrust_N))
    deviations = np.array(estimates) - np.mean(estimates, axis=0)
    factor = (len(estimates) - 1) / len(estimates)
    gain_std, dead_zone_std = np.sqrt(factor * np.sum(deviations**2, axis=0))
    if not gain_N_per_V > 0.0:
        return f"thrust does not grow with the voltage ({gain_N_per_V:.3g} N/V)"
    if gain_std > MAX_SHARE * gain_N_per_V:
        return f"the pulses scatter: {gain_N_per_V:.3g} N/V with a standard error of {gain_std:.2g} N/V"
    return ThrustLine(gain_N_per_V, float(gain_std), dead_zone_V, float(dead_zone_std), len(pulses))


def geometry_share(rig: Rig) -> float:
    """Return the relative uncertainty of the gain that the tolerances of masses and lengths cause."""
    nominal_ratio = _pitch_inertia(rig) / rig["L_h"].value
    relative_changes = []
    for name in _GAIN_MASSES:
        changed_rig = rig.replace(**{name: rig[name].value + rig[name].tolerance})
        relative_changes.append(_pitch_inertia(changed_rig) / changed_rig["L_h"].value / nominal_ratio - 1.0)
    return float(np.sqrt(np.sum(np.square(relative_changes))))


def _gain_and_zero(volts: Floats, thrust_N: Floats) -> tuple[float, float]:
    """Fit a straight line; return its slope [N/V] and the voltage at which it is zero [V]."""
    slope, constant = np.polyfit(volts, thrust_N, 1)
    return float(slope), float(-constant / slope) if slope else 0.0


def _pitch_inertia(rig: Rig) -> float:
    return inertias_kg_m2({name: number.value for name, number in rig.items()})["J_phi"]


def _least_squares(design: Floats, measured: Floats) -> Floats:
    return np.asarray(np.linalg.lstsq(design, measured, rcond=1e-10)[0])


def _matrix_powers(matrix: Floats, count: int) -> Floats:
    """Powers 0 to count - 1 of a matrix, shape (count, n, n)."""
    powers = np.eye(len(matrix))[np.newaxis]
    while len(powers) < count:
        powers = np.concatenate((powers, powers @ matrix))
        matrix = matrix @ matrix
    return powers[:count]
