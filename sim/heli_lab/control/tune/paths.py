"""Simulate many linear plants together along the board's shaped paths, by which a design is evaluated."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.rig import Rig
from heli_sim.rig.schema import inertias_kg_m2

from heli_lab.control.tune import loops
from heli_lab.control.tune.loops import LinearPlant, Pid, Spread, count_nominal
from heli_lab.state_space import matrix_exponentials

_TICK_s: Final = 0.001
_APPROACH_RATE: Final = 0.01
"""Share of the remaining distance per tick at the end of the path."""
_SMOOTHING: Final = 0.01
"""Coefficient per tick of the low-pass filter of the acceleration feed-forward."""


def shaped_step(
    distance: float, slew: float, acceleration: float, duration_s: float, every_s: float
) -> Floats:
    """Return the shaped setpoint after a step of the target, as the board computes it. Returns shape (n,
    3): setpoint, rate and smoothed acceleration, in the unit of `distance` and seconds.
    """
    # Mirrors `Setpoints::follow` in firmware/core/flight/setpoints.cpp, for a target that does not move.
    # All changes are per tick: `step` of the setpoint, `change` of the step.
    max_step, max_change = slew * _TICK_s, acceleration * _TICK_s**2
    setpoint = step = smooth_change = 0.0
    rows = np.empty((round(duration_s / _TICK_s), 3))
    approach_distance = max_change / _APPROACH_RATE**2
    for row in rows:
        row[:] = setpoint, step / _TICK_s, smooth_change / _TICK_s**2
        remaining = abs(distance - setpoint)
        # Near its end, the path approaches the target exponentially. Before that, it brakes evenly; the half
        # gives both the same speed where they meet.
        fastest_step = (
            remaining * _APPROACH_RATE
            if remaining <= approach_distance
            else math.sqrt(2.0 * max_change * (remaining - 0.5 * approach_distance))
        )
        target_step = math.copysign(min(fastest_step, max_step), distance - setpoint)
        change = max(-max_change, min(max_change, target_step - step))
        step += change
        setpoint += step
        smooth_change += _SMOOTHING * (change - smooth_change)
    return rows[:: round(every_s / _TICK_s)]


SIMULATION_STEP_s: Final = 0.04
"""Time between two points of a path; inputs are constant in between."""
_BLOCK: Final = 16
"""Points per block. All blocks are simulated together, from rest; then the final state of each block is
carried over to the next. 250 points take 32 steps in Python instead of 250."""


@dataclass(frozen=True)
class _DiscretePlants:
    """Linear plants in discrete time, with inputs constant over a step of `SIMULATION_STEP_s`."""

    transition: Floats  # (plants, n, n): State transition matrices over one step
    inputs: Floats  # (plants, n, m): Input matrices over one step

    def simulate(self, inputs: Floats) -> Floats:
        """Simulate all plants from rest, and return the states, shape (times, plants, n). Shapes: `inputs`
        (times, m).
        """
        count, size = self.transition.shape[:2]
        blocks = math.ceil(len(inputs) / _BLOCK)
        # Zeros fill the last block.
        padded = np.zeros((blocks * _BLOCK, inputs.shape[1]))
        padded[: len(inputs)] = inputs
        # Indices: plant p, state n, input m, block b, point k of a block.
        forced = np.einsum("pnm,bkm->kpnb", self.inputs, padded.reshape(blocks, _BLOCK, -1))
        # First from rest: states of each block, and powers of the transition matrix.
        states = np.zeros((_BLOCK + 1, count, size, blocks))
        powers = np.empty((_BLOCK + 1, count, size, size))
        powers[0] = np.eye(size)
        for index in range(_BLOCK):
            states[index + 1] = self.transition @ states[index] + forced[index]
            powers[index + 1] = self.transition @ powers[index]
        # Then the state at the beginning of each block, from block to block.
        initial = np.empty((count, size, blocks))
        state = np.zeros((count, size, 1))
        for block in range(blocks):
            initial[:, :, block] = state[:, :, 0]
            state = powers[_BLOCK] @ state + states[_BLOCK, :, :, block, None]
        states = states[:_BLOCK] + powers[:_BLOCK] @ initial
        # From the order k, p, n, b to b, k, p, n: points in the order of time.
        return states.transpose(3, 0, 1, 2).reshape(-1, count, size)[: len(inputs)]

    def step_response(self, times: int) -> Floats:
        """Return the zero-state response to a unit step of each input, shape (plants, n, m, times)."""
        count, size, width = self.inputs.shape
        # Doubling: the response after 2 m steps is that after m steps, propagated by m steps, plus itself.
        response, power = self.inputs[..., None], self.transition
        while response.shape[3] < times:
            later = power @ response.reshape(count, size, width * response.shape[3])
            later = later.reshape(response.shape) + response[..., -1:]
            response, power = np.concatenate((response, later), axis=3), power @ power
        initial = np.zeros((count, size, width, 1))
        return np.concatenate((initial, response), axis=3)[..., :times]


def discretise(closed: Floats, input_matrices: Floats) -> _DiscretePlants:
    """Discretise plants exactly for inputs that are constant over a step. Shapes: `closed` (plants, n, n),
    `input_matrices` (plants, n, m).
    """
    count, size, width = input_matrices.shape
    augmented = np.zeros((count, size + width, size + width))
    augmented[:, :size, :size], augmented[:, :size, size:] = closed, input_matrices
    step = matrix_exponentials(augmented * SIMULATION_STEP_s)
    return _DiscretePlants(step[:, :size, :size], step[:, :size, size:])


_TRIM_TIME_s: Final = 8.0
"""Time before a travel step [s], in which the integrators compensate constant loads."""
_OVERSHOOT_WEIGHT: Final = 0.5
"""Weight of the squared overshoot."""
_FINAL_ERROR_WEIGHT: Final = 30.0
"""Weight of the squared error after the end of the path, by which users judge a step."""


@dataclass(frozen=True)
class TravelStep:
    """Travel step and constant loads, by which the gains of pitch and travel are evaluated."""

    plants: Sequence[LinearPlant]  # The rig at each lag, then the corners of its spread
    pitch_hold: float  # Feed-forward of the pitch setpoint [V/rad]
    path: Floats  # (n, 3): Setpoint of travel with its first and second derivative, in degrees and seconds
    arrival_row: int  # Row of the path at which the setpoint has arrived
    loads_deg_s2: Mapping[int, tuple[float, float]]
    """Constant acceleration [deg/s^2] and weight of its effect, by number of the state."""

    def simulate(
        self, pitch: Pid, travel: Pid, acceleration_ff: float, closed: Floats
    ) -> tuple[Floats, float]:
        """Simulate the step on all plants, and the loads on the corners. Shapes: `closed` (plants, 11, 11);
        returns `squares` (plants,).
        """
        plants = self._discrete_plants(pitch, closed)
        setpoint_deg = self.path @ np.array([travel.kp, travel.kd, acceleration_ff])
        unloaded = np.zeros((len(self.path), len(self.loads_deg_s2)))
        states = plants.simulate(np.column_stack((setpoint_deg, self.path[:, 0], unloaded)))
        squares = self._step_squares(states[:, :, 1] - self.path[:, :1])
        squares[count_nominal(self.plants) :] += self._load_squares(plants)
        return squares, self._largest_differential_V(states, setpoint_deg, pitch, travel)

    def _discrete_plants(self, pitch: Pid, closed: Floats) -> _DiscretePlants:
        """Discretise the closed loops; their inputs are pitch setpoint, travel setpoint, then each load."""
        input_matrices = np.zeros((len(self.plants), loops.TILT_STATES, 2 + len(self.loads_deg_s2)))
        # The pitch setpoint acts on the voltage, at the first five states, and on the integral of its error.
        for index, plant in enumerate(self.plants):
            input_matrices[index, :5, 0] = plant.tilt_B * (pitch.kp + self.pitch_hold)
        input_matrices[:, loops.PITCH_INTEGRAL, 0] = 1.0
        # The travel setpoint acts on the integral; its other actions are part of the pitch setpoint.
        input_matrices[:, loops.TRAVEL_INTEGRAL, 1] = 1.0
        for number, (state, (load_deg_s2, _)) in enumerate(self.loads_deg_s2.items()):
            input_matrices[:, state, 2 + number] = load_deg_s2
        return discretise(closed, input_matrices)

    def _step_squares(self, error_deg: Floats) -> Floats:
        """Compute the weighted mean square of the travel error during the step, shape (plants,). Shapes:
        `error_deg` (times, plants).
        """
        final_deg = error_deg[self.arrival_row :]
        squares = np.mean(error_deg**2, axis=0)
        squares = squares + _FINAL_ERROR_WEIGHT * np.mean(final_deg**2, axis=0)
        return np.asarray(squares + _OVERSHOOT_WEIGHT * np.maximum(final_deg.max(axis=0), 0.0) ** 2)

    def _load_squares(self, plants: _DiscretePlants) -> Floats:
        """Compute the weighted mean square of the travel error by the constant loads, shape (corners,)."""
        # The loads begin at time 0. The error counts from `_TRIM_TIME_s` on, when the integrators have
        # compensated most of it.
        nominal_count = count_nominal(self.plants)
        corners = _DiscretePlants(plants.transition[nominal_count:], plants.inputs[nominal_count:, :, 2:])
        trim_row = round(_TRIM_TIME_s / SIMULATION_STEP_s)
        # Shape (corners, states, loads, times); state 1 is travel.
        response_deg = corners.step_response(trim_row + len(self.path) // 2)
        travel_error_deg = response_deg[:, 1, :, trim_row:]
        squares = np.zeros(len(corners.transition))
        for number, (_, weight) in enumerate(self.loads_deg_s2.values()):
            squares += weight * np.mean(travel_error_deg[:, number] ** 2, axis=1)
        return squares

    def _largest_differential_V(self, states: Floats, setpoint_deg: Floats, pitch: Pid, travel: Pid) -> float:
        """Compute the largest differential voltage of the nominal plants during the step [V]."""
        nominal = states[:, : count_nominal(self.plants)]
        output_row = loops.tilt_output(pitch, travel, self.pitch_hold)
        # Indices: time t, plant p, state n.
        feedback = np.einsum("tpn,n->tp", nominal, output_row)
        differential = feedback + (pitch.kp + self.pitch_hold) * setpoint_deg[:, None]
        return float(np.radians(np.abs(differential).max()))


def constant_loads_deg_s2(rig: Rig, spread: Spread) -> dict[int, tuple[float, float]]:
    """Compute the constant accelerations by unequal rotors, on pitch, and by a torque, on travel."""
    # A torque on travel that the rig file states acts in every flight, and has the weight of the final error.
    # A torque that is only possible has weight 1.
    inertia = inertias_kg_m2({name: number.value for name, number in rig.items()})
    unbalance_Nm = spread.rotor * rig["M_f"].value * rig["g"].value * rig["L_h"].value
    stated_rad_s2 = abs(rig["torque_travel"].value) / inertia["J_psi"]
    pull_rad_s2 = max(stated_rad_s2, spread.pull_rad_s2)
    pull_weight = _FINAL_ERROR_WEIGHT if stated_rad_s2 > spread.pull_rad_s2 else 1.0
    loads = {2: (unbalance_Nm / inertia["J_phi"], 1.0), 3: (pull_rad_s2, pull_weight)}
    return {state: (float(np.degrees(load)), weight) for state, (load, weight) in loads.items() if load}
