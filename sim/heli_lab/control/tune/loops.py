"""A rig as linear plants, and the analysis of control loops on them: frequency responses and margins.

A plant is the rig linearised at hover, with one lag of the rotors and one corner of the uncertainty of its
parameters. One set of gains must stabilise all plants.

Gains (kp, ki, kd) are in V/rad for elevation and pitch, and in rad/rad for travel. The derivative acts on the
measured angle, after the two poles of the rate filter. The pitch setpoint is also fed forward, which is part
of the travel loop but not of the pitch loop. Quantisation and limits are neglected; sampling at 1 kHz is
approximated by a delay.
"""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect
from heli_sim.model.effects import RotorLag, RotorSpeedLag
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig

_NO_LAG_s: Final = 0.004
"""Lag of a rotor without lag: too short to matter for any loop, so that all plants have the same states."""
_LAG_UNCERTAINTY: Final = 0.25
"""Uncertainty of a stated lag, as a share of it."""


@dataclass(frozen=True)
class Spread:
    """Uncertainty of a rig's parameters for which the gains must work.

    Parameters
    ----------
    lag_s : tuple of float
        Lags from voltage to thrust [s].
    thrust : float
        Relative uncertainty of the thrust gain, in both directions.
    counterweight : float
        Relative uncertainty of the counterweight's mass, in both directions. 3 % can halve or nearly double
        the thrust at hover, and with it the gain from pitch to travel.
    rotor : float
        Relative difference between the rotors' masses, which causes a constant torque on pitch.
    pull_rad_s2 : float
        Acceleration of travel by a constant torque [rad/s^2]; measured rigs have 0.02 to 0.14 rad/s^2.
    """

    lag_s: tuple[float, ...] = (0.0, 0.075, 0.15)
    thrust: float = 0.2
    counterweight: float = 0.03
    rotor: float = 0.03
    pull_rad_s2: float = 0.02


@dataclass(frozen=True)
class LoopEffects:
    """Effects of a rig, sorted by their role in the design of the loops.

    Parameters
    ----------
    lag_s : float or None
        Lag of the rotors [s]; None if no effect states one.
    delay_s : float
        Delay of the voltages [s].
    linear : tuple of Effect
        Other effects in the linear plants, including a lag of the rotor speed, which uses the plants' lags.
    excluded : tuple of str
        Names of effects that the linear plants do not contain: those with states, and those that are not
        `heli_sim.model.effects.EffectSpec.linearisable`, such as dry friction or a change during the flight.
    """

    lag_s: float | None = None
    delay_s: float = 0.0
    linear: tuple[Effect, ...] = ()
    excluded: tuple[str, ...] = ()

    @property
    def spread(self) -> Spread:
        """Default spread; with a stated lag, the lags are that lag and a quarter less and more."""
        if self.lag_s is None:
            return Spread()
        return Spread(
            lag_s=tuple(share * self.lag_s for share in (1.0 - _LAG_UNCERTAINTY, 1.0, 1.0 + _LAG_UNCERTAINTY))
        )


def loop_effects_of(effects: Sequence[Effect]) -> LoopEffects:
    """Sort effects by their role in the design of the loops."""
    lags_s = [effect.lag_s for effect in effects if isinstance(effect, RotorLag | RotorSpeedLag)]
    delay_s = sum((effect.values[effect.delay] for effect in effects if effect.delay), start=0.0)
    linear, excluded = [], []
    for effect in effects:
        # A delay, and a lag of the thrust, are stated by the numbers above.
        is_stated_by_number = bool(effect.delay) or isinstance(effect, RotorLag)
        is_linear = effect.linearisable and not effect.states
        if isinstance(effect, RotorSpeedLag) or (is_linear and not effect.delay):
            linear.append(effect)
        elif not is_stated_by_number:
            excluded.append(effect.name)
    return LoopEffects(
        lag_s=sum(lags_s) if lags_s else None, delay_s=delay_s, linear=tuple(linear), excluded=tuple(excluded)
    )


