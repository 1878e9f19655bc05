"""Analyse the control loops on linear plants: state spaces, frequency responses and stability margins.

Gains (kp, ki, kd) are in V/rad for elevation and pitch, and in rad/rad for travel. The derivative acts on the
measured angle, after the two poles of the rate filter. The pitch setpoint is also fed forward, which is part
of the travel loop but not of the pitch loop. Quantisation and limits are neglected; sampling at 1 kHz is
approximated by a delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats

from heli_lab.control.tune.plants import LinearPlant, NO_LAG_s

ComplexArray = npt.NDArray[np.complex128]

SAMPLING_s: Final = 0.001
"""Delay of the sampled control law [s]: half a period of hold, half for reading, computing and switching."""
FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.05, 200.0, 160)
MARGIN_FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.02, 300.0, 1500)
"""Frequency grid of the margins: two crossings closer than 0.64 % are not resolved."""
_BISECTIONS: Final = 30
"""Halvings of an interval of this grid: enough for nine digits of a frequency."""
TILT_STATES: Final = 11
"""Number of states of `tilt_closed`."""
PITCH_FILTER, TRAVEL_FILTER, PITCH_INTEGRAL, TRAVEL_INTEGRAL = 5, 7, 9, 10
"""Numbers of states of `tilt_closed`, after the plant's five: the first of two filter states of each loop,
and the integral of its error."""
LOOPS: Final = ("elevation", "pitch", "travel", "differential")
"""Loops, each cut at one place: elevation at the collective; pitch at the differential, with the travel loop
open; travel at the pitch setpoint, with the pitch loop closed; differential with both loops closed."""


@dataclass(frozen=True)
class Pid:
    """Gains of one PID loop.

    Parameters
    ----------
    kp, ki, kd : float
        Output per unit of the error, of its integral, and of its rate.
    filter_Hz : float
        Cut-off frequency of the rate filter, which has two poles.
    """

    kp: float
    ki: float
    kd: float
    filter_Hz: float

    def response(self, frequency_rad_s: Floats) -> ComplexArray:
        """Return the complex gain, shape (n,), from minus the measured angle to the output.

        Parameters
        ----------
        frequency_rad_s : ndarray (n,)
            Angular frequencies [rad/s].
        """
        s = 1j * frequency_rad_s
        rate = s / (1.0 + s / (2.0 * np.pi * self.filter_Hz)) ** 2
        return np.asarray(self.kp + self.ki / s + self.kd * rate)


@dataclass(frozen=True)
class CascadeGains:
    """Gains of the cascade of all three loops.

    Parameters
    ----------
    pitch_hold : float
        Feed-forward from the pitch setpoint to the differential [V/rad]. It holds a tilt against the moment
        of masses below the pitch axis.
    """

    elevation: Pid
    pitch: Pid
    travel: Pid
    pitch_hold: float = 0.0


@dataclass(frozen=True)
class Margin:
    """Stability margins of one loop, while all other loops stay unchanged.

    Parameters
    ----------
    gain_up, gain_down : float
        Largest and smallest stable factor on the loop gain; infinite and 0 if there is no limit.
    phase_deg : float
        Phase margin.
    delay_s : float
        Delay margin.
    sensitivity : float
        Peak of 1 / abs(1 + L).
    crossover_rad_s : float
        Highest frequency at which abs(L) is 1.
    """

    gain_up: float
    gain_down: float
    phase_deg: float
    delay_s: float
    sensitivity: float
    crossover_rad_s: float


def elevation_closed(plant: LinearPlant, pid: Pid) -> Floats:
    """Return the state matrix (6, 6) of the closed elevation loop, for a setpoint of zero.

    The states are the plant's three, two of the rate filter, and the integral of minus the elevation.
    """
    closed = _with_rate_filters(plant.elevation_A, (0,), (pid,))
    output = _controller_output_row(closed.shape[0], 0, 3, pid)
    output[5] = pid.ki
    closed[5, 0] = -1.0
    closed[:3] += np.outer(plant.elevation_B, output)
    return closed


def tilt_closed(plant: LinearPlant, pitch: Pid, travel: Pid, pitch_hold: float = 0.0) -> Floats:
    """Return the state matrix (11, 11) of the closed pitch and travel loops, for setpoints of zero.

    The states are the plant's five, two of each rate filter with pitch first, and the integrals of the pitch
    and the travel error. `pitch_hold` is that of `CascadeGains`.
    """
    closed = _with_rate_filters(plant.tilt_A, (0, 1), (pitch, travel))
    closed[PITCH_INTEGRAL], closed[TRAVEL_INTEGRAL, 1] = _pitch_error_row(travel), -1.0
    closed[:5] += np.outer(plant.tilt_B, tilt_output(pitch, travel, pitch_hold))
    return closed


def tilt_output(pitch: Pid, travel: Pid, pitch_hold: float = 0.0) -> Floats:
    """Return the output matrix, one row of shape (11,), from the states of `tilt_closed` to the differential
    [V per unit], for setpoints of zero. `pitch_hold` is that of `CascadeGains`.
    """
    row = (pitch.kp + pitch_hold) * _pitch_error_row(travel)
    row[0] += pitch_hold
    row += _controller_output_row(TILT_STATES, 0, PITCH_FILTER, Pid(0.0, 0.0, pitch.kd, pitch.filter_Hz))
    row[PITCH_INTEGRAL] += pitch.ki
    return row


def open_loops(
    plant: LinearPlant, law: CascadeGains, frequency_rad_s: Floats = FREQUENCY_rad_s
) -> dict[str, ComplexArray]:
    """Return the complex loop gain L of every loop in `LOOPS`, shape (n,). Shapes: `frequency_rad_s` (n,).

    The sign convention is that of negative feedback: a Nyquist curve through -1 is marginally stable.
    """
    s = 1j * frequency_rad_s
    # The matrices approximate the delay of the voltages by additional lag; replace it by the exact delay.
    lag_s = max(plant.lag_s + plant.delay_s, NO_LAG_s)
    lag_correction = (1.0 + s * lag_s) / (1.0 + s * max(lag_s - plant.delay_s, NO_LAG_s))
    delay = lag_correction * np.exp(-s * (SAMPLING_s + plant.delay_s))
    to_elevation = delay * _frequency_response(plant.elevation_A, plant.elevation_B, 0, frequency_rad_s)
    to_pitch = delay * _frequency_response(plant.tilt_A, plant.tilt_B, 0, frequency_rad_s)
    to_travel = delay * _frequency_response(plant.tilt_A, plant.tilt_B, 1, frequency_rad_s)
    elevation, pitch, travel = (
        pid.response(frequency_rad_s) for pid in (law.elevation, law.pitch, law.travel)
    )
    inner = pitch * to_pitch
    forward = law.pitch.kp + law.pitch_hold + law.pitch.ki / s
    outer = travel * forward * to_travel
    return {
        "elevation": elevation * to_elevation,
        "pitch": inner,
        "travel": outer / (1.0 + inner),
        "differential": inner + outer,
    }


def peak_sensitivity(loop: ComplexArray) -> float:
    """Return the peak sensitivity Ms, the maximum of 1 / |1 + L| over the loop gains L in `loop`.

    It is the largest factor by which the closed loop amplifies a disturbance.
    """
    return float(np.max(1.0 / np.abs(1.0 + loop)))


def margins(plant: LinearPlant, law: CascadeGains) -> dict[str, Margin]:
    """Compute the stability margins of every loop; the `law` must stabilise the plant."""
    grid = open_loops(plant, law, MARGIN_FREQUENCY_rad_s)
    phase_crossings = _sign_changes(plant, law, grid, _sine_of_phase)
    gain_crossings = _sign_changes(plant, law, grid, _log_magnitude)
    result = {}
    for name, loop in grid.items():
        _, real_responses = phase_crossings[name]
        # Where the loop gain is real and negative, this factor would bring it to -1.
        negative = real_responses.real[real_responses.real < 0.0]
        gains = -1.0 / negative
        crossings, responses = gain_crossings[name]
        phases_deg = np.mod(np.degrees(np.angle(responses)), 360.0) - 180.0
        # The phase margin is the distance to -180 deg in either direction, the delay margin only downwards.
        lost_deg = np.mod(phases_deg, 360.0)
        result[name] = Margin(
            gain_up=float(np.min(gains[gains > 1.0], initial=np.inf)),
            gain_down=float(np.max(gains[gains < 1.0], initial=0.0)),
            phase_deg=float(np.min(np.abs(phases_deg), initial=np.inf)),
            delay_s=float(np.min(np.radians(lost_deg) / crossings, initial=np.inf)),
            sensitivity=peak_sensitivity(loop),
            crossover_rad_s=float(np.max(crossings, initial=0.0)),
        )
    return result


def _sine_of_phase(loop: ComplexArray) -> Floats:
    """Return the sine of the phase; it changes sign where the loop gain is real."""
    return np.asarray(loop.imag / np.abs(loop))


def _log_magnitude(loop: ComplexArray) -> Floats:
    """Return the logarithm of the magnitude; it changes sign at a crossover."""
    return np.asarray(np.log(np.abs(loop)))


def _sign_changes(
    plant: LinearPlant,
    law: CascadeGains,
    grid: dict[str, ComplexArray],
    value: Callable[[ComplexArray], Floats],
) -> dict[str, tuple[Floats, ComplexArray]]:
    """Find the frequencies at which a real function of each loop gain changes sign, by bisection. Shapes:
    `grid` (n,); returns (k,).

    All loops are bisected together: `control.stability_margins` interpolates one point per call and takes a
    hundred times as long.
    """
    changes = {name: np.flatnonzero(np.diff(np.sign(value(loop)))) for name, loop in grid.items()}
    # One element per crossing: its interval of the grid, and the number of its loop.
    interval = np.concatenate(list(changes.values()))
    loop_index = np.repeat(np.arange(len(grid)), [len(intervals) for intervals in changes.values()])
    crossing = np.arange(len(interval))

    def gains_at(frequency_rad_s: Floats) -> ComplexArray:
        """Gain of each crossing's loop at its own frequency."""
        loops = np.array(list(open_loops(plant, law, frequency_rad_s).values()))
        return np.asarray(loops[loop_index, crossing])

    low, high = MARGIN_FREQUENCY_rad_s[interval], MARGIN_FREQUENCY_rad_s[interval + 1]
    is_negative_at_low = value(np.array(list(grid.values()))[loop_index, interval]) < 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_low = (value(gains_at(middle)) < 0.0) == is_negative_at_low
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    middle = 0.5 * (low + high)
    gains = gains_at(middle)
    return {name: (middle[loop_index == i], gains[loop_index == i]) for i, name in enumerate(grid)}


