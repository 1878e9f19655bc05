"""The linear plants that one set of gains has to stabilise: the rig and the corners of its uncertainty."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect
from heli_sim.model.effects import RotorLag, RotorSpeedLag
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig

# A rotor without lag is one with a lag too short for any loop here to see: all plants then have the same
# states.
NO_LAG_s: Final = 0.004
# Nonlinear effects, those that happen during a flight, and those that only bias a zero.
_NOT_LINEAR: Final = (
    "backlash",
    "coulomb_friction",
    "encoder_eccentricity",
    "periodic_torque",
    "random_torque",
    "supply_fade",
    "thrust_fade",
    "thrust_step",
    "zero_offset",
)
_LAG_DOUBT: Final = 0.25


@dataclass(frozen=True)
class Spread:
    """How far the rig may be from its numbers.

    Parameters
    ----------
    lag_s : tuple of float
        Lags of the thrust behind the voltage, s.
    thrust : float
        Thrust gain, up and down, as a share.
    counterweight : float
        Mass of the counterweight, up and down, as a share: 3 % halve or nearly double the thrust at hover,
        and with it the pull that tilts travel.
    rotor : float
        Mass of one rotor against the other, as a share: a constant torque on pitch.
    pull_rad_s2 : float
        Acceleration of travel that a constant torque gives; measured rigs show 0.02 to 0.14 rad/s2.
    """

    lag_s: tuple[float, ...] = (0.0, 0.075, 0.15)
    thrust: float = 0.2
    counterweight: float = 0.03
    rotor: float = 0.03
    pull_rad_s2: float = 0.02


@dataclass(frozen=True)
class Known:
    """Effects of a rig as the design of its loops takes them.

    Parameters
    ----------
    lag_s : float or None
        Lag of the rotors; None when no effect states it.
    delay_s : float
        Delay of the voltages.
    linear : tuple of Effect
        Effects that change the linear plant otherwise; one that lags the rotors by a law of its own is among
        them, and takes the plants' lags.
    left_out : tuple of str
        Names of those that no linear plant has: dry friction, backlash, what happens during a flight.
    """

    lag_s: float | None = None
    delay_s: float = 0.0
    linear: tuple[Effect, ...] = ()
    left_out: tuple[str, ...] = ()

    @property
    def spread(self) -> Spread:
        """The usual spread; about a lag that is stated, a quarter of it to either side."""
        if self.lag_s is None:
            return Spread()
        return Spread(lag_s=tuple(share * self.lag_s for share in (1.0 - _LAG_DOUBT, 1.0, 1.0 + _LAG_DOUBT)))


def known_of(effects: Sequence[Effect]) -> Known:
    """Sort effects by what they mean for the loops."""
    lag_s, delay_s = None, 0.0
    linear: list[Effect] = []
    left_out: list[str] = []
    for effect in effects:
        if effect.delay:
            delay_s += effect.values[effect.delay]
        if isinstance(effect, RotorLag | RotorSpeedLag):
            lag_s = (lag_s or 0.0) + effect.lag_s
        if isinstance(effect, RotorSpeedLag):
            linear.append(effect)
        elif effect.delay or isinstance(effect, RotorLag):
            continue
        elif effect.states or effect.name.startswith(_NOT_LINEAR):
            left_out.append(effect.name)
        else:
            linear.append(effect)
    return Known(lag_s, delay_s, tuple(linear), tuple(left_out))


@dataclass(frozen=True)
class LinearPlant:
    """A rig hovering at level, linearised. At level, elevation and the pair pitch and travel are apart.

    Parameters
    ----------
    lag_s, thrust, counterweight : float
        Lag, and the factors on thrust gain and counterweight.
    delay_s : float
        Delay of the voltages. In the matrices it is more lag; in a frequency response it is a delay.
    elevation_A, elevation_B : ndarray (3, 3), (3,)
        States elevation, its rate, thrust of both rotors, or what makes it; input the collective, V.
    tilt_A, tilt_B : ndarray (5, 5), (5,)
        States pitch, travel, their rates, difference of the thrusts, likewise; input the differential, V.
    hover_V : float
        Sum of both voltages above the dead zone.
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
        """Acceleration for each volt of collective once the thrust has followed, rad/s2/V."""
        return float(-self.elevation_A[1, 2] * self.elevation_B[2] / self.elevation_A[2, 2])

    @property
    def pitch_gain(self) -> float:
        """Acceleration for each volt of differential once the thrust has followed, rad/s2/V."""
        return float(-self.tilt_A[2, 4] * self.tilt_B[4] / self.tilt_A[4, 4])

    @property
    def travel_gain(self) -> float:
        """Acceleration of travel for each radian of pitch, rad/s2/rad."""
        return float(self.tilt_A[3, 0])


