"""The control law's loops around linear plants: state spaces, frequency responses, margins.

Gains are in the law's own order (kp, ki, kd), in V/rad for elevation and pitch and in rad/rad for travel. The
derivative acts on the measured angle behind the rate filter's two poles. Pitch's setpoint is fed forward too,
which is a part of travel's loop and none of pitch's. Encoder steps and limits are left out; sampling at 1 kHz
counts as a delay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats

from heli_lab.tune.plants import LinearPlant, NO_LAG_s

Complexes = npt.NDArray[np.complex128]

SAMPLING_s: Final = 0.001
"""Half a millisecond of hold, and as much for reading, computing and the bridge's switching."""
FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.05, 200.0, 160)
MARGIN_FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.02, 300.0, 1500)
"""Where margins are looked for: two crossings within 0.64 % of a frequency are not seen."""
_BISECTIONS: Final = 30
LOOPS: Final = ("elevation", "pitch", "travel", "differential")
"""Where each is cut: at the collective; at the differential, travel's loop open; at the pitch setpoint,
pitch's loop closed; at the differential with both closed."""


@dataclass(frozen=True)
class Pid:
    """One loop's gains.

    Parameters
    ----------
    kp, ki, kd : float
        Output for each unit of error, its integral, and its rate.
    filter_Hz : float
        Cut-off of the rate filter, two poles.
    """

    kp: float
    ki: float
    kd: float
    filter_Hz: float

    def response(self, frequency_rad_s: Floats) -> Complexes:
        """Complex gain, shape (n,), from the measured angle to the output, sign reversed, at each
        `frequency_rad_s`.
        """
        s = 1j * frequency_rad_s
        rate = s / (1.0 + s / (2.0 * np.pi * self.filter_Hz)) ** 2
        return np.asarray(self.kp + self.ki / s + self.kd * rate)


@dataclass(frozen=True)
class Law:
    """The whole cascade; `pitch_hold` is the feed-forward from pitch's setpoint to the differential, V/rad,
    which holds a tilt against masses that hang below the axis.
    """

    elevation: Pid
    pitch: Pid
    travel: Pid
    pitch_hold: float = 0.0


@dataclass(frozen=True)
class Margin:
    """Stability margins of one loop, all else unchanged.

    Parameters
    ----------
    gain_up, gain_down : float
        Factor that its gain may rise and fall by; infinite and 0 where nothing happens.
    phase_deg : float
        Phase that it may lose.
    delay_s : float
        Delay that it may gain.
    sensitivity : float
        Peak of 1 / |1 + L|.
    crossover_rad_s : float
        Highest frequency at which its gain is 1.
    """

    gain_up: float
    gain_down: float
    phase_deg: float
    delay_s: float
    sensitivity: float
    crossover_rad_s: float


def elevation_closed(plant: LinearPlant, pid: Pid) -> Floats:
    """State matrix (6, 6) of the closed elevation loop: the plant's three states, two of the rate filter, the
    integral of minus the elevation.
    """
    closed = _with_filters(plant.elevation_A, (0,), (pid,))
    output = _output(closed.shape[0], 0, 3, pid)
    output[5] = pid.ki
    closed[5, 0] = -1.0
    closed[:3] += np.outer(plant.elevation_B, output)
    return closed


def tilt_closed(plant: LinearPlant, pitch: Pid, travel: Pid, pitch_hold: float = 0.0) -> Floats:
    """State matrix (11, 11) of pitch and travel closed: the plant's five states, two of each rate filter
    (pitch first), the integrals of pitch's and of travel's error, both for setpoints of zero; `pitch_hold` as
    in `Law`.
    """
    closed = _with_filters(plant.tilt_A, (0, 1), (pitch, travel))
    size = closed.shape[0]
    closed[9], closed[10, 1] = _pitch_error(size, travel), -1.0
    closed[:5] += np.outer(plant.tilt_B, tilt_output(size, pitch, travel, pitch_hold))
    return closed


def tilt_output(size: int, pitch: Pid, travel: Pid, pitch_hold: float = 0.0) -> Floats:
    """Row, shape (`size`,), from the states of the closed loops, those of `tilt_closed` first, to the
    differential, V for each unit, setpoints being zero; `pitch_hold` as in `Law`.
    """
    row = (pitch.kp + pitch_hold) * _pitch_error(size, travel)
    row[0] += pitch_hold
    row += _output(size, 0, 5, Pid(0.0, 0.0, pitch.kd, pitch.filter_Hz))
    row[9] += pitch.ki
    return row


def open_loops(
    plant: LinearPlant, law: Law, frequency_rad_s: Floats = FREQUENCY_rad_s
) -> dict[str, Complexes]:
    """Loop gain L of every loop, shape (n,), at each `frequency_rad_s`, cut as `LOOPS` says; a Nyquist curve
    through -1 is marginally stable.
    """
    s = 1j * frequency_rad_s
    # The matrices have the delay of the voltages as more lag: out with that, and in with the delay itself.
    lag_s = max(plant.lag_s + plant.delay_s, NO_LAG_s)
    less_lag = (1.0 + s * lag_s) / (1.0 + s * max(lag_s - plant.delay_s, NO_LAG_s))
    delay = less_lag * np.exp(-s * (SAMPLING_s + plant.delay_s))
    to_elevation = delay * _response(plant.elevation_A, plant.elevation_B, 0, frequency_rad_s)
    to_pitch = delay * _response(plant.tilt_A, plant.tilt_B, 0, frequency_rad_s)
    to_travel = delay * _response(plant.tilt_A, plant.tilt_B, 1, frequency_rad_s)
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


