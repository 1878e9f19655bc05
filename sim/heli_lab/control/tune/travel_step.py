"""Simulate the travel step and the constant loads by which the gains of pitch and travel are evaluated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.rig import Rig
from heli_sim.rig.inertia import inertias_kg_m2

from heli_lab.control.tune import loops
from heli_lab.control.tune.loops import Pid
from heli_lab.control.tune.objective import count_nominal
from heli_lab.control.tune.plants import LinearPlant, Spread
from heli_lab.control.tune.simulate import DiscretePlants, SIMULATION_STEP_s, discretise

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

    def _discrete_plants(self, pitch: Pid, closed: Floats) -> DiscretePlants:
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

        The error and the overshoot after the setpoint has arrived have additional weights.
        """
        final_deg = error_deg[self.arrival_row :]
        squares = np.mean(error_deg**2, axis=0)
        squares = squares + _FINAL_ERROR_WEIGHT * np.mean(final_deg**2, axis=0)
        return np.asarray(squares + _OVERSHOOT_WEIGHT * np.maximum(final_deg.max(axis=0), 0.0) ** 2)

    def _load_squares(self, plants: DiscretePlants) -> Floats:
        """Compute the weighted mean square of the travel error by the constant loads, shape (corners,).

        The loads begin at time 0. The error counts from `_TRIM_TIME_s` on, when the integrators have
        compensated most of it.
        """
        nominal_count = count_nominal(self.plants)
        corners = DiscretePlants(plants.transition[nominal_count:], plants.inputs[nominal_count:, :, 2:])
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
    """Compute the constant accelerations by unequal rotors, on pitch, and by a torque, on travel.

    A torque on travel that the rig file states acts in every flight, and has the weight of the final error. A
    torque that is only possible has weight 1.
    """
    inertia = inertias_kg_m2({name: number.value for name, number in rig.items()})
    unbalance_Nm = spread.rotor * rig["M_f"].value * rig["g"].value * rig["L_h"].value
    stated_rad_s2 = abs(rig["torque_travel"].value) / inertia["J_psi"]
    pull_rad_s2 = max(stated_rad_s2, spread.pull_rad_s2)
    pull_weight = _FINAL_ERROR_WEIGHT if stated_rad_s2 > spread.pull_rad_s2 else 1.0
    loads = {2: (unbalance_Nm / inertia["J_phi"], 1.0), 3: (pull_rad_s2, pull_weight)}
    return {state: (float(np.degrees(load)), weight) for state, (load, weight) in loads.items() if load}
