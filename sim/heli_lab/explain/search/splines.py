"""Spline terms: smooth curves that stand for causes which the catalogue of effects lacks.

A spline term lets a torque, the thrust or a measured angle depend on one quantity as a cubic B-spline. An
effect of the catalogue must predict at least as well as such a curve. If a curve is much better, the
catalogue lacks the cause, and the curve is reported instead.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Effect, Model, Operands
from heli_sim.model.parts import AXES
from heli_sim.model.parts import thrust_N as static_thrust_N
from heli_sim.rig.quantity import Prior, Quantity

from heli_lab.fit.flight_model import model_along
from heli_lab.fit.model_functions import Trajectory

KNOTS: Final = 8
"""Basis functions of a curve: fewer do not follow a kink or bump, more have a higher penalty."""
_TAIL_SHARE: Final = 0.005
"""Share of the flight beyond each end of the curve, where it is constant, so that few samples do not stretch
it."""
# Prior standard deviations of a coefficient: about the torque that holds the arm up, a fifth of the thrust,
# and an encoder error of 1 degree. Smaller: large unlisted effects are not followed. Larger: coefficients
# with few samples diverge.
_TORQUE_STD_Nm: Final = 0.3
_THRUST_STD: Final = 0.2
_ANGLE_STD_rad: Final = 0.02

_UNIT_AND_STD: Final = {
    "torque": ("N m", _TORQUE_STD_Nm),
    "thrust": ("1", _THRUST_STD),
    "measurement": ("rad", _ANGLE_STD_rad),
}
"""Unit and prior standard deviation of a coefficient, by kind of channel."""

_Expression = Callable[[Operands], ca.SX]


def _state(name: str) -> _Expression:
    """Return the expression of a state of the model."""
    return lambda at: at.state[name]


def _static_thrust_N(at: Operands) -> ca.SX:
    """Return the thrusts of front and back rotor that follow from the voltages without any lag, (2, 1)."""
    p = at.parameter
    return static_thrust_N(at.volts_V, p["thrust_gain"], p["dead_zone"], p["reverse_thrust"])


QUANTITIES: Final[Mapping[str, tuple[_Expression, str]]] = {
    "elevation": (_state("elevation_rad"), "rad"),
    "pitch": (_state("pitch_rad"), "rad"),
    "travel": (_state("travel_rad"), "rad"),
    "elevation_rate": (_state("elevation_rate_rad_s"), "rad/s"),
    "pitch_rate": (_state("pitch_rate_rad_s"), "rad/s"),
    "travel_rate": (_state("travel_rate_rad_s"), "rad/s"),
    "thrust": (lambda at: ca.sum1(_static_thrust_N(at)), "N"),
    "thrust_difference": (lambda at: _static_thrust_N(at)[0] - _static_thrust_N(at)[1], "N"),
    "front_thrust": (lambda at: _static_thrust_N(at)[0], "N"),
    "back_thrust": (lambda at: _static_thrust_N(at)[1], "N"),
    "time": (lambda at: at.time_s, "s"),
}
"""Quantities that a spline term may depend on, by name: expression and unit."""

SPLINE_CHANNELS: Final = (
    *(f"torque.{axis}" for axis in AXES),
    *("thrust.both", "thrust.difference"),
    *(f"measurement.{axis}" for axis in AXES),
)
"""Channels on which a spline term may act."""


@dataclass(frozen=True)
class SplineTerm(Effect):
    """Effect of a cubic B-spline: a smooth dependence of one channel on one quantity."""

    channel: str = ""
    """Channel, one of `SPLINE_CHANNELS`: ``torque`` in N m, ``thrust`` as a share, ``measurement`` in rad."""
    on: str = ""  # Quantity, a key of `QUANTITIES`

    @property
    def knots(self) -> tuple[float, float]:
        """Second knot, where the curve begins, and distance of the knots, in the unit of the quantity."""
        return self.values[f"{self.name}_low"], self.values[f"{self.name}_step"]

    def _curve(self, at: Operands) -> ca.SX:
        """Return the value of the curve: the sum of coefficients times basis functions."""
        p = at.parameter
        quantity, _ = QUANTITIES[self.on]
        # Position along the curve in units of the knots' distance; basis function i has its centre at i.
        position = 1.0 + (quantity(at) - p[f"{self.name}_low"]) / p[f"{self.name}_step"]
        position = ca.fmin(ca.fmax(position, 1.0), KNOTS - 2.0)
        return sum((p[f"{self.name}_{i}"] * bspline(position - i) for i in range(KNOTS)), ca.SX(0))

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Torque of the curve about its axis [N m], shape (3, 1); see `Effect.torque_Nm`."""
        kind, channel_axis = self.channel.split(".")
        return ca.vertcat(
            *(self._curve(at) if kind == "torque" and channel_axis == axis else 0 for axis in AXES)
        )

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Thrust scaled by the curve [N], shape (2, 1); see `Effect.thrust_N`."""
        kind, rotors = self.channel.split(".")
        if kind != "thrust":
            return thrust_N
        share = self._curve(at)
        front, back = 1 + share, 1 + share if rotors == "both" else 1 - share
        return thrust_N * ca.vertcat(front, back)

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Measured angles with the curve added [rad], shape (3, 1); see `Effect.measured_rad`."""
        kind, channel_axis = self.channel.split(".")
        if kind != "measurement":
            return angles_rad
        return angles_rad + ca.vertcat(*(self._curve(at) if channel_axis == axis else 0 for axis in AXES))