def peak_sensitivity(loop: Complexes) -> float:
    """Peak sensitivity Ms: the largest 1 / |1 + L| of a gain L over frequency, `loop`, by which the closed
    loop amplifies a disturbance.
    """
    return float(np.max(1.0 / np.abs(1.0 + loop)))


def margins(plant: LinearPlant, law: Law) -> dict[str, Margin]:
    """Margins of every loop under a `law` that stabilises it; without that no margin means anything."""
    grid = open_loops(plant, law, MARGIN_FREQUENCY_rad_s)
    at_180 = _crossings(plant, law, grid, _sine)
    at_1 = _crossings(plant, law, grid, _log_gain)
    result = {}
    for name, loop in grid.items():
        crossed = at_180[name][1].real
        gains = -1.0 / crossed[crossed < 0.0]
        crossings, responses = at_1[name]
        phases_deg = np.mod(np.degrees(np.angle(responses)), 360.0) - 180.0
        # A phase margin is to the nearest side; what a delay costs is the way round to -180.
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


def _sine(loop: Complexes) -> Floats:
    """Sine of the phase: changes its sign where the loop gain is real."""
    return np.asarray(loop.imag / np.abs(loop))


def _log_gain(loop: Complexes) -> Floats:
    return np.asarray(np.log(np.abs(loop)))


def _crossings(
    plant: LinearPlant, law: Law, grid: dict[str, Complexes], value: Callable[[Complexes], Floats]
) -> dict[str, tuple[Floats, Complexes]]:
    """Where a value of each loop gain changes its sign, rad/s, and the loop gain there.

    All loops are bisected at once: `control.stability_margins` interpolates by a spline of its own, a point a
    call, and takes a hundred times as long.
    """
    changes = {name: np.flatnonzero(np.diff(np.sign(value(loop)))) for name, loop in grid.items()}
    at = np.concatenate(list(changes.values()))
    owner = np.repeat(np.arange(len(grid)), [len(places) for places in changes.values()])
    each = np.arange(len(at))
    low, high = MARGIN_FREQUENCY_rad_s[at], MARGIN_FREQUENCY_rad_s[at + 1]
    below = value(np.array(list(grid.values()))[owner, at]) < 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        response = np.array(list(open_loops(plant, law, middle).values()))[owner, each]
        is_low = (value(response) < 0.0) == below
        low, high = np.where(is_low, middle, low), np.where(is_low, high, middle)
    middle = 0.5 * (low + high)
    response = np.array(list(open_loops(plant, law, middle).values()))[owner, each]
    return {name: (middle[owner == i], response[owner == i]) for i, name in enumerate(grid)}


def is_stable(plant: LinearPlant, law: Law) -> bool:
    """Whether every closed loop of a plant decays."""
    both = (elevation_closed(plant, law.elevation), tilt_closed(plant, law.pitch, law.travel, law.pitch_hold))
    return all(float(np.linalg.eigvals(closed).real.max()) < 0.0 for closed in both)


def _with_filters(A: Floats, measured: tuple[int, ...], pids: tuple[Pid, ...]) -> Floats:
    """The plant, two filter states for each measured angle, and room for one integral each."""
    count, loops = A.shape[0], len(measured)
    closed = np.zeros((count + 3 * loops, count + 3 * loops))
    closed[:count, :count] = A
    for number, (angle, pid) in enumerate(zip(measured, pids, strict=True)):
        first = count + 2 * number
        cutoff = 2.0 * np.pi * pid.filter_Hz
        closed[first, angle], closed[first, first] = cutoff, -cutoff
        closed[first + 1, first], closed[first + 1, first + 1] = cutoff, -cutoff
    return closed


def _output(size: int, angle: int, first: int, pid: Pid) -> Floats:
    """Row of P and D: from the states to the output."""
    row = np.zeros(size)
    cutoff = 2.0 * np.pi * pid.filter_Hz
    row[angle] = -pid.kp
    row[first], row[first + 1] = -pid.kd * cutoff, pid.kd * cutoff
    return row


def _pitch_error(size: int, travel: Pid) -> Floats:
    """Row from the states to pitch's error, with the pitch setpoint that travel's loop makes."""
    row = _output(size, 1, 7, travel)
    row[10] = travel.ki
    row[0] -= 1.0
    return row


def _response(A: Floats, B: Floats, output: int, frequency_rad_s: Floats) -> Complexes:
    resolvent = 1j * frequency_rad_s[:, None, None] * np.eye(len(B)) - A
    column = np.broadcast_to(B[:, None], (len(frequency_rad_s), len(B), 1))
    return np.asarray(np.linalg.solve(resolvent, column)[:, output, 0])
