"""Design gains that minimise the tracking error under a bound on the peak sensitivity of every loop.

All loops are designed in the same way. The setpoint of a take-off and of a travel step is the shaped path of
the board. The feed-forward follows from the rig's parameters. The gains minimise the squared tracking error
along this path, over the rig and all corners of its spread with the same gains and feed-forward. The peak
sensitivity of every loop on every plant stays below a bound. The Nelder-Mead method optimises the logarithms
of the gains, because gains are positive and of unknown magnitude. A bound S on the sensitivity also bounds
the margins: the gain may rise by S / (S - 1) and the phase may fall by 2 asin(1 / 2 S).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.declaration import PARAMS
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.rig import Rig
from heli_sim.rig.board import encoder_parameters
from heli_sim.rig.rig import direction_is_known

from heli_lab.control.tune import loops
from heli_lab.control.tune.loops import (
    CascadeGains,
    ComplexArray,
    LinearPlant,
    LoopEffects,
    Margin,
    Pid,
    Spread,
    count_nominal,
    spread_plants,
)
from heli_lab.control.tune.paths import (
    SIMULATION_STEP_s,
    TravelStep,
    constant_loads_deg_s2,
    discretise,
    shaped_step,
)

TRAVEL_STEP_DEG: Final = 15.0
PITCH_SETPOINT_MAX_DEG: Final = 30.0
ELEVATION_SLEW_DEG_S: Final = 15.0
TRAVEL_SLEW_DEG_S: Final = 20.0

_PITCH_SHARE: Final = 0.3
"""Pitch setpoint of a shaped travel step, as a share of the largest pitch setpoint."""
_COLLECTIVE_SHARE: Final = 0.75
"""Additional collective of a take-off, as a share of the hover voltage, or of the voltage that remains
beyond it if that is smaller."""
_MAX_ELEVATION_DEG_S2: Final = 30.0
_MAX_TRAVEL_DEG_S2: Final = 4.5
_ELEVATION_FILTER_Hz, _PITCH_FILTER_Hz, _TRAVEL_FILTER_Hz = 6.0, 16.0, 3.0
"""Cut-offs of the rate filters of elevation, pitch and travel, set by quantisation noise: the rate of travel
has the largest gain, pitch the fastest loop."""
_TAKE_OFF_TIME_s, _STEP_TIME_s = 8.0, 10.0
"""Length of the simulated take-off and of the simulated travel step."""
_UNIT_GAIN, _NO_GAIN = Pid(1.0, ki=0.0, kd=0.0, filter_Hz=1.0), Pid(0.0, ki=0.0, kd=0.0, filter_Hz=1.0)


@dataclass(frozen=True)
class Design:
    """Result of a design: gains, and the plants for which they were designed.

    Parameters
    ----------
    law : CascadeGains
        Gains in V/rad and rad/rad.
    plants : sequence of LinearPlant
        The rig at each lag, then the corners of its spread.
    sensitivity : float
        Bound on the peak sensitivity.
    parameters : Mapping of str to float
        Parameters of the board, by their declared names and in their declared units.
    """

    law: CascadeGains
    plants: Sequence[LinearPlant]
    sensitivity: float
    parameters: Mapping[str, float]

    @cached_property
    def margins(self) -> list[dict[str, Margin]]:
        """Stability margins of each loop, on each plant."""
        return [loops.margins(plant, self.law) for plant in self.plants]


def find_gains(
    rig: Rig,
    spread: Spread | None = None,
    sensitivity: float = 3.5,
    on_progress: Callable[[str], None] | None = None,
    *,
    model: type[Model] = MultibodyModel,
    loop_effects: LoopEffects | None = None,
) -> Design:
    """Design the parameters of the board's control law for a rig.

    Parameters
    ----------
    spread : Spread, optional
        Uncertainty of the rig's parameters; by default the one of `loop_effects`.
    sensitivity : float
        Upper bound on the peak sensitivity of every loop on every plant.
    on_progress : callable taking str, optional
        Called with the name of each step of the design.
    model : type of Model
        Equations of motion of the rig.

    Raises
    ------
    PlantError
        When the rig cannot hover, or needs more voltage to hover than its supply gives.
    """
    report = on_progress or (lambda _: None)
    loop_effects = loop_effects if loop_effects is not None else LoopEffects()
    spread = spread if spread is not None else loop_effects.spread
    plants = spread_plants(rig, spread, model=model, loop_effects=loop_effects)
    _check_lift(rig, plants[0].hover_V)
    report("elevation: take-off")
    elevation, elevation_path = _design_elevation(rig, plants, sensitivity)
    report("pitch and travel: step")
    tilt = _design_tilt(rig, plants, spread, sensitivity)
    law = CascadeGains(elevation, tilt.pitch, tilt.travel, pitch_hold=tilt.pitch_hold)
    parameters = rig_parameters(rig) | elevation_path | tilt.parameters | _law_parameters(law)
    return Design(law, plants, sensitivity, parameters)


@dataclass(frozen=True)
class _TakeOff:
    """Take-off by which the elevation gains are evaluated."""

    plants: Sequence[LinearPlant]  # The rig at each lag, then the corners of its spread
    path_deg: Floats  # (n, 3): Setpoint with its first and second derivative, in degrees and seconds
    feedforward: Floats  # (n,): Feed-forward of hover voltage and acceleration [V deg/rad]

    def error_deg(self, pid: Pid, closed: Floats) -> Floats:
        """Simulate the take-off on all plants, and return the error of the elevation [deg], shape (n,
        plants). Shapes: `closed` (plants, 6, 6).
        """
        nominal_V = self.plants[0].hover_V
        rate_state = 1
        collective_input, setpoint_input, constant_input = range(3)
        input_matrices = np.zeros((len(self.plants), 6, 3))
        for index, plant in enumerate(self.plants):
            input_matrices[index, :3, collective_input] = plant.elevation_B
            # A plant needs another hover voltage than the nominal one that is fed forward.
            acceleration_rad_s2 = (nominal_V - plant.hover_V) * plant.elevation_gain
            input_matrices[index, rate_state, constant_input] = np.degrees(acceleration_rad_s2)
        input_matrices[:, loops.ELEVATION_INTEGRAL, setpoint_input] = 1.0
        setpoint, rate = self.path_deg[:, 0], self.path_deg[:, 1]
        collective = self.feedforward + pid.kp * setpoint + pid.kd * rate
        inputs = np.column_stack((collective, setpoint, np.ones(len(setpoint))))
        states = discretise(closed, input_matrices).simulate(inputs)
        return states[:, :, loops.ELEVATION] - setpoint[:, None]


def _design_elevation(
    rig: Rig, plants: Sequence[LinearPlant], sensitivity: float
) -> tuple[Pid, dict[str, float]]:
    """Design the elevation loop: its gains, and the board's parameters of path and feed-forward."""
    nominal, nominal_count = plants[0], count_nominal(plants)
    gain = nominal.elevation_gain
    # The hover voltage rises with elevation, because masses below the axis pull the arm back to level, with
    # the acceleration A[1, 0] per radian.
    slope_V_rad = -float(nominal.elevation_A[1, 0]) / gain
    acceleration_ff = 1.0 / gain
    spare_V = min(nominal.hover_V, _lift_max_V(rig) - nominal.hover_V)
    acceleration_deg_s2 = min(_MAX_ELEVATION_DEG_S2, float(np.degrees(_COLLECTIVE_SHARE * spare_V * gain)))
    rise_deg = -rig["elevation_min"].value
    path_deg = shaped_step(
        rise_deg, ELEVATION_SLEW_DEG_S, acceleration_deg_s2, _TAKE_OFF_TIME_s, SIMULATION_STEP_s
    )
    setpoint, _, acceleration = path_deg.T
    take_off = _TakeOff(plants, path_deg, slope_V_rad * setpoint + acceleration_ff * acceleration)
    # With unit gains, the loop is the response of elevation to the collective.
    unit_gains = CascadeGains(_UNIT_GAIN, _NO_GAIN, _NO_GAIN)
    plant_responses = np.array([loops.open_loops(plant, unit_gains)["elevation"] for plant in plants])

    def cost(gains: Floats) -> float:
        """Cost of the elevation loop's gains kp, ki and kd, shape (3,)."""
        pid = _controller_of_gains(gains, _ELEVATION_FILTER_Hz)
        closed = np.array([loops.elevation_closed(plant, pid) for plant in plants])
        pole_1_s = _slowest_pole_1_s(closed)
        if pole_1_s > -_MIN_DECAY_1_s:
            return _UNSTABLE_COST + pole_1_s
        peak = loops.peak_sensitivity(pid.response(loops.FREQUENCY_rad_s) * plant_responses)
        squares_deg2 = np.mean(take_off.error_deg(pid, closed) ** 2, axis=0)
        return _log_cost(squares_deg2, nominal_count) + _bound_penalty(peak, sensitivity)

    # At this frequency, the loop gain of a double integrator is 1 by the derivative action, 0.5 by the
    # proportional and 0.1 by the integral action.
    crossover = _initial_crossover_rad_s(plants)
    kp, ki, kd = 0.5 * crossover**2 / gain, 0.1 * crossover**3 / gain, crossover / gain
    start = np.array([kp, ki, kd])
    pid = _controller_of_gains(_minimise_positive(cost, start), _ELEVATION_FILTER_Hz)
    return pid, {
        "hover_V": nominal.hover_V,
        "hover_slope": float(np.radians(slope_V_rad)),
        "elevation_rate_ff": 1.0,
        "elevation_acceleration_ff": float(np.radians(acceleration_ff)),
        "elevation_slew_deg_s": ELEVATION_SLEW_DEG_S,
        "elevation_acceleration_deg_s2": acceleration_deg_s2,
        "elevation_gain": nominal.elevation_gain,
    }