@dataclass(frozen=True)
class LinearPlant:
    """Rig linearised at level hover, where elevation decouples from pitch and travel.

    Parameters
    ----------
    lag_s, thrust, counterweight : float
        Lag [s], and the factors on thrust gain and counterweight mass.
    delay_s : float
        Delay of the voltages [s]. The matrices approximate it by additional lag, frequency responses are
        exact.
    elevation_A, elevation_B : ndarray (3, 3), (3,)
        State and input matrix. States: elevation, its rate, sum of the thrusts or of the rotors' states.
        Input: the collective [V].
    tilt_A, tilt_B : ndarray (5, 5), (5,)
        State and input matrix. States: pitch, travel, their rates, difference of the thrusts or of the
        rotors' states. Input: the differential [V].
    hover_V : float
        Sum of both voltages at hover, above the dead zone [V].
    """

    lag_s: float
    thrust: float
    counterweight: float
    delay_s: float
    elevation_A: Floats
    elevation_B: Floats
    tilt_A: Floats
    tilt_B: Floats
    hover_V: float

    @property
    def elevation_gain(self) -> float:
        """Elevation acceleration per volt of collective, after the rotors' lag [rad/s^2/V]."""
        return float(-self.elevation_A[1, 2] * self.elevation_B[2] / self.elevation_A[2, 2])

    @property
    def pitch_gain(self) -> float:
        """Pitch acceleration per volt of differential, after the rotors' lag [rad/s^2/V]."""
        return float(-self.tilt_A[2, 4] * self.tilt_B[4] / self.tilt_A[4, 4])

    @property
    def travel_gain(self) -> float:
        """Travel acceleration per radian of pitch [1/s^2]."""
        return float(self.tilt_A[3, 0])


def linear_plant(
    rig: Rig,
    lag_s: float = 0.0,
    thrust: float = 1.0,
    counterweight: float = 1.0,
    *,
    model: type[Model] = MultibodyModel,
    loop_effects: LoopEffects | None = None,
) -> LinearPlant:
    """Linearise a rig at level hover.

    Parameters
    ----------
    lag_s : float
        Lag from voltage to thrust [s].
    thrust : float
        Factor on the thrust gain.
    counterweight : float
        Factor on the mass of the counterweight.
    model : type of Model
        Equations of motion.
    loop_effects : LoopEffects, optional
        Effects of the rig. Their lag is ignored; `lag_s` is used instead.

    Raises
    ------
    PlantError
        When the rig cannot hover, or needs so little thrust to hover that a tilt does not move travel.
    """
    loop_effects = loop_effects if loop_effects is not None else LoopEffects()
    rig = rig.replace(thrust_gain=thrust * rig["thrust_gain"].value, M_w=counterweight * rig["M_w"].value)
    equations = _model_with_lag(model, max(lag_s + loop_effects.delay_s, _NO_LAG_s), loop_effects.linear)
    hover = trim(equations, rig)
    linear = derivatives(equations, rig, hover.state, hover.volts_V)
    # The states are elevation, pitch, travel, their rates, and two thrusts. Transform the thrusts, and the
    # two voltages, to their sum and their difference.
    to_sum_and_difference = np.array([[1.0, 1.0], [1.0, -1.0]])
    transform = np.eye(8)
    transform[6:, 6:] = to_sum_and_difference
    A = transform @ linear.A @ np.linalg.inv(transform)
    B = transform @ linear.B @ np.linalg.inv(to_sum_and_difference)
    elevation_states, tilt_states = [0, 3, 6], [1, 2, 4, 5, 7]
    hover_V = float(np.sum(hover.volts_V) - 2.0 * rig["dead_zone"].value)  # Each rotor has a dead zone
    travel_per_pitch = A[5, 1]  # Acceleration of travel by a pitch
    if travel_per_pitch <= 0.0:
        raise PlantError(
            f"rig '{rig.name}' hovers on {hover_V:.2f} V of lift, too little to move travel by tilting",
            "reduce its counterweight",
        )
    return LinearPlant(
        lag_s=lag_s,
        thrust=thrust,
        counterweight=counterweight,
        delay_s=loop_effects.delay_s,
        elevation_A=A[np.ix_(elevation_states, elevation_states)],
        elevation_B=B[elevation_states, 0],
        tilt_A=A[np.ix_(tilt_states, tilt_states)],
        tilt_B=B[tilt_states, 1],
        hover_V=hover_V,
    )


@functools.lru_cache(maxsize=32)
def _model_with_lag(model: type[Model], lag_s: float, linear: tuple[Effect, ...]) -> Model:
    """Return a model with the `linear` effects and a rotor lag of `lag_s` [s]."""
    speed_lag = next((effect for effect in linear if isinstance(effect, RotorSpeedLag)), None)
    lag = RotorLag(lag_s) if speed_lag is None else speed_lag.with_lag(lag_s)
    return model((lag, *(effect for effect in linear if effect is not speed_lag)))