def bspline(distance: ca.SX) -> ca.SX:
    """Return a cubic B-spline with knots at distance 1 (de Boor 1978), as a function of a `distance`.

    The distance is that from its centre. The value is 2/3 at the centre, and 0 beyond distance 2.
    """
    outer = ca.fmax(2.0 - ca.fabs(distance), 0.0)
    inner = ca.fmax(1.0 - ca.fabs(distance), 0.0)
    return (outer**3 - 4.0 * inner**3) / 6.0


def spline_term(channel: str, on: str, low: float, step: float, number: int = 0) -> SplineTerm:
    """Make a spline term with all coefficients at 0."""
    name = f"spline{number}"
    unit, std = _UNIT_AND_STD[channel.partition(".")[0]]
    _, quantity_unit = QUANTITIES[on]
    coefficients = [Quantity(f"{name}_{i}", unit, f"coefficient {i} of the curve") for i in range(KNOTS)]
    knots = [
        Quantity(f"{name}_low", quantity_unit, "second knot of the curve, where it begins"),
        Quantity(f"{name}_step", quantity_unit, "distance of its knots"),
    ]
    return SplineTerm(
        name,
        parameters=(*coefficients, *knots),
        values={q.name: 0.0 for q in coefficients} | {f"{name}_low": low, f"{name}_step": step},
        priors={q.name: Prior(0.0, std) for q in coefficients},
        channel=channel,
        on=on,
    )


def knot_span(values: Floats) -> tuple[float, float]:
    """Place the knots of a curve over the range of a quantity's `values`, shape (n,)."""
    low, high = np.quantile(values, [_TAIL_SHARE, 1.0 - _TAIL_SHARE])
    step = max(float(high - low), 1e-9) / (KNOTS - 3)
    return float(low), step


def bspline_basis(values: Floats, low: float, step: float) -> Floats:
    """Evaluate the B-spline basis of a curve. Shapes: `values` (n,); returns (n, KNOTS)."""
    position = np.clip(1.0 + (values - low) / step, 1.0, KNOTS - 2.0)
    distance = np.abs(position[:, None] - np.arange(KNOTS))
    basis: Floats = (np.maximum(2.0 - distance, 0.0) ** 3 - 4.0 * np.maximum(1.0 - distance, 0.0) ** 3) / 6.0
    return basis


def quantity_values(model: Model, trajectory: Trajectory) -> dict[str, Floats]:
    """Evaluate all `QUANTITIES` of a `model` along a `trajectory`; shape (n,) each, by name."""

    def quantities(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
        operands = model.operands(x, u, p, t)
        return [ca.vertcat(*(expression(operands) for expression, _ in QUANTITIES.values()))]

    (values,) = model_along(model, quantities)(trajectory)
    return dict(zip(QUANTITIES, values[:, :, 0].T, strict=True))


def channel_quantity_pairs() -> list[tuple[str, str]]:
    """List the spline terms that are tried, as pairs of channel and quantity."""
    return [pair for pair in itertools.product(SPLINE_CHANNELS, QUANTITIES) if _is_testable(*pair)]


def _is_testable(channel: str, quantity: str) -> bool:
    """Whether a dependence of a channel on a quantity would show a cause, and not a property of every log.

    The controller feeds the quantisation error back, so in every log a measured angle depends on thrust. A
    measured angle that depends on the rate of its axis was read late or early. Every log has such a shift of
    up to half a sample.
    """
    _, _, measured_axis = channel.partition("measurement.")
    if not measured_axis:
        return True
    return "thrust" not in quantity and quantity != f"{measured_axis}_rate"