@dataclass(frozen=True)
class _TiltDesign:
    """Gains of the pitch and the travel loop."""

    pitch: Pid  # pitch, travel: Gains in V/rad and rad/rad
    travel: Pid
    pitch_hold: float  # Feed-forward from the pitch setpoint to the differential [V/rad]
    parameters: dict[str, float]
    """The board's parameters of path, feed-forward and limits, by their declared names."""


def _tilt_loops(
    pitch: Pid, travel: Pid, pitch_hold: float, to_pitch: ComplexArray, to_travel: ComplexArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Compute the open loops of pitch, of travel, and of the differential voltage that both loops share.
    Shapes: `to_pitch, to_travel` (plants, frequencies).
    """
    pitch_loop = pitch.response(loops.FREQUENCY_rad_s) * to_pitch
    volts_per_demand = pitch.kp + pitch_hold + pitch.ki / (1j * loops.FREQUENCY_rad_s)
    travel_path = travel.response(loops.FREQUENCY_rad_s) * volts_per_demand * to_travel
    # The pitch loop is closed inside of the travel loop.
    return pitch_loop, travel_path / (1.0 + pitch_loop), pitch_loop + travel_path


def _design_tilt(rig: Rig, plants: Sequence[LinearPlant], spread: Spread, sensitivity: float) -> _TiltDesign:
    """Design the loops of pitch and travel together."""
    nominal, nominal_count = plants[0], count_nominal(plants)
    # Masses below the pitch axis pull a tilt back, with the acceleration A[2, 0] per radian. The feed-forward
    # holds the tilt instead.
    pitch_hold = -float(nominal.tilt_A[2, 0]) / nominal.pitch_gain
    acceleration_deg_s2 = min(_MAX_TRAVEL_DEG_S2, _PITCH_SHARE * PITCH_SETPOINT_MAX_DEG * nominal.travel_gain)
    path = shaped_step(
        TRAVEL_STEP_DEG, TRAVEL_SLEW_DEG_S, acceleration_deg_s2, _STEP_TIME_s, SIMULATION_STEP_s
    )
    # Time of the fastest step without a limit of the rate: half of it speeds up, half of it brakes.
    arrival_row = round(2.0 * np.sqrt(TRAVEL_STEP_DEG / acceleration_deg_s2) / SIMULATION_STEP_s)
    travel_step = TravelStep(plants, pitch_hold, path, arrival_row, constant_loads_deg_s2(rig, spread))
    differential_max_V = _largest_differential_V(rig, nominal.hover_V)
    # With unit gains, the loops are the responses of pitch and travel to the differential. The loop
    # "differential" is their sum; the loop "travel" would have the pitch loop closed inside it.
    unit_gains = CascadeGains(_NO_GAIN, _UNIT_GAIN, _UNIT_GAIN)
    plant_responses = [loops.open_loops(plant, unit_gains) for plant in plants]
    to_pitch = np.array([response["pitch"] for response in plant_responses])
    to_travel = np.array([response["differential"] - response["pitch"] for response in plant_responses])

    def cost(gains: Floats) -> float:
        """Cost of the gains of pitch and travel and of the feed-forward, shape (7,)."""
        pitch, travel, acceleration_ff = _tilt_controllers(gains)
        closed = np.array([loops.tilt_closed(plant, pitch, travel, pitch_hold) for plant in plants])
        pole_1_s = _slowest_pole_1_s(closed)
        if pole_1_s > -_MIN_DECAY_1_s:
            return _UNSTABLE_COST + pole_1_s
        open_loops = _tilt_loops(pitch, travel, pitch_hold, to_pitch, to_travel)
        peaks = [loops.peak_sensitivity(open_loop) for open_loop in open_loops]
        squares, largest_V = travel_step.simulate(pitch, travel, acceleration_ff, closed)
        penalty = sum(_bound_penalty(peak, sensitivity) for peak in peaks)
        penalty += _bound_penalty(largest_V, differential_max_V)
        return _log_cost(squares, nominal_count) + penalty

    start = _initial_tilt_gains(nominal, _initial_crossover_rad_s(plants))
    pitch, travel, acceleration_ff = _tilt_controllers(_minimise_positive(cost, start))
    return _TiltDesign(
        pitch=pitch,
        travel=travel,
        pitch_hold=pitch_hold,
        parameters={
            "pitch_hold_ff": float(np.radians(pitch_hold)),
            "travel_rate_ff": 1.0,
            "travel_acceleration_ff": acceleration_ff,
            "travel_slew_deg_s": TRAVEL_SLEW_DEG_S,
            "travel_acceleration_deg_s2": acceleration_deg_s2,
            "pitch_setpoint_max_deg": PITCH_SETPOINT_MAX_DEG,
            "differential_max_V": differential_max_V,
            "pitch_gain": nominal.pitch_gain,
            "travel_gain": nominal.travel_gain,
            "travel_motion_deg": travel_motion_deg(nominal.travel_gain),
        },
    )


class _TiltControllers(NamedTuple):
    """The controllers that the seven gains of a search stand for."""

    pitch: Pid
    travel: Pid
    acceleration_ff: float  # Feed-forward of the travel acceleration


def _tilt_controllers(gains: Floats) -> _TiltControllers:
    """Split the gains of a search, in the order of `_initial_tilt_gains`."""
    return _TiltControllers(
        _controller_of_gains(gains[0:3], _PITCH_FILTER_Hz),
        _controller_of_gains(gains[3:6], _TRAVEL_FILTER_Hz),
        float(gains[6]),
    )


def _initial_tilt_gains(nominal: LinearPlant, inner_rad_s: float) -> Floats:
    """Return the start of the search, shape (7,): kp, ki and kd of pitch, the same of travel, the
    feed-forward.
    """
    outer_rad_s = inner_rad_s / 2.0
    pitch_kp = (0.5 * inner_rad_s**2 - 0.5 * nominal.tilt_A[2, 0]) / nominal.pitch_gain
    travel_kp = 0.5 * outer_rad_s**2 / nominal.travel_gain
    pitch = [pitch_kp, 0.2 * pitch_kp, inner_rad_s / nominal.pitch_gain]
    travel = [travel_kp, 0.1 * travel_kp, outer_rad_s / nominal.travel_gain]
    return np.array([*pitch, *travel, 1.0 / nominal.travel_gain])


def _controller_of_gains(gains: Floats, filter_Hz: float) -> Pid:
    """Make a controller from its gains kp, ki and kd, shape (3,), and the cut-off of its rate filter."""
    return Pid(float(gains[0]), float(gains[1]), float(gains[2]), filter_Hz)


MOTOR_MAX_V: Final = 10.0
"""Largest voltage of a motor in flight, even if the supply gives more [V]."""
_PARAMETERS: Final = {spec.name: spec for spec in PARAMS}


def _check_lift(rig: Rig, hover_V: float) -> None:
    """Raise a PlantError if the rig's motors cannot hold it at `hover_V`, the sum above the dead zone [V]."""
    if hover_V >= _lift_max_V(rig):
        raise PlantError(
            f"rig '{rig.name}' hovers at {0.5 * hover_V + rig['dead_zone'].value:.1f} V per motor, "
            f"but its motors get at most {_motor_max_V(rig):.1f} V",
            "check its masses, thrust_gain and supply",
        )


def rig_parameters(rig: Rig) -> dict[str, float]:
    """Return the parameters of the board that follow from the rig alone."""
    # Counts per revolution are included only for encoders whose direction the rig file states. The sign of
    # the others depends on their wiring, and is stored on the board, so that a file of gains must not change
    # it.
    encoders = zip(encoder_parameters(rig).items(), direction_is_known(rig), strict=True)
    counts_per_rev = {name: value for (name, value), is_known in encoders if is_known}
    supply_V = rig["supply"].value
    return counts_per_rev | {
        "elevation_rest_deg": rig["elevation_min"].value,
        "supply_V": supply_V,
        "motor_min_V": -supply_V if rig["reverse_thrust"].value > 0.0 else 0.0,
        "motor_max_V": _motor_max_V(rig),
        "dead_zone_V": rig["dead_zone"].value,
    }


def _law_parameters(law: CascadeGains) -> dict[str, float]:
    """Convert the gains and filters of a law to parameters of the board, in its units."""
    values: dict[str, float] = {}
    for axis, pid in (("elevation", law.elevation), ("pitch", law.pitch), ("travel", law.travel)):
        for name, gain in (("kp", pid.kp), ("ki", pid.ki), ("kd", pid.kd)):
            # The board takes V per degree, and for travel degrees per degree.
            values[f"{axis}_{name}"] = gain if axis == "travel" else float(np.radians(gain))
        values[f"{axis}_filter_Hz"] = pid.filter_Hz
    return values


def travel_motion_deg(gain: float) -> float:
    """Return the tilt from which on the board expects travel to move [deg]."""
    default_acceleration = _PARAMETERS["travel_motion_deg"].default * _PARAMETERS["travel_gain"].default
    return max(default_acceleration / gain, _PARAMETERS["travel_motion_deg"].min)


def _largest_differential_V(rig: Rig, hover_V: float) -> float:
    """Compute the largest difference of the voltages at which their sum still holds the arm [V]."""
    # Beyond the hover voltage, one rotor stops and the other lifts the arm. Beyond the reserve of the
    # stronger motor, the arm sinks.
    return max(min(hover_V, _lift_max_V(rig) - hover_V), 0.1 * hover_V)


def _lift_max_V(rig: Rig) -> float:
    """Largest sum of both voltages above the dead zone [V]."""
    return 2.0 * (_motor_max_V(rig) - rig["dead_zone"].value)


def _motor_max_V(rig: Rig) -> float:
    """Largest voltage of a motor [V]: the supply, but at most `MOTOR_MAX_V`."""
    return min(rig["supply"].value, MOTOR_MAX_V)


_MIN_DECAY_1_s: Final = 0.02
"""Smallest decay rate of a closed loop; slower loops count as unstable."""
_UNSTABLE_COST: Final = 1e3
"""Cost of an unstable loop, far above any other cost; its slowest pole is added."""
_BOUND_WEIGHT: Final = 30.0
"""Cost of exceeding a bound by the factor e."""
_OTHER_LAGS_s: Final = 0.03
"""Lag of a loop in addition to that of the rotors [s], for the start values of the gains."""


def _initial_crossover_rad_s(plants: Sequence[LinearPlant]) -> float:
    """Choose a crossover frequency for a double integrator with the longest lag, by the symmetrical
    optimum.
    """
    # The result is only the start of a minimisation, so that the factor of 2.2 is not critical; the textbook
    # has 2.
    longest_lag_s = max(plant.lag_s for plant in plants) + _OTHER_LAGS_s
    return 1.0 / (2.2 * longest_lag_s)


def _slowest_pole_1_s(closed: Floats) -> float:
    """Return the largest real part of all poles [1/s] of closed loops with the state matrices `closed`, shape
    (plants, n, n).
    """
    return float(np.linalg.eigvals(closed).real.max())


def _log_cost(squares: Floats, nominal_count: int) -> float:
    """Combine the mean squared errors of all plants into one cost. Shapes: `squares` (plants,)."""
    # The cost is the mean of two logarithms: that of the nominal plants' mean, and that of the corners' mean.
    return float(0.5 * (np.log(squares[:nominal_count].mean()) + np.log(squares[nominal_count:].mean())))


def _bound_penalty(peak: float, bound: float) -> float:
    """Return the cost of a `peak` that exceeds its `bound`; 0 if it does not."""
    return _BOUND_WEIGHT * max(0.0, float(np.log(peak / bound)))


def _minimise_positive(cost: Callable[[Floats], float], start: Floats) -> Floats:
    """Find the positive gains with the lowest cost, by the Nelder-Mead method in their logarithms. Shapes:
    `start` (k,).
    """
    # The search is restarted with a new simplex, because a small simplex can get stuck. It ends when the cost
    # falls by less than 0.01, which means that errors fall by less than 0.5 %.
    from scipy.optimize import minimize

    best, best_cost = np.log(start), np.inf
    options: dict[str, Any] = {"xatol": 3e-3, "fatol": 1e-3, "maxiter": 300, "adaptive": True}
    for simplex_size in (0.4, 0.3, 0.2, 0.2):
        options["initial_simplex"] = np.vstack([best, best + simplex_size * np.eye(len(best))])
        optimum = minimize(lambda logs: cost(np.exp(logs)), best, method="Nelder-Mead", options=options)
        improvement = best_cost - optimum.fun
        best, best_cost = optimum.x, optimum.fun
        if improvement < 0.01:
            break
    return np.asarray(np.exp(best), float)
