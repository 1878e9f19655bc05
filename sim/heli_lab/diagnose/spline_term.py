"""Patterns: what a candidate has to beat, and what is reported when none of the catalogue does.

A pattern says no more than that a torque, the thrust or a measured angle depends on one quantity, as a smooth
curve through a few points. A named cause that explains the flight must do at least as well as such a curve on
any quantity; where a curve does much better, the cause is none of the catalogue's.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_sim.model.base import Effect, Model, Operands
from heli_sim.model.parts import AXES
from heli_sim.model.parts import thrust_N as static_thrust_N
from heli_sim.rig.quantity import Prior, Quantity

from heli_lab.diagnose.linearisation import MapEvaluator, Path
from heli_lab.identify.functions import Floats

KNOTS: Final = 8
"""Points of a curve: enough for a bump or a kink, few enough to be paid for."""
_EDGE: Final = 0.005
"""Share of the flight that may lie beyond each end of the curve."""
_TORQUE_Nm: Final = 0.3
_SHARE: Final = 0.2
_ANGLE_rad: Final = 0.02

_UNITS: Final = {
    "torque": ("N m", _TORQUE_Nm),
    "thrust": ("1", _SHARE),
    "measurement": ("rad", _ANGLE_rad),
}

_Look = Callable[[Operands], ca.SX]


def _state(name: str) -> _Look:
    return lambda at: at.state[name]


def _static(at: Operands) -> ca.SX:
    p = at.parameter
    return static_thrust_N(at.volts_V, p["thrust_gain"], p["dead_zone"], p["reverse_thrust"])


QUANTITIES: Final[Mapping[str, tuple[_Look, str]]] = {
    "elevation": (_state("elevation_rad"), "rad"),
    "pitch": (_state("pitch_rad"), "rad"),
    "travel": (_state("travel_rad"), "rad"),
    "elevation_rate": (_state("elevation_rate_rad_s"), "rad/s"),
    "pitch_rate": (_state("pitch_rate_rad_s"), "rad/s"),
    "travel_rate": (_state("travel_rate_rad_s"), "rad/s"),
    "thrust": (lambda at: ca.sum1(_static(at)), "N"),
    "thrust_difference": (lambda at: _static(at)[0] - _static(at)[1], "N"),
    "front_thrust": (lambda at: _static(at)[0], "N"),
    "back_thrust": (lambda at: _static(at)[1], "N"),
    "time": (lambda at: at.time_s, "s"),
}
"""What a pattern may depend on: how to compute it, and its unit."""

CHANNELS: Final = (
    *(f"torque.{axis}" for axis in AXES),
    *("thrust.both", "thrust.difference"),
    *(f"measurement.{axis}" for axis in AXES),
)
"""Where a pattern may act."""


@dataclass(frozen=True)
class SplineTerm(Effect):
    """A smooth dependence of one channel on one quantity.

    Parameters
    ----------
    name, parameters, values, states, priors, delay, stage, noise_inputs, measured_as, multimodal
        As of `Effect`; `spline_term` makes them.
    channel : str
        One of `CHANNELS`; ``torque`` in N m, ``thrust`` as a share of itself, ``measurement`` in rad.
    on : str
        One of `QUANTITIES`.
    """

    channel: str = ""
    on: str = ""

    def _curve(self, at: Operands) -> ca.SX:
        p = at.parameter
        place = 1.0 + (QUANTITIES[self.on][0](at) - p[f"{self.name}_low"]) / p[f"{self.name}_step"]
        place = ca.fmin(ca.fmax(place, 1.0), KNOTS - 2.0)
        return sum((p[f"{self.name}_{i}"] * bspline(place - i) for i in range(KNOTS)), ca.SX(0))

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Add the curve to its axis; see `Effect.torque_Nm`.

        Parameters
        ----------
        at : Operands
            Present state, voltages and parameters.

        Returns
        -------
        casadi.SX
            Torques in N m, shape (3, 1).
        """
        kind, where = self.channel.split(".")
        return ca.vertcat(*(self._curve(at) if kind == "torque" and where == axis else 0 for axis in AXES))

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Change the thrust by the curve's share; see `Effect.thrust_N`.

        Parameters
        ----------
        at : Operands
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Thrust before, shape (2, 1).

        Returns
        -------
        casadi.SX
            Thrust with the pattern, shape (2, 1).
        """
        kind, where = self.channel.split(".")
        if kind != "thrust":
            return thrust_N
        share = self._curve(at)
        return thrust_N * ca.vertcat(1 + share, 1 + share if where == "both" else 1 - share)

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Add the curve to what its encoder shows; see `Effect.measured_rad`.

        Parameters
        ----------
        at : Operands
            Present state, voltages and parameters.
        angles_rad : casadi.SX
            Angles before, shape (3, 1).

        Returns
        -------
        casadi.SX
            Angles with the pattern, shape (3, 1).
        """
        kind, where = self.channel.split(".")
        if kind != "measurement":
            return angles_rad
        return angles_rad + ca.vertcat(*(self._curve(at) if where == axis else 0 for axis in AXES))


