"""Poles and stability margins of a control law around the linearised rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import casadi as ca
import control
import numpy as np
import numpy.typing as npt
from heli_host.arrays import Floats
from heli_host.declaration import LAW_INPUTS

from heli_lab.law.law import Law
from heli_lab.tune.plants import LinearPlant

BODE_FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.05, 300.0, 4000)


@dataclass(frozen=True)
class LinearisedLaw:
    """Poles and stability margins of a law near hover.

    Parameters
    ----------
    poles : ndarray of complex
        Poles of the closed loop, converted to those of a continuous system [1/s].
    gain_up, phase_deg : tuple of float
        Margins at the collective and at the differential, the other loop closed.
    """

    poles: npt.NDArray[np.complex128]
    gain_up: tuple[float, float]
    phase_deg: tuple[float, float]

    @property
    def stable(self) -> bool:
        """Whether all poles decay."""
        return bool((self.poles.real < 1e-3).all())


def linearised(law: Law, plant: LinearPlant) -> LinearisedLaw:
    """Linearise a law at level hover, and close the loop around a linear rig, both at the law's rate.

    Parameters
    ----------
    law : Law
        What flies.
    """
    angles = ["elevation_rad", "pitch_rad", "travel_rad"]
    rates = [f"{angle}_s" for angle in angles]
    x0 = ca.DM([*law.states.values()])
    p0 = ca.DM([*law.parameters.values()])
    u0 = np.zeros(len(LAW_INPUTS))
    inputs, states = ca.SX.sym("u", len(LAW_INPUTS)), ca.SX.sym("x", len(law.states))
    outputs, new = law.function(inputs, states, p0)
    jacobian = ca.Function(
        "j", [inputs, states],
        [ca.jacobian(given, by) for given in (new, outputs) for by in (states, inputs)],
    )  # fmt: skip
    A, B, C, D = (np.asarray(ca.DM(matrix)) for matrix in jacobian(u0, x0))
    columns = [LAW_INPUTS.index(name) for name in (*angles, *rates)]
    mix = np.array([[1.0, 1.0], [1.0, -1.0]])
    regulator = control.ss(A, B[:, columns], mix @ C[:2], mix @ D[:2][:, columns], law.dt_s)
    rig = control.append(
        control.ss(plant.elevation_A, plant.elevation_B[:, None], np.eye(2, 3), 0),
        control.ss(plant.tilt_A, plant.tilt_B[:, None], np.eye(4, 5), 0),
    ).sample(law.dt_s)
    # Elevation, its rate; pitch, travel, their rates: into the order of the law's inputs.
    order = np.eye(6)[[0, 2, 3, 1, 4, 5]]
    loop = regulator * (order * rig)
    closed = control.feedback(loop, control.ss([], [], [], np.eye(2), law.dt_s), sign=1)
    poles = np.log(np.maximum(np.abs(closed.poles()), 1e-12)) + 1j * np.angle(closed.poles())
    (gain_up, phase_deg), (other_gain_up, other_phase_deg) = (_margins(loop, motor) for motor in (0, 1))
    return LinearisedLaw(poles / law.dt_s, (gain_up, other_gain_up), (phase_deg, other_phase_deg))


def _margins(loop: control.StateSpace, motor: int) -> tuple[float, float]:
    """Gain and phase margin at one input, the other loop closed."""
    other = 1 - motor
    A, B, C, D = (np.asarray(matrix) for matrix in (loop.A, loop.B, loop.C, loop.D))
    around = A + B[:, [other]] @ C[[other]] / (1.0 - D[other, other])
    alone = control.ss(around, B[:, [motor]], -C[[motor]], -D[motor, motor], loop.dt)
    response = np.asarray(control.frequency_response(alone, BODE_FREQUENCY_rad_s, squeeze=True).complex)
    phase_deg = np.degrees(np.angle(-response))  # from -180 degrees
    turns = (
        (np.diff(np.sign(response.imag)) != 0) & (response.real[:-1] < 0.0) & (np.abs(response[:-1]) < 1.0)
    )
    gain = float((1.0 / np.abs(response[:-1][turns])).min()) if turns.any() else float("inf")
    crosses = np.diff(np.sign(np.abs(response) - 1.0)) != 0
    margin = float(np.abs(phase_deg[:-1][crosses]).min()) if crosses.any() else float("inf")
    return gain, margin