def spread_plants(
    rig: Rig, spread: Spread, *, model: type[Model] = MultibodyModel, loop_effects: LoopEffects | None = None
) -> Sequence[LinearPlant]:
    """Linearise the nominal rig at every lag of the spread, then the corners of the spread at every lag."""
    # Corners that cannot hover are left out: a counterweight 3 % heavier lifts some arms without any thrust.
    corners = itertools.product(
        spread.lag_s,
        (1.0 - spread.thrust, 1.0 + spread.thrust),
        (1.0 - spread.counterweight, 1.0 + spread.counterweight),
    )
    plants = [linear_plant(rig, lag_s, model=model, loop_effects=loop_effects) for lag_s in spread.lag_s]
    for corner in corners:
        with contextlib.suppress(PlantError):
            plants.append(linear_plant(rig, *corner, model=model, loop_effects=loop_effects))
    return plants


def count_nominal(plants: Sequence[LinearPlant]) -> int:
    """Count the plants without a deviation from the rig file, which are the first ones of the sequence."""
    return sum(plant.thrust == 1.0 and plant.counterweight == 1.0 for plant in plants)


ComplexArray = npt.NDArray[np.complex128]

_SAMPLING_s: Final = 0.001
"""Delay of the sampled control law [s]: half a period of hold, half for reading, computing and switching."""
FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.05, 200.0, 160)
_MARGIN_FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.02, 300.0, 1500)
"""Frequency grid of the margins: two crossings closer than 0.64 % are not resolved."""
_BISECTIONS: Final = 30
"""Halvings of an interval of this grid: enough for nine digits of a frequency."""
ELEVATION, ELEVATION_FILTER, ELEVATION_INTEGRAL = 0, 3, 5
"""Numbers of states of `elevation_closed`: the angle, then, after the plant's three states, the first of two
filter states and the integral of the error."""
TILT_STATES: Final = 11
"""Number of states of `tilt_closed`."""
PITCH, TRAVEL = 0, 1
PITCH_FILTER, TRAVEL_FILTER, PITCH_INTEGRAL, TRAVEL_INTEGRAL = 5, 7, 9, 10
"""Numbers of states of `tilt_closed`: the angles, then, after the plant's five states, the first of two
filter states of each loop, and the integral of its error."""
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


def cascade_gains_of(parameters: Mapping[str, float]) -> CascadeGains:
    """Convert parameters of the board to gains in V/rad and rad/rad.

    Parameters
    ----------
    parameters : Mapping of str to float
        Values by name, in the units of the board: kp, ki, kd and filter_Hz of each axis, and optionally
        pitch_hold_ff.
    """

    def pid(axis: str, scale: float) -> Pid:
        """Return the gains of an axis, multiplied by a factor between the units."""
        kp, ki, kd = (parameters[f"{axis}_{name}"] * scale for name in ("kp", "ki", "kd"))
        return Pid(kp, ki, kd, parameters[f"{axis}_filter_Hz"])

    per_rad = 180.0 / np.pi
    elevation, pitch, travel = pid("elevation", per_rad), pid("pitch", per_rad), pid("travel", 1.0)
    return CascadeGains(elevation, pitch, travel, parameters.get("pitch_hold_ff", 0.0) * per_rad)


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
    """Return the state matrix (6, 6) of the closed elevation loop, for a setpoint of zero."""
    # The states are the plant's three (elevation, rate, thrust), two of the rate filter, and the integral of
    # the error, minus the elevation.
    closed = _with_controller_states(plant.elevation_A, {ELEVATION: pid})
    closed[ELEVATION_INTEGRAL, ELEVATION] = -1.0
    output = _controller_output_row(len(closed), ELEVATION, ELEVATION_FILTER, pid)
    output[ELEVATION_INTEGRAL] = pid.ki
    closed[: len(plant.elevation_A)] += np.outer(plant.elevation_B, output)
    return closed


def tilt_closed(plant: LinearPlant, pitch: Pid, travel: Pid, pitch_hold: float = 0.0) -> Floats:
    """Return the state matrix (11, 11) of the closed pitch and travel loops, for setpoints of zero."""
    # The states are the plant's five, two of each rate filter with pitch first, and the integrals of the
    # pitch and the travel error. `pitch_hold` is that of `CascadeGains`.
    closed = _with_controller_states(plant.tilt_A, {PITCH: pitch, TRAVEL: travel})
    closed[PITCH_INTEGRAL], closed[TRAVEL_INTEGRAL, TRAVEL] = _pitch_error_row(travel), -1.0
    closed[: len(plant.tilt_A)] += np.outer(plant.tilt_B, tilt_output(pitch, travel, pitch_hold))
    return closed


