"""Thrust against voltage, Fig. 15: a scale under each rotor, and the line (31) through its readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_sim.model.parts import thrust_N
from heli_sim.plant import Plant

from heli_lab.errors import IdentifyError
from heli_lab.paper.bench_tests import SCALE_N

Floats = npt.NDArray[np.float64]


class Scale:
    """A scale under each rotor of a rig that stands still, in steps of a gram."""

    def __init__(self, plant: Plant) -> None:
        model = plant.model
        x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
        at = model.operands(x, u, ca.SX(model.parameter_values(plant.rig)))
        for effect in model.effects:
            at = replace(at, parameter={**at.parameter, **effect.modified_parameters(at)})
        for effect in model.effects:
            at = replace(at, volts_V=effect.voltage_V(at, at.volts_V))
        p = at.parameter
        thrust = thrust_N(at.volts_V, p["thrust_gain"], p["dead_zone"], p["reverse_thrust"])
        for effect in model.effects:
            thrust = effect.thrust_N(replace(at, thrust_N=thrust), thrust)
        self._thrust_N = ca.Function("thrust_N", [x, u], [thrust])

    def read_N(self, state: Floats, volts_V: Sequence[float]) -> Floats:
        """Read the thrust of the front and the back rotor [N], shape (2,), rounded to the scale's step, in a
        `state` of the plant, shape (n,), with front and back voltage `volts_V` acting.
        """
        exact = np.asarray(self._thrust_N(state, np.asarray(volts_V))).ravel()
        result: Floats = np.round(exact / SCALE_N) * SCALE_N
        return result


@dataclass(frozen=True)
class Line:
    """Thrust = gain (V - dead zone).

    Parameters
    ----------
    gain_N_per_V, gain_half : float
        Slope, and half its 95 % interval.
    dead_zone_V, dead_zone_half : float
        Voltage at which the line is zero, and half its 95 % interval.
    """

    gain_N_per_V: float
    gain_half: float
    dead_zone_V: float
    dead_zone_half: float


@dataclass(frozen=True)
class ThrustCurve:
    """Readings of a thrust stand: `thrust_N` of the front and the back rotor at `volts_V`, both
    shape (n, 2).
    """

    volts_V: Floats
    thrust_N: Floats

    def line(self) -> Line:
        """Fit the straight line to the readings above zero, with intervals from the scatter of the readings,
        or from the scale's step where that is larger; fewer than three are an IdentifyError.
        """
        above = self.thrust_N > 0.0
        volts, thrust = self.volts_V[above], self.thrust_N[above]
        if volts.size < 3:
            raise IdentifyError("the rotors give no thrust", "look at thrust_gain and dead_zone of the rig")
        design = np.column_stack((volts, np.ones_like(volts)))
        (slope, constant), *_ = np.linalg.lstsq(design, thrust, rcond=None)
        scatter = np.std(thrust - design @ (slope, constant), ddof=2)
        noise_N = max(float(scatter), SCALE_N / np.sqrt(12.0))
        covariance = noise_N**2 * np.linalg.inv(design.T @ design)
        zero = -constant / slope
        to_zero = np.array([-zero / slope, -1.0 / slope])
        return Line(
            float(slope),
            2.0 * float(np.sqrt(covariance[0, 0])),
            float(zero),
            2.0 * float(np.sqrt(to_zero @ covariance @ to_zero)),
        )
