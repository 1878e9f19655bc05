"""Poles and stability margins of a control law around the linearised rig."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import casadi as ca
import control
import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES, LAW_INPUTS

from heli_lab.control.law import Law
from heli_lab.control.tune.loops import LinearPlant

_BODE_FREQUENCY_rad_s: Final[Floats] = np.geomspace(0.05, 300.0, 4000)
"""Frequencies at which the margins are computed."""


_MIN_DECAY_per_s: Final = 1e-3
"""Slowest decay that counts as stable [1/s]. It takes a quarter of an hour, so that nobody would see it; the
rounding of a pole at 0 is far smaller."""
_UNSEEN: Final = 1e-6
"""Largest share of a mode in angles and rates that counts as none; eigenvectors are rounded at 1e-12."""
_MIN_POLE: Final = 1e-12
"""Magnitude that replaces a smaller one of a discrete pole: such a mode has decayed after one call."""
_PROBE_rad: Final = np.radians(0.2)
_PROBE_rad_s: Final = np.radians(1.0)


@dataclass(frozen=True)
class LinearisedLaw:
    """Poles and stability margins of a law near hover."""

    poles: npt.NDArray[np.complex128]
    """Poles of the closed loop, converted to those of a continuous system [1/s]."""
    gain_up: tuple[float, float]
    """gain_up, phase_deg: Gain margin (largest factor on the gain) and phase margin, at the collective and at
    the differential, with the other loop closed; nan if the closed loop is not stable."""
    phase_deg: tuple[float, float]
    nonlinearity_V: float
    """Largest difference between the law's voltages and the linear law [V], over errors of `_PROBE_rad` and
    `_PROBE_rad_s`. If it is large, poles and margins do not describe the law."""

    @property
    def stable(self) -> bool:
        """Whether all poles decay. A pole at 0, such as that of travel without feedback, does not."""
        return bool((self.poles.real < -_MIN_DECAY_per_s).all())


def linearised(law: Law, plant: LinearPlant) -> LinearisedLaw:
    """Linearise a law at level hover, and close the loop around a linear rig, both at the law's rate."""
    regulator = _linear_regulator(law)
    # The outputs are all states but the last one of each part, the thrust.
    rig = control.append(
        control.ss(plant.elevation_A, plant.elevation_B[:, None], np.eye(2, 3), 0),
        control.ss(plant.tilt_A, plant.tilt_B[:, None], np.eye(4, 5), 0),
    ).sample(law.dt_s)
    # The rig gives elevation, its rate, pitch, travel and their rates; the law takes angles, then rates.
    order = np.eye(6)[[0, 2, 3, 1, 4, 5]]
    measured = order * rig
    loop = regulator * measured
    # The law's slopes include the minus sign of the feedback.
    discrete_poles = _poles_of_motion(control.feedback(measured, regulator, sign=1), law.dt_s)
    # A discrete pole z is that of a continuous system at log(z) / dt. A pole at 0, which a delay gives, has
    # no logarithm.
    log_poles = np.log(np.maximum(np.abs(discrete_poles), _MIN_POLE)) + 1j * np.angle(discrete_poles)
    undefined = (np.nan, np.nan)
    result = LinearisedLaw(
        log_poles / law.dt_s, gain_up=undefined, phase_deg=undefined, nonlinearity_V=_nonlinearity_V(law)
    )
    if not result.stable:
        return result
    collective, differential = _margins(loop, channel=0), _margins(loop, channel=1)
    return replace(
        result,
        gain_up=(collective.gain, differential.gain),
        phase_deg=(collective.phase_deg, differential.phase_deg),
    )


def _poles_of_motion(closed: control.StateSpace, dt_s: float) -> npt.NDArray[np.complex128]:
    """Return the discrete poles of a closed loop without those of states that stay and move no axis, such as
    a clock of the law.
    """
    poles, modes = np.linalg.eig(np.asarray(closed.A))
    seen = np.linalg.norm(np.asarray(closed.C) @ modes, axis=0)
    stays = np.abs(np.abs(poles) - 1.0) < _MIN_DECAY_per_s * dt_s
    return np.asarray(poles[~(stays & (seen < _UNSEEN))])