def tilt_output(pitch: Pid, travel: Pid, pitch_hold: float = 0.0) -> Floats:
    """Return the output matrix, one row of shape (11,), from the states of `tilt_closed` to the differential
    [V per unit], for setpoints of zero. `pitch_hold` is that of `CascadeGains`.
    """
    row = (pitch.kp + pitch_hold) * _pitch_error_row(travel)
    # The feed-forward acts on the setpoint of pitch, not on the error, which has minus the pitch.
    row[PITCH] += pitch_hold
    row += _controller_output_row(TILT_STATES, PITCH, PITCH_FILTER, replace(pitch, kp=0.0))
    row[PITCH_INTEGRAL] += pitch.ki
    return row


def open_loops(
    plant: LinearPlant, law: CascadeGains, frequency_rad_s: Floats = FREQUENCY_rad_s
) -> dict[str, ComplexArray]:
    """Return the complex loop gain L of every loop in `LOOPS`, shape (n,). Shapes: `frequency_rad_s` (n,)."""
    # The sign convention is that of negative feedback: a Nyquist curve through -1 is marginally stable.
    s = 1j * frequency_rad_s
    # The matrices approximate the delay of the voltages by additional lag; replace it by the exact delay.
    lag_s = max(plant.lag_s + plant.delay_s, _NO_LAG_s)
    lag_correction = (1.0 + s * lag_s) / (1.0 + s * max(lag_s - plant.delay_s, _NO_LAG_s))
    delay = lag_correction * np.exp(-s * (_SAMPLING_s + plant.delay_s))
    to_elevation, to_pitch, to_travel = (
        delay * _frequency_response(A, B, output, frequency_rad_s)
        for A, B, output in (
            (plant.elevation_A, plant.elevation_B, ELEVATION),
            (plant.tilt_A, plant.tilt_B, PITCH),
            (plant.tilt_A, plant.tilt_B, TRAVEL),
        )
    )
    elevation, pitch, travel = (
        pid.response(frequency_rad_s) for pid in (law.elevation, law.pitch, law.travel)
    )
    pitch_loop = pitch * to_pitch
    # The travel loop gives the setpoint of pitch, which has no derivative action.
    volts_per_setpoint = law.pitch.kp + law.pitch_hold + law.pitch.ki / s
    travel_path = travel * volts_per_setpoint * to_travel
    return {
        "elevation": elevation * to_elevation,
        "pitch": pitch_loop,
        "travel": travel_path / (1.0 + pitch_loop),
        "differential": pitch_loop + travel_path,
    }


def peak_sensitivity(loop: ComplexArray) -> float:
    """Return the peak sensitivity Ms, the maximum of 1 / |1 + L| over the loop gains L in `loop`."""
    return float(np.max(1.0 / np.abs(1.0 + loop)))


def margins(plant: LinearPlant, law: CascadeGains) -> dict[str, Margin]:
    """Compute the stability margins of every loop; the `law` must stabilise the plant."""
    grid = open_loops(plant, law, _MARGIN_FREQUENCY_rad_s)
    phase_crossings = _sign_changes(plant, law, grid, _sine_of_phase)
    gain_crossings = _sign_changes(plant, law, grid, _log_magnitude)
    result = {}
    for name, loop in grid.items():
        real_gains = phase_crossings[name].loop_gains.real
        # Where the loop gain is real and negative, this factor would bring it to -1.
        factors = -1.0 / real_gains[real_gains < 0.0]
        crossovers = gain_crossings[name]
        phases_deg = np.mod(np.degrees(np.angle(crossovers.loop_gains)), 360.0) - 180.0
        # The phase margin is the distance to -180 deg in either direction, the delay margin only downwards.
        lost_deg = np.mod(phases_deg, 360.0)
        result[name] = Margin(
            gain_up=float(np.min(factors[factors > 1.0], initial=np.inf)),
            gain_down=float(np.max(factors[factors < 1.0], initial=0.0)),
            phase_deg=float(np.min(np.abs(phases_deg), initial=np.inf)),
            delay_s=float(np.min(np.radians(lost_deg) / crossovers.frequency_rad_s, initial=np.inf)),
            sensitivity=peak_sensitivity(loop),
            crossover_rad_s=float(np.max(crossovers.frequency_rad_s, initial=0.0)),
        )
    return result


def _sine_of_phase(loop: ComplexArray) -> Floats:
    """Return the sine of the phase; it changes sign where the loop gain is real."""
    return np.asarray(loop.imag / np.abs(loop))


def _log_magnitude(loop: ComplexArray) -> Floats:
    """Return the logarithm of the magnitude; it changes sign at a crossover."""
    return np.asarray(np.log(np.abs(loop)))