def is_stable(plant: LinearPlant, law: CascadeGains) -> bool:
    """Whether all closed loops of a plant are stable."""
    elevation = elevation_closed(plant, law.elevation)
    tilt = tilt_closed(plant, law.pitch, law.travel, law.pitch_hold)
    return all(float(np.linalg.eigvals(closed).real.max()) < 0.0 for closed in (elevation, tilt))


def _with_rate_filters(A: Floats, measured: tuple[int, ...], pids: tuple[Pid, ...]) -> Floats:
    """Extend a state matrix by the two states of each rate filter, and by zeros for the integral of each
    loop. Shapes: `A` (n, n).
    """
    count, loops = A.shape[0], len(measured)
    closed = np.zeros((count + 3 * loops, count + 3 * loops))
    closed[:count, :count] = A
    for number, (angle, pid) in enumerate(zip(measured, pids, strict=True)):
        first = count + 2 * number
        cutoff = 2.0 * np.pi * pid.filter_Hz
        closed[first, angle], closed[first, first] = cutoff, -cutoff
        closed[first + 1, first], closed[first + 1, first + 1] = cutoff, -cutoff
    return closed


def _controller_output_row(size: int, angle: int, first: int, pid: Pid) -> Floats:
    """Return the row from the states to the proportional and derivative output of a controller."""
    row = np.zeros(size)
    cutoff = 2.0 * np.pi * pid.filter_Hz
    row[angle] = -pid.kp
    row[first], row[first + 1] = -pid.kd * cutoff, pid.kd * cutoff
    return row


def _pitch_error_row(travel: Pid) -> Floats:
    """Return the row from the states to the pitch error; the travel loop gives the pitch setpoint."""
    row = _controller_output_row(TILT_STATES, 1, TRAVEL_FILTER, travel)
    row[TRAVEL_INTEGRAL] = travel.ki
    row[0] -= 1.0
    return row


def _frequency_response(A: Floats, B: Floats, output: int, frequency_rad_s: Floats) -> ComplexArray:
    """Compute the frequency response from the input to the state number `output`, shape (n,)."""
    resolvent = 1j * frequency_rad_s[:, None, None] * np.eye(len(B)) - A
    column = np.broadcast_to(B[:, None], (len(frequency_rad_s), len(B), 1))
    return np.asarray(np.linalg.solve(resolvent, column)[:, output, 0])