def _nonlinearity_V(law: Law) -> float:
    """Return the largest difference [V] between a law and its linearisation, at errors of single axes."""
    states = np.array([*law.states.values()], float)
    parameters = np.array([*law.parameters.values()], float)

    def volts_V(inputs: Floats) -> Floats:
        """Evaluate both voltages of the law's first call."""
        return np.asarray(ca.DM(law.function(inputs, states, parameters)[0]), float).ravel()[:2]

    inputs, states_symbol = ca.SX.sym("u", len(LAW_INPUTS)), ca.SX.sym("x", len(law.states))
    outputs, _ = law.function(inputs, states_symbol, ca.DM(parameters))
    slopes = ca.Function("slopes", [inputs, states_symbol], [ca.jacobian(outputs[:2], inputs)])
    level = np.zeros(len(LAW_INPUTS))
    slope_V = np.asarray(ca.DM(slopes(level, states)), float)
    largest_V = 0.0
    for axis in AXES:
        for name, size in ((f"{axis}_rad", _PROBE_rad), (f"{axis}_rad_s", _PROBE_rad_s)):
            for signed_size in (size, -size):
                probe = level.copy()
                probe[LAW_INPUTS.index(name)] = signed_size
                error_V = volts_V(probe) - volts_V(level) - slope_V @ probe
                largest_V = max(largest_V, float(np.max(np.abs(np.nan_to_num(error_V, nan=np.inf)))))
    return largest_V


def _linear_regulator(law: Law) -> control.StateSpace:
    """Linearise a law at its initial states: from three angles and their rates to collective and
    differential, the sum and the difference of the voltages.
    """
    angles = ["elevation_rad", "pitch_rad", "travel_rad"]
    rates = [f"{angle}_s" for angle in angles]
    initial_states = ca.DM([*law.states.values()])
    parameters = ca.DM([*law.parameters.values()])
    inputs, states = ca.SX.sym("u", len(LAW_INPUTS)), ca.SX.sym("x", len(law.states))
    outputs, new_states = law.function(inputs, states, parameters)
    jacobian = ca.Function(
        "j", [inputs, states],
        [ca.jacobian(result, by) for result in (new_states, outputs) for by in (states, inputs)],
    )  # fmt: skip
    A, B, C, D = (np.asarray(ca.DM(matrix)) for matrix in jacobian(np.zeros(len(LAW_INPUTS)), initial_states))
    columns = [LAW_INPUTS.index(name) for name in (*angles, *rates)]
    to_sum_and_difference = np.array([[1.0, 1.0], [1.0, -1.0]])
    return control.ss(
        A, B[:, columns], to_sum_and_difference @ C[:2], to_sum_and_difference @ D[:2][:, columns], law.dt_s
    )


class _ChannelMargins(NamedTuple):
    """Stability margins of one of two loops; infinite if the loop never reaches them."""

    gain: float
    phase_deg: float


def _margins(loop: control.StateSpace, channel: int) -> _ChannelMargins:
    """Compute the margins of a loop at the collective (0) or the differential (1), with the other closed."""
    other_channel = 1 - channel
    A, B, C, D = (np.asarray(matrix) for matrix in (loop.A, loop.B, loop.C, loop.D))
    other_closed_A = A + B[:, [other_channel]] @ C[[other_channel]] / (1.0 - D[other_channel, other_channel])
    single_loop = control.ss(other_closed_A, B[:, [channel]], -C[[channel]], -D[channel, channel], loop.dt)
    response = np.asarray(
        control.frequency_response(single_loop, _BODE_FREQUENCY_rad_s, squeeze=True).complex
    )
    # Phase relative to -180 degrees.
    phase_deg = np.degrees(np.angle(-response))
    crosses_180_below_1 = (
        (np.diff(np.sign(response.imag)) != 0) & (response.real[:-1] < 0.0) & (np.abs(response[:-1]) < 1.0)
    )
    gains = 1.0 / np.abs(response[:-1][crosses_180_below_1])
    gain = float(gains.min()) if crosses_180_below_1.any() else float("inf")
    crosses_1 = np.diff(np.sign(np.abs(response) - 1.0)) != 0
    margin_deg = float(np.abs(phase_deg[:-1][crosses_1]).min()) if crosses_1.any() else float("inf")
    return _ChannelMargins(gain, margin_deg)