class _Crossings(NamedTuple):
    """Frequencies at which a function of a loop gain changes sign."""

    frequency_rad_s: Floats  # (k,)
    loop_gains: ComplexArray  # (k,): Loop gain at each frequency


def _sign_changes(
    plant: LinearPlant,
    law: CascadeGains,
    grid: dict[str, ComplexArray],
    real_function: Callable[[ComplexArray], Floats],
) -> dict[str, _Crossings]:
    """Find the frequencies at which a real function of each loop gain changes sign, by bisection. Shapes:
    `grid` (n,), at the frequencies `_MARGIN_FREQUENCY_rad_s`.
    """
    # All loops are bisected together: python-control's `stability_margins` interpolates one point per call
    # and takes a hundred times as long.
    grid_gains = np.array(list(grid.values()))  # (loops, n)
    # One element per crossing: the number of its loop, and its interval of the grid.
    loop_index, interval = np.nonzero(np.diff(np.sign(real_function(grid_gains))))
    crossing = np.arange(len(interval))

    def gains_at(frequency_rad_s: Floats) -> ComplexArray:
        """Gain of each crossing's loop at its own frequency."""
        loops = np.array(list(open_loops(plant, law, frequency_rad_s).values()))
        return np.asarray(loops[loop_index, crossing])

    low, high = _MARGIN_FREQUENCY_rad_s[interval], _MARGIN_FREQUENCY_rad_s[interval + 1]
    is_negative_at_low = real_function(grid_gains[loop_index, interval]) < 0.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_before_change = (real_function(gains_at(middle)) < 0.0) == is_negative_at_low
        low, high = np.where(is_before_change, middle, low), np.where(is_before_change, high, middle)
    middle = 0.5 * (low + high)
    gains = gains_at(middle)
    return {
        name: _Crossings(middle[loop_index == index], gains[loop_index == index])
        for index, name in enumerate(grid)
    }


def is_stable(plant: LinearPlant, law: CascadeGains) -> bool:
    """Whether all closed loops of a plant are stable."""
    elevation = elevation_closed(plant, law.elevation)
    tilt = tilt_closed(plant, law.pitch, law.travel, law.pitch_hold)
    return all(float(np.linalg.eigvals(closed).real.max()) < 0.0 for closed in (elevation, tilt))


def _with_controller_states(A: Floats, pid_of_angle: dict[int, Pid]) -> Floats:
    """Extend a state matrix by the two states of each loop's rate filter, then by the integral of each
    loop's error, whose row is still zero. Shapes: `A` (n, n).
    """
    # `pid_of_angle`: The controllers by the number of the state that they control.
    count, size = len(A), len(A) + 3 * len(pid_of_angle)
    closed = np.zeros((size, size))
    closed[:count, :count] = A
    for number, (angle, pid) in enumerate(pid_of_angle.items()):
        first = count + 2 * number
        second = first + 1
        cutoff = 2.0 * np.pi * pid.filter_Hz
        closed[first, angle], closed[first, first] = cutoff, -cutoff
        closed[second, first], closed[second, second] = cutoff, -cutoff
    return closed


def _controller_output_row(size: int, angle: int, first_filter: int, pid: Pid) -> Floats:
    """Return the row from the states to the proportional and derivative output of a controller."""
    # `size`: Number of states. `angle`, `first_filter`: Numbers of the controlled state, and of the first of
    # the two states of its rate filter; their difference is proportional to the rate.
    row = np.zeros(size)
    cutoff = 2.0 * np.pi * pid.filter_Hz
    row[angle] = -pid.kp
    row[first_filter], row[first_filter + 1] = -pid.kd * cutoff, pid.kd * cutoff
    return row


def _pitch_error_row(travel: Pid) -> Floats:
    """Return the row from the states to the pitch error; the travel loop gives the pitch setpoint."""
    row = _controller_output_row(TILT_STATES, TRAVEL, TRAVEL_FILTER, travel)
    row[TRAVEL_INTEGRAL] = travel.ki
    row[PITCH] -= 1.0
    return row


def _frequency_response(A: Floats, B: Floats, output: int, frequency_rad_s: Floats) -> ComplexArray:
    """Compute the frequency response from the input to the state number `output`, shape (n,)."""
    resolvent = 1j * frequency_rad_s[:, None, None] * np.eye(len(B)) - A
    column = np.broadcast_to(B[:, None], (len(frequency_rad_s), len(B), 1))
    return np.asarray(np.linalg.solve(resolvent, column)[:, output, 0])