def bspline(distance: ca.SX) -> ca.SX:
    """Cubic B-spline over points at distance 1.

    Parameters
    ----------
    distance : casadi.SX
        Distance from the point.

    Returns
    -------
    casadi.SX
        2/3 at the point, 0 from distance 2 on.
    """
    far = ca.fmax(2.0 - ca.fabs(distance), 0.0)
    near = ca.fmax(1.0 - ca.fabs(distance), 0.0)
    return (far**3 - 4.0 * near**3) / 6.0


def spline_term(channel: str, on: str, low: float, step: float, number: int = 0) -> SplineTerm:
    """Make a pattern that does nothing yet.

    Parameters
    ----------
    channel : str
        One of `CHANNELS`.
    on : str
        One of `QUANTITIES`.
    low, step : float
        Where the curve begins, which is at its second point, and distance of the points.
    number : int
        Tells patterns of one model apart.

    Returns
    -------
    SplineTerm
        With all points at 0, and priors that let them be found.
    """
    name = f"pattern{number}"
    unit, std = _UNITS[channel.partition(".")[0]]
    points = [Quantity(f"{name}_{i}", unit, f"point {i} of the curve") for i in range(KNOTS)]
    span = [
        Quantity(f"{name}_low", QUANTITIES[on][1], "second point of the curve, where it begins"),
        Quantity(f"{name}_step", QUANTITIES[on][1], "distance of its points"),
    ]
    return SplineTerm(
        name,
        parameters=(*points, *span),
        values={q.name: 0.0 for q in points} | {f"{name}_low": low, f"{name}_step": step},
        priors={q.name: Prior(0.0, std) for q in points},
        channel=channel,
        on=on,
    )


def span_of(values: Floats) -> tuple[float, float]:
    """Lay the points of a curve over the values that a flight has.

    Parameters
    ----------
    values : ndarray (n,)
        Values of the quantity.

    Returns
    -------
    low, step : float
        Second point, and distance of the points.
    """
    low, high = np.quantile(values, [_EDGE, 1.0 - _EDGE])
    step = max(float(high - low), 1e-9) / (KNOTS - 3)
    return float(low), step


def bspline_basis(values: Floats, low: float, step: float) -> Floats:
    """How much each point of a curve counts at each value.

    Parameters
    ----------
    values : ndarray (n,)
        Values of the quantity.
    low, step : float
        As `span_of` gives them.

    Returns
    -------
    ndarray (n, KNOTS)
        They sum to 1.
    """
    place = np.clip(1.0 + (values - low) / step, 1.0, KNOTS - 2.0)
    distance = np.abs(place[:, None] - np.arange(KNOTS))
    result: Floats = (np.maximum(2.0 - distance, 0.0) ** 3 - 4.0 * np.maximum(1.0 - distance, 0.0) ** 3) / 6.0
    return result


def quantity_values(model: Model, path: Path) -> dict[str, Floats]:
    """Values of every quantity along a flight.

    Parameters
    ----------
    model : Model
        The model.
    path : Path
        The predicted flight.

    Returns
    -------
    dict of ndarray (n,)
        By name, in the order of `QUANTITIES`.
    """
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
    at = model.operands(x, u, p, t)
    values = ca.vertcat(*(evaluation(at) for evaluation, _ in QUANTITIES.values()))
    (result,) = MapEvaluator(ca.Function("quantities", [x, u, t, p], [ca.densify(values)]), len(path.t_s))(
        path
    )
    return dict(zip(QUANTITIES, result[:, :, 0].T, strict=True))


def choices() -> list[tuple[str, str]]:
    """Every pattern that is tried.

    Returns
    -------
    list of (str, str)
        Channel and quantity.
    """
    # The controller answers to the rounding of the angles, so voltages go with the rounding's errors in any
    # flight: a measurement that depends on thrust would always be found.
    return [
        (channel, on)
        for channel, on in itertools.product(CHANNELS, QUANTITIES)
        if not (channel.startswith("measurement") and "thrust" in on)
    ]


def named(candidate: str) -> str:
    """Name a trial for people.

    Parameters
    ----------
    candidate : str
        Id of a trial.

    Returns
    -------
    str
        ``a curve: CHANNEL on QUANTITY`` for a pattern; an effect's id as it is.
    """
    kind, _, rest = candidate.partition(":")
    return f"a curve: {rest.replace(':', ' on ')}" if kind == "pattern" else candidate
