"""Gains for a rig: least tracking error on the board's own path, under a bound on the peak sensitivity.

One principle for all loops. The setpoint of a take-off and of a travel step is the board's own shaped path;
the feed-forward follows from the rig's numbers; and the gains are those that make the squared error along
that path least, over the rig and all corners of its spread flown with the same gains and the same
feed-forward, while the peak sensitivity of every loop on every plant stays below a bound. Nelder and Mead's
method finds them, in logarithms, because gains are positive and of unknown size. What bounds the
sensitivity bounds the margins too: at S, gain may rise by S / (S - 1) and phase fall by 2 asin(1 / 2 S).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.declaration import PARAMS
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.rig import Rig
from heli_sim.rig.inertia import inertias_kg_m2

from heli_lab.tune import loops
from heli_lab.tune.loops import Law, Pid
from heli_lab.tune.plants import Known, LinearPlant, Spread, spread_plants
from heli_lab.tune.shaping import shaped_step
from heli_lab.tune.simulate import Sampled, STEP_s, sampled

STEP_DEG: Final = 15.0
PITCH_SETPOINT_MAX_DEG: Final = 30.0
MOTOR_MAX_V: Final = 10.0
ELEVATION_SLEW_DEG_S: Final = 15.0
TRAVEL_SLEW_DEG_S: Final = 20.0

_PITCH_SHARE: Final = 0.3  # of the largest pitch setpoint, for a shaped step
_COLLECTIVE_SHARE: Final = 0.75  # of the hover voltage or of what there is beyond it, for a take-off
_MOST_ELEVATION_DEG_S2: Final = 30.0
_MOST_TRAVEL_DEG_S2: Final = 4.5
_FILTERS_Hz: Final = (
    6.0,
    16.0,
    3.0,
)  # quantisation: travel's rate has the largest gain, pitch's the fastest loop
_HOVER_s: Final = 8.0  # before a travel step: what a lopsided rig needs to be trimmed by its integrators
_DECAY_1_s: Final = 0.02  # the slowest closed loop allowed
_OVERSHOOT_WEIGHT: Final = 0.5
_LATE_WEIGHT: Final = 30.0  # what is left when the path has ended is what a step is judged by
_BOUND_WEIGHT: Final = 30.0
_UNSTABLE: Final = 1e3


@dataclass(frozen=True)
class Design:
    """Gains, and what they were found on.

    Parameters
    ----------
    law : Law
        Gains in the law's own units.
    plants : sequence of LinearPlant
        The rig first, then the corners of its spread.
    sensitivity : float
        Bound that was set.
    parameters : Mapping of str to float
        The board's parameters, by their declared names and in their declared units.
    """

    law: Law
    plants: Sequence[LinearPlant]
    sensitivity: float
    parameters: Mapping[str, float]


def find_gains(
    rig: Rig,
    spread: Spread | None = None,
    sensitivity: float = 3.5,
    on_progress: Callable[[str], None] | None = None,
    *,
    model: type[Model] = MultibodyModel,
    known: Known | None = None,
) -> Design:
    """Find the control law's parameters for a rig.

    Parameters
    ----------
    spread : Spread, optional
        How far it may be from its numbers; without it what `known` says.
    sensitivity : float
        Largest peak sensitivity of any loop on any plant.
    on_progress : callable taking str, optional
        Told what is searched for.
    model : type of Model
        Equations of the rig.

    Raises
    ------
    PlantError
        When the rig cannot hover, or needs more voltage for it than it has.
    """
    say = on_progress if on_progress is not None else _silent
    known = known if known is not None else Known()
    spread = spread if spread is not None else known.spread
    plants = spread_plants(rig, spread, model=model, known=known)
    _check_lift(rig, plants[0].hover_V)
    say("elevation: take-off")
    elevation, elevation_path = _design_elevation(rig, plants, sensitivity)
    say("pitch and travel: step")
    pitch, travel, pitch_hold, tilt_path = _design_tilt(rig, plants, spread, sensitivity)
    law = Law(elevation, pitch, travel, pitch_hold)
    parameters = _of_rig(rig) | elevation_path | tilt_path | _of_law(law)
    return Design(law, plants, sensitivity, parameters)


def _check_lift(rig: Rig, hover_V: float) -> None:
    if hover_V >= _lift_max_V(rig):
        raise PlantError(
            f"rig '{rig.name}' hovers at {0.5 * hover_V + rig['dead_zone'].value:.1f} V a motor, and has "
            f"{_motor_max_V(rig):.1f}",
            "check its masses, thrust_gain and supply",
        )


def _silent(_: str) -> None:
    pass


def _of_rig(rig: Rig) -> dict[str, float]:
    """What the board must know of the machine.

    Counts a revolution only where they are not the declared ones: their sign is how an encoder is wired,
    which a rig does not know, and a file of gains must not turn it round.
    """
    counts = rig["encoder_counts"].value
    counted = {
        "elevation_counts_per_rev": counts,
        "pitch_counts_per_rev": counts,
        "travel_counts_per_rev": counts * rig["encoder_travel_ratio"].value,
    }
    usual = {spec.name: spec.default for spec in PARAMS}
    supply_V = rig["supply"].value
    return {name: value for name, value in counted.items() if value != usual[name]} | {
        "elevation_rest_deg": rig["elevation_min"].value,
        "supply_V": supply_V,
        "motor_min_V": -supply_V if rig["reverse_thrust"].value > 0.0 else 0.0,
        "motor_max_V": _motor_max_V(rig),
        "dead_zone_V": rig["dead_zone"].value,
    }


def _of_law(law: Law) -> dict[str, float]:
    in_degrees = {"elevation": law.elevation, "pitch": law.pitch}
    values: dict[str, float] = {}
    for axis, pid in in_degrees.items():
        for name, gain in (("kp", pid.kp), ("ki", pid.ki), ("kd", pid.kd)):
            values[f"{axis}_{name}"] = float(np.radians(gain))
        values[f"{axis}_filter_Hz"] = pid.filter_Hz
    travel = law.travel
    values |= {"travel_kp": travel.kp, "travel_ki": travel.ki, "travel_kd": travel.kd}
    return values | {"travel_filter_Hz": travel.filter_Hz}


def _design_elevation(
    rig: Rig, plants: Sequence[LinearPlant], sensitivity: float
) -> tuple[Pid, dict[str, float]]:
    nominal, nominal_count = plants[0], _count_own(plants)
    gain = nominal.elevation_gain
    # The hover voltage rises with elevation: masses that hang below the axis pull back to level.
    slope_V_rad = -float(nominal.elevation_A[1, 0]) / gain
    acceleration_ff = 1.0 / gain
    spare_V = min(nominal.hover_V, _lift_max_V(rig) - nominal.hover_V)
    acceleration_deg_s2 = min(_MOST_ELEVATION_DEG_S2, float(np.degrees(_COLLECTIVE_SHARE * spare_V * gain)))
    rise_deg = -rig["elevation_min"].value
    path = shaped_step(rise_deg, ELEVATION_SLEW_DEG_S, acceleration_deg_s2, 8.0, STEP_s)
    forward_V = slope_V_rad * path[:, 0] + acceleration_ff * path[:, 2]
    # The other plants hover at other voltages than the one that is fed forward.
    missing_deg_s2 = np.degrees(
        [(nominal.hover_V - plant.hover_V) * plant.elevation_gain for plant in plants]
    )

    def error_deg(pid: Pid, closed: Floats) -> Floats:
        given = np.zeros((len(plants), 6, 3))
        for index, plant in enumerate(plants):
            given[index, :3, 0] = plant.elevation_B
            given[index, 1, 2] = missing_deg_s2[index]
        given[:, 5, 1] = 1.0
        moved_V = forward_V + pid.kp * path[:, 0] + pid.kd * path[:, 1]
        inputs = np.column_stack((moved_V, path[:, 0], np.ones(len(path))))
        return sampled(closed, given).along(inputs)[:, :, 0] - path[:, :1]

    def cost(gains: Floats) -> float:
        pid = _pid(gains, _FILTERS_Hz[0])
        closed = np.array([loops.elevation_closed(plant, pid) for plant in plants])
        slowest_1_s = _slowest_1_s(closed)
        if slowest_1_s > -_DECAY_1_s:
            return _UNSTABLE + slowest_1_s
        response = pid.response(loops.FREQUENCY_rad_s)
        peak = float(np.max(1.0 / np.abs(1.0 + response * bare)))
        return _measure(np.mean(error_deg(pid, closed) ** 2, axis=0), nominal_count) + _excess(
            peak, sensitivity
        )

    unit = Law(Pid(1.0, 0.0, 0.0, 1.0), Pid(0.0, 0.0, 0.0, 1.0), Pid(0.0, 0.0, 0.0, 1.0))
    bare = np.array([loops.open_loops(plant, unit)["elevation"] for plant in plants])
    crossover = _first_guess_rad_s(plants)
    start = np.array([0.5 * crossover**2, 0.1 * crossover**3, crossover]) / gain
    pid = _pid(_least(cost, start), _FILTERS_Hz[0])
    return pid, {
        "hover_V": nominal.hover_V,
        "hover_slope": float(np.radians(slope_V_rad)),
        "elevation_rate_ff": 1.0,
        "elevation_acceleration_ff": float(np.radians(acceleration_ff)),
        "elevation_slew_deg_s": ELEVATION_SLEW_DEG_S,
        "elevation_acceleration_deg_s2": acceleration_deg_s2,
    }


def _design_tilt(
    rig: Rig, plants: Sequence[LinearPlant], spread: Spread, sensitivity: float
) -> tuple[Pid, Pid, float, dict[str, float]]:
    nominal, nominal_count = plants[0], _count_own(plants)
    # Masses that hang below the pitch axis pull every tilt back: held by feed-forward, its gain need not.
    hold = -float(nominal.tilt_A[2, 0]) / nominal.pitch_gain
    acceleration_deg_s2 = min(
        _MOST_TRAVEL_DEG_S2, _PITCH_SHARE * PITCH_SETPOINT_MAX_DEG * nominal.travel_gain
    )
    path = shaped_step(STEP_DEG, TRAVEL_SLEW_DEG_S, acceleration_deg_s2, 10.0, STEP_s)
    after = round(2.0 * np.sqrt(STEP_DEG / acceleration_deg_s2) / STEP_s)
    loads_deg_s2 = _constant_loads_deg_s2(rig, spread)
    unloaded = np.zeros((len(path), len(loads_deg_s2)))
    differential_max_V = _differential_max_V(rig, nominal.hover_V)
    unit = Law(Pid(0.0, 0.0, 0.0, 1.0), Pid(1.0, 0.0, 0.0, 1.0), Pid(1.0, 0.0, 0.0, 1.0))
    bare = [loops.open_loops(plant, unit) for plant in plants]
    to_pitch = np.array([response["pitch"] for response in bare])
    to_travel = np.array([response["differential"] - response["pitch"] for response in bare])

    def pids(numbers: Floats) -> tuple[Pid, Pid, float]:
        return _pid(numbers[0:3], _FILTERS_Hz[1]), _pid(numbers[3:6], _FILTERS_Hz[2]), float(numbers[6])

    def flown(pitch: Pid, travel: Pid, acceleration_ff: float, closed: Floats) -> tuple[Floats, float]:
        """Mean squared error of each plant (deg2): of the step, and of constant loads; the rig's largest
        differential on the step (V).
        """
        given = np.zeros((len(plants), 11, 2 + len(loads_deg_s2)))
        for index, plant in enumerate(plants):
            given[index, :5, 0] = plant.tilt_B * (pitch.kp + hold)
        given[:, 9, 0], given[:, 10, 1] = 1.0, 1.0
        for number, (state, (load_deg_s2, _)) in enumerate(loads_deg_s2.items()):
            given[:, state, 2 + number] = load_deg_s2
        points = sampled(closed, given)
        setpoint = travel.kp * path[:, 0] + travel.kd * path[:, 1] + acceleration_ff * path[:, 2]
        states = points.along(np.column_stack((setpoint, path[:, 0], unloaded)))
        error = states[:, :, 1] - path[:, :1]
        setpoints = np.einsum(
            "tpn,n->tp", states[:, :nominal_count], loops.tilt_output(11, pitch, travel, hold)
        )
        largest_V = float(np.radians(np.abs(setpoints + (pitch.kp + hold) * setpoint[:, None]).max()))
        step = np.mean(error**2, axis=0)
        step = step + _LATE_WEIGHT * np.mean(error[after:] ** 2, axis=0)
        step = step + _OVERSHOOT_WEIGHT * np.maximum(error[after:].max(axis=0), 0.0) ** 2
        corners = Sampled(points.transition[nominal_count:], points.inputs[nominal_count:, :, 2:])
        trimmed = round(_HOVER_s / STEP_s)
        remaining = corners.step_response(trimmed + len(path) // 2)[:, 1, :, trimmed:]
        for number, (_, weight) in enumerate(loads_deg_s2.values()):
            step[nominal_count:] += weight * np.mean(remaining[:, number] ** 2, axis=1)
        return np.asarray(step), largest_V

    def cost(numbers: Floats) -> float:
        pitch, travel, acceleration_ff = pids(numbers)
        closed = np.array([loops.tilt_closed(plant, pitch, travel, hold) for plant in plants])
        slowest_1_s = _slowest_1_s(closed)
        if slowest_1_s > -_DECAY_1_s:
            return _UNSTABLE + slowest_1_s
        inner = pitch.response(loops.FREQUENCY_rad_s) * to_pitch
        forward = pitch.kp + hold + pitch.ki / (1j * loops.FREQUENCY_rad_s)
        outer = travel.response(loops.FREQUENCY_rad_s) * forward * to_travel
        peaks = [
            float(np.max(1.0 / np.abs(1.0 + loop))) for loop in (inner, outer / (1.0 + inner), inner + outer)
        ]
        squares, largest_V = flown(pitch, travel, acceleration_ff, closed)
        beyond = sum(_excess(peak, sensitivity) for peak in peaks) + _excess(largest_V, differential_max_V)
        return _measure(squares, nominal_count) + beyond

    inner_rad_s = _first_guess_rad_s(plants)
    outer_rad_s = inner_rad_s / 2.0
    pitch_kp = (0.5 * inner_rad_s**2 - 0.5 * nominal.tilt_A[2, 0]) / nominal.pitch_gain
    travel_kp = 0.5 * outer_rad_s**2 / nominal.travel_gain
    start = [pitch_kp, 0.2 * pitch_kp, inner_rad_s / nominal.pitch_gain]
    start += [travel_kp, 0.1 * travel_kp, outer_rad_s / nominal.travel_gain, 1.0 / nominal.travel_gain]
    pitch, travel, acceleration_ff = pids(_least(cost, np.array(start)))
    return (
        pitch,
        travel,
        hold,
        {
            "pitch_hold_ff": float(np.radians(hold)),
            "travel_rate_ff": 1.0,
            "travel_acceleration_ff": acceleration_ff,
            "travel_slew_deg_s": TRAVEL_SLEW_DEG_S,
            "travel_acceleration_deg_s2": acceleration_deg_s2,
            "pitch_setpoint_max_deg": PITCH_SETPOINT_MAX_DEG,
            "differential_max_V": differential_max_V,
        },
    )


def _differential_max_V(rig: Rig, hover_V: float) -> float:
    """Most that the voltages may differ by while their sum still holds the arm.

    With more than the hover voltage, one rotor stands still and the other lifts the arm; with more than
    what the stronger one has left, it sinks.
    """
    return max(min(hover_V, _lift_max_V(rig) - hover_V), 0.1 * hover_V)


def _lift_max_V(rig: Rig) -> float:
    """Most that the sum of both voltages may be above the dead zone."""
    return 2.0 * (_motor_max_V(rig) - rig["dead_zone"].value)


def _motor_max_V(rig: Rig) -> float:
    return min(rig["supply"].value, MOTOR_MAX_V)


def _constant_loads_deg_s2(rig: Rig, spread: Spread) -> dict[int, tuple[float, float]]:
    """Accelerations that never stop, and weights, by the plant's state: lopsided rotors, a pull on travel.

    A pull that the rig file states is there in every flight and weighs like what is left of a step; one that
    is only to be reckoned with does not.
    """
    inertia = inertias_kg_m2({name: number.value for name, number in rig.items()})
    lopsided_Nm = spread.rotor * rig["M_f"].value * rig["g"].value * rig["L_h"].value
    stated_rad_s2 = abs(rig["torque_travel"].value) / inertia["J_psi"]
    pull_rad_s2 = max(stated_rad_s2, spread.pull_rad_s2)
    pull_weight = _LATE_WEIGHT if stated_rad_s2 > spread.pull_rad_s2 else 1.0
    loads = {2: (lopsided_Nm / inertia["J_phi"], 1.0), 3: (pull_rad_s2, pull_weight)}
    return {state: (float(np.degrees(load)), weight) for state, (load, weight) in loads.items() if load}


def _pid(gains: Floats, filter_Hz: float) -> Pid:
    return Pid(float(gains[0]), float(gains[1]), float(gains[2]), filter_Hz)


def _count_own(plants: Sequence[LinearPlant]) -> int:
    return sum(plant.thrust == 1.0 and plant.counterweight == 1.0 for plant in plants)


def _first_guess_rad_s(plants: Sequence[LinearPlant]) -> float:
    """Crossover of a double integrator behind the longest lag, by the symmetrical optimum."""
    return 1.0 / (2.2 * (max(plant.lag_s for plant in plants) + 0.03))


def _slowest_1_s(closed: Floats) -> float:
    return float(np.linalg.eigvals(closed).real.max())


def _measure(squares: Floats, own_count: int) -> float:
    """Mean of the logarithms of the squared error of the rig itself and of that of its corners."""
    return float(0.5 * (np.log(squares[:own_count].mean()) + np.log(squares[own_count:].mean())))


def _excess(peak: float, bound: float) -> float:
    return _BOUND_WEIGHT * max(0.0, float(np.log(peak / bound)))


def _least(cost: Callable[[Floats], float], start: Floats) -> Floats:
    """Minimise over positive numbers; started anew until it no longer pays."""
    from scipy.optimize import minimize

    best, best_cost = np.log(start), np.inf
    for spread in (0.4, 0.3, 0.2, 0.2):
        simplex = np.vstack([best, *(best + spread * row for row in np.eye(len(best)))])
        optimum = minimize(
            lambda logs: cost(np.exp(logs)),
            best,
            method="Nelder-Mead",
            options={
                "initial_simplex": simplex,
                "xatol": 3e-3,
                "fatol": 1e-3,
                "maxiter": 300,
                "adaptive": True,
            },
        )
        gained = best_cost - optimum.fun
        best, best_cost = optimum.x, optimum.fun
        if gained < 0.01:
            break
    return np.asarray(np.exp(best), float)