def linear_plant(
    rig: Rig,
    lag_s: float = 0.0,
    thrust: float = 1.0,
    counterweight: float = 1.0,
    *,
    model: type[Model] = MultibodyModel,
    known: Known | None = None,
) -> LinearPlant:
    """Linearise a rig at level.

    Parameters
    ----------
    lag_s : float
        Lag of the thrust, s.
    thrust : float
        Factor on the thrust gain.
    counterweight : float
        Factor on the mass of the counterweight.
    model : type of Model
        Its equations.
    known : Known, optional
        Its effects; their lag is not looked at.

    Raises
    ------
    PlantError
        When the rig cannot hover, or hovers on so little thrust that its tilt does not move travel.
    """
    known = known if known is not None else Known()
    rig = rig.replace(thrust_gain=thrust * rig["thrust_gain"].value, M_w=counterweight * rig["M_w"].value)
    equations = _equations(model, max(lag_s + known.delay_s, NO_LAG_s), known.linear)
    at = trim(equations, rig)
    first = derivatives(equations, rig, at.state, at.volts_V)
    # The two thrusts as their sum and their difference, the two voltages likewise.
    states = np.eye(8)
    states[6:, 6:] = [[1.0, 1.0], [1.0, -1.0]]
    A = states @ first.A @ np.linalg.inv(states)
    B = states @ first.B @ np.array([[0.5, 0.5], [0.5, -0.5]])
    elevation, tilt = [0, 3, 6], [1, 2, 4, 5, 7]
    hover_V = float(np.sum(at.volts_V) - 2.0 * rig["dead_zone"].value)
    if A[5, 1] <= 0.0:
        raise PlantError(
            f"rig '{rig.name}' hovers on {hover_V:.2f} V of lift, too little to travel by when it tilts",
            "give it less counterweight",
        )
    return LinearPlant(
        lag_s,
        thrust,
        counterweight,
        known.delay_s,
        A[np.ix_(elevation, elevation)],
        B[elevation, 0],
        A[np.ix_(tilt, tilt)],
        B[tilt, 1],
        hover_V,
    )


@functools.lru_cache(maxsize=32)
def _equations(model: type[Model], lag_s: float, linear: tuple[Effect, ...]) -> Model:
    rotors = next((effect for effect in linear if isinstance(effect, RotorSpeedLag)), None)
    lag = RotorLag(lag_s) if rotors is None else rotors.with_lag(lag_s)
    return model((lag, *(effect for effect in linear if effect is not rotors)))


def spread_plants(
    rig: Rig, spread: Spread, *, model: type[Model] = MultibodyModel, known: Known | None = None
) -> Sequence[LinearPlant]:
    """The rig itself at every lag, in the spread's order; then its corners, at every lag, that can fly: a
    counterweight 3 % heavier lifts some arms without any thrust.

    Parameters
    ----------
    spread : Spread
        How far it may be from its numbers.
    model : type of Model
        Its equations.
    known : Known, optional
        Its effects; the lags are the spread's.

    Raises
    ------
    PlantError
        When the rig itself cannot fly.
    """
    corners = itertools.product(
        spread.lag_s,
        (1.0 - spread.thrust, 1.0 + spread.thrust),
        (1.0 - spread.counterweight, 1.0 + spread.counterweight),
    )
    plants = [linear_plant(rig, lag_s, model=model, known=known) for lag_s in spread.lag_s]
    for corner in corners:
        with contextlib.suppress(PlantError):
            plants.append(linear_plant(rig, *corner, model=model, known=known))
    return plants
