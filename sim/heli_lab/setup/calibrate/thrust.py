"""Estimate the thrust and the dead zone of a rotor from the pitch angle after short voltage pulses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import scipy.optimize
from heli_host.data.arrays import Floats
from heli_sim.rig import Rig
from heli_sim.rig.inertia import inertias_kg_m2

from heli_lab.state_space import matrix_exponentials

PULSE_GRID_s: Final = 0.005
"""Time step at which measured and modelled pitch are compared [s]."""
BEFORE_s: Final = 0.3
"""Time before a pulse that is compared [s]."""
PULSE_s: Final = 0.3
"""Length of a pulse [s]. Longer: a strong rotor turns pitch too far. Shorter: a slow rotor gives no
thrust."""
AFTER_s: Final = 1.2
"""Time after a pulse that is compared [s]; long enough for the thrust of a slow rotor to act."""
MIN_PULSES: Final = 3
"""Smallest number of pulses that move pitch: a straight line through fewer has no standard error."""
MAX_SHARE: Final = 0.2
"""Largest standard error of a thrust gain, as a share of the gain. Above it, the rig file's value stays."""
_LOWER_BOUNDS: Final = (0.0, 0.0, 1e-3)
_UPPER_BOUNDS: Final = (100.0, 20.0, 0.5)
"""Bounds of stiffness, damping and lag: of any rig that a hand can carry, with rotors of up to 0.5 s."""
_GEOMETRY: Final = ("M_f", "M_b", "M_h", "L_h", "L_phi")
"""Rig parameters with which an acceleration of pitch is converted to thrust."""


@dataclass(frozen=True)
class Pulse:
    """Pitch around one pulse."""

    volts_V: float  # Voltage of the output during the pulse
    pitch_rad: Floats  # Pitch from BEFORE_s before the pulse to AFTER_s after it, in steps of PULSE_GRID_s


@dataclass(frozen=True)
class ThrustLine:
    """Straight line of thrust over voltage: gain (V - dead zone)."""

    gain_N_per_V: float
    """gain_N_per_V, gain_std: Slope, and its standard error by the jackknife over the pulses."""
    gain_std: float
    dead_zone_V: float
    """dead_zone_V, dead_zone_std: Voltage at which the line is zero, and its standard error."""
    dead_zone_std: float
    pulses: int  # Pulses that the line is fitted to


def response_design(stiffness: float, damping: float, lag_s: float) -> Floats:
    """Compute the design matrix of pitch around a pulse, of which measured pitch is a linear combination.
    Returns shape (times, 4).

    Pitch obeys phi'' = -stiffness phi - damping phi' + a, where the acceleration a by the thrust follows the
    voltage with a first-order lag.
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
    """Dynamics of pitch that all pulses share: stiffness [1/s^2], damping [1/s] and lag of the thrust [s]."""

    stiffness: float
    damping: float
    lag_s: float

    def accelerations(self, measured: Floats) -> Floats:
        """Estimate the pitch acceleration that each pulse caused [rad/s^2], shape (n,). Shapes: `measured`
        (times, n).
        """
        design = response_design(self.stiffness, self.damping, self.lag_s)
        return np.asarray(_least_squares(design, measured)[0])


def _pitch_dynamics_of_rig(rig: Rig) -> _PitchDynamics:
    """Compute the pitch dynamics from the rig file's masses and friction, with a lag of 0.02 s, as the start
    of a fit.
    """
    inertia_kg_m2 = _pitch_inertia(rig)
    tilting_kg = rig["M_f"].value + rig["M_b"].value + rig["M_h"].value
    stiffness = tilting_kg * rig["g"].value * rig["L_phi"].value / inertia_kg_m2
    return _PitchDynamics(max(stiffness, 0.1), max(rig["friction_pitch"].value / inertia_kg_m2, 0.05), 0.02)


def _fit_pitch_dynamics(measured: Floats, start: _PitchDynamics) -> _PitchDynamics:
    """Fit the dynamics to pitch around all pulses, shape (times, n), by separable least squares.

    The residual eliminates the four linear coefficients of each pulse, see `response_design`, so that the
    search has three unknowns only.
    """

    def residual(parameters: Floats) -> Floats:
        """Measured minus modelled pitch, shape (times n,), for stiffness, damping and lag."""
        design = response_design(*parameters)
        return np.asarray((measured - design @ _least_squares(design, measured)).ravel())

    first = np.clip([start.stiffness, start.damping, start.lag_s], _LOWER_BOUNDS, _UPPER_BOUNDS)
    fit = scipy.optimize.least_squares(
        residual, first, bounds=(_LOWER_BOUNDS, _UPPER_BOUNDS), x_scale=[1.0, 1.0, 0.05], xtol=1e-4
    )
    return _PitchDynamics(*map(float, fit.x))


def response_counts(pulse: Pulse, count_rad: float, drifting: Rig | None = None) -> tuple[float, float]:
    """Measure how much a pulse moves pitch, in encoder counts of `count_rad` [rad]. Returns `change_counts`,
    `std_counts`.

    If the short arm drifts, because its rotors differ by a few grams, the drift is estimated together with
    the response, with the dynamics of the rig file `drifting`.
    """
    before, during = round(BEFORE_s / PULSE_GRID_s), round(PULSE_s / PULSE_GRID_s)
    before_rad = pulse.pitch_rad[:before]
    if drifting is None:
        change_rad = pulse.pitch_rad[before : before + 2 * during] - before_rad.mean()
        largest_rad = change_rad[np.argmax(np.abs(change_rad))]
        return float(largest_rad / count_rad), float(before_rad.std() / count_rad)
    dynamics = _pitch_dynamics_of_rig(drifting)
    design = response_design(dynamics.stiffness, dynamics.damping, dynamics.lag_s)
    coefficients = _least_squares(design, pulse.pitch_rad)
    residual_rad = pulse.pitch_rad - design @ coefficients
    # Neighbouring residuals are alike, so that a fit has as many observations as the pulse has lengths.
    observations = len(residual_rad) * PULSE_GRID_s / PULSE_s
    covariance = np.linalg.pinv(design.T @ design) * len(residual_rad) / max(observations, 1.0)
    std = float(np.sqrt(covariance[0, 0]) * residual_rad.std())
    peak_counts = float(np.abs(design[:, 0]).max() / count_rad)
    return float(coefficients[0]) * peak_counts, std * peak_counts


def thrust_of(pulses: Sequence[Pulse], sign: int, rig: Rig) -> ThrustLine | str:
    """Estimate thrust gain and dead zone of a rotor from the pulses that moved pitch.

    Standard errors are those of the jackknife: the estimate is repeated without each pulse.
    """
    if len(pulses) < MIN_PULSES:
        return f"{len(pulses)} pulses moved pitch, and a line needs {MIN_PULSES}"
    volts_V = np.array([pulse.volts_V for pulse in pulses])
    # Thrust per acceleration of pitch: inertia over lever arm.
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
    """Compute the relative uncertainty of a thrust gain because of the tolerances of masses and lengths."""
    nominal_ratio = _pitch_inertia(rig) / rig["L_h"].value
    relative_changes = []
    for name in _GEOMETRY:
        changed_rig = rig.replace(**{name: rig[name].value + rig[name].tolerance})
        relative_changes.append(_pitch_inertia(changed_rig) / changed_rig["L_h"].value / nominal_ratio - 1.0)
    return float(np.sqrt(np.sum(np.square(relative_changes))))


def _gain_and_zero(volts: Floats, thrust_N: Floats) -> tuple[float, float]:
    """Fit a straight line; return its slope [N/V] and the voltage at which it is zero [V]."""
    slope, constant = np.polyfit(volts, thrust_N, 1)
    return float(slope), float(-constant / slope) if slope else 0.0


def _pitch_inertia(rig: Rig) -> float:
    """Moment of inertia about the pitch axis [kg m^2]."""
    return inertias_kg_m2({name: number.value for name, number in rig.items()})["J_phi"]


def _least_squares(design: Floats, measured: Floats) -> Floats:
    """Coefficients of the columns of `design`, shape (k, n), that fit each column of `measured`, (times,
    n).
    """
    return np.asarray(np.linalg.lstsq(design, measured, rcond=1e-10)[0])


def _matrix_powers(matrix: Floats, count: int) -> Floats:
    """Compute the powers 0 to `count` - 1 of a matrix, shape (count, n, n), by doubling their number."""
    powers = np.eye(len(matrix))[np.newaxis]
    while len(powers) < count:
        powers = np.concatenate((powers, powers @ matrix))
        matrix = matrix @ matrix
    return powers[:count]
