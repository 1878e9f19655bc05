"""Linearise a rig and the corners of its uncertainty, which one set of gains must stabilise."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect
from heli_sim.model.effects import RotorLag, RotorSpeedLag
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig

NO_LAG_s: Final = 0.004
"""Lag of a rotor without lag: too short to matter for any loop, so that all plants have the same states."""
_LAG_UNCERTAINTY: Final = 0.25
"""Uncertainty of a stated lag, as a share of it."""


@dataclass(frozen=True)
class Spread:
    """Uncertainty of a rig's parameters for which the gains must work.

    Parameters
    ----------
    lag_s : tuple of float
        Lags from voltage to thrust [s].
    thrust : float
        Relative uncertainty of the thrust gain, in both directions.
    counterweight : float
        Relative uncertainty of the counterweight's mass, in both directions. 3 % halve or nearly double the
        thrust at hover, and with it the gain from pitch to travel.
    rotor : float
        Relative difference between the rotors' masses, which causes a constant torque on pitch.
    pull_rad_s2 : float
        Acceleration of travel by a constant torque [rad/s^2]; measured rigs have 0.02 to 0.14 rad/s^2.
    """

    lag_s: tuple[float, ...] = (0.0, 0.075, 0.15)
    thrust: float = 0.2
    counterweight: float = 0.03
    rotor: float = 0.03
    pull_rad_s2: float = 0.02


@dataclass(frozen=True)
class LoopEffects:
    """Effects of a rig, sorted by their role in the design of the loops.

    Parameters
    ----------
    lag_s : float or None
        Lag of the rotors [s]; None if no effect states one.
    delay_s : float
        Delay of the voltages [s].
    linear : tuple of Effect
        Other effects in the linear plants, including a lag of the rotor speed, which uses the plants' lags.
    excluded : tuple of str
        Names of effects that the linear plants do not contain: those with states, and those that are not
        `heli_sim.model.effects.EffectSpec.linearisable`, such as dry friction or a change during the flight.
    """

    lag_s: float | None = None
    delay_s: float = 0.0
    linear: tuple[Effect, ...] = ()
    excluded: tuple[str, ...] = ()

    @property
    def spread(self) -> Spread:
        """Default spread; with a stated lag, the lags are that lag and a quarter less and more."""
        if self.lag_s is None:
            return Spread()
        return Spread(
            lag_s=tuple(share * self.lag_s for share in (1.0 - _LAG_UNCERTAINTY, 1.0, 1.0 + _LAG_UNCERTAINTY))
        )


def loop_effects_of(effects: Sequence[Effect]) -> LoopEffects:
    """Sort effects by their role in the design of the loops."""
    lags_s = [effect.lag_s for effect in effects if isinstance(effect, RotorLag | RotorSpeedLag)]
    delay_s = sum((effect.values[effect.delay] for effect in effects if effect.delay), start=0.0)
    linear, excluded = [], []
    for effect in effects:
        # A delay, and a lag of the thrust, are stated by the numbers above.
        is_stated_by_number = bool(effect.delay) or isinstance(effect, RotorLag)
        is_linear = effect.linearisable and not effect.states
        if isinstance(effect, RotorSpeedLag) or (is_linear and not effect.delay):
            linear.append(effect)
        elif not is_stated_by_number:
            excluded.append(effect.name)
    return LoopEffects(
        lag_s=sum(lags_s) if lags_s else None,
        delay_s=delay_s,
        linear=tuple(linear),
        excluded=tuple(excluded),
    )


@dataclass(frozen=True)
class LinearPlant:
    """Rig linearised at level hover, where elevation decouples from pitch and travel.

    Parameters
    ----------
    lag_s, thrust, counterweight : float
        Lag [s], and the factors on thrust gain and counterweight mass.
    delay_s : float
        Delay of the voltages [s]. The matrices approximate it by additional lag, frequency responses are
        exact.
    elevation_A, elevation_B : ndarray (3, 3), (3,)
        State and input matrix. States: elevation, its rate, sum of the thrusts or of the rotors' states.
        Input: the collective [V].
    tilt_A, tilt_B : ndarray (5, 5), (5,)
        State and input matrix. States: pitch, travel, their rates, difference of the thrusts or of the
        rotors' states. Input: the differential [V].
    hover_V : float
        Sum of both voltages at hover, above the dead zone [V].
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
        """Elevation acceleration per volt of collective, after the rotors' lag [rad/s^2/V]."""
        return float(-self.elevation_A[1, 2] * self.elevation_B[2] / self.elevation_A[2, 2])

    @property
    def pitch_gain(self) -> float:
        """Pitch acceleration per volt of differential, after the rotors' lag [rad/s^2/V]."""
        return float(-self.tilt_A[2, 4] * self.tilt_B[4] / self.tilt_A[4, 4])

    @property
    def travel_gain(self) -> float:
        """Travel acceleration per radian of pitch [1/s^2]."""
        return float(self.tilt_A[3, 0])


def linear_plant(
    rig: Rig,
    lag_s: float = 0.0,
    thrust: float = 1.0,
    counterweight: float = 1.0,
    *,
    model: type[Model] = MultibodyModel,
    loop_effects: LoopEffects | None = None,
) -> LinearPlant:
    """Linearise a rig at level hover.

    Parameters
    ----------
    lag_s : float
        Lag from voltage to thrust [s].
    thrust : float
        Factor on the thrust gain.
    counterweight : float
        Factor on the mass of the counterweight.
    model : type of Model
        Equations of motion.
    loop_effects : LoopEffects, optional
        Effects of the rig. Their lag is ignored; `lag_s` is used instead.

    Raises
    ------
    PlantError
        When the rig cannot hover, or needs so little thrust to hover that a tilt does not move travel.
    """
    loop_effects = loop_effects if loop_effects is not None else LoopEffects()
    rig = rig.replace(thrust_gain=thrust * rig["thrust_gain"].value, M_w=counterweight * rig["M_w"].value)
    equations = _model_with_lag(model, max(lag_s + loop_effects.delay_s, NO_LAG_s), loop_effects.linear)
    hover = trim(equations, rig)
    linear = derivatives(equations, rig, hover.state, hover.volts_V)
    # Transform the two thrusts, and the two voltages, to their sum and their difference.
    transform = np.eye(8)
    transform[6:, 6:] = [[1.0, 1.0], [1.0, -1.0]]
    A = transform @ linear.A @ np.linalg.inv(transform)
    B = transform @ linear.B @ np.array([[0.5, 0.5], [0.5, -0.5]])
    # The states are elevation, pitch, travel, their rates, and sum and difference of the thrusts.
    elevation, tilt = [0, 3, 6], [1, 2, 4, 5, 7]
    hover_V = float(np.sum(hover.volts_V) - 2.0 * rig["dead_zone"].value)
    if A[5, 1] <= 0.0:
        raise PlantError(
            f"rig '{rig.name}' hovers on {hover_V:.2f} V of lift, too little to move travel by tilting",
            "reduce its counterweight",
        )
    return LinearPlant(
        lag_s=lag_s,
        thrust=thrust,
        counterweight=counterweight,
        delay_s=loop_effects.delay_s,
        elevation_A=A[np.ix_(elevation, elevation)],
        elevation_B=B[elevation, 0],
        tilt_A=A[np.ix_(tilt, tilt)],
        tilt_B=B[tilt, 1],
        hover_V=hover_V,
    )


@functools.lru_cache(maxsize=32)
def _model_with_lag(model: type[Model], lag_s: float, linear: tuple[Effect, ...]) -> Model:
    """Return a model with the `linear` effects and a rotor lag of `lag_s` [s].

    The lag is that of the rotor speed if the effects contain one, otherwise that of the thrust.
    """
    speed_lag = next((effect for effect in linear if isinstance(effect, RotorSpeedLag)), None)
    lag = RotorLag(lag_s) if speed_lag is None else speed_lag.with_lag(lag_s)
    return model((lag, *(effect for effect in linear if effect is not speed_lag)))


def spread_plants(
    rig: Rig, spread: Spread, *, model: type[Model] = MultibodyModel, loop_effects: LoopEffects | None = None
) -> Sequence[LinearPlant]:
    """Linearise the nominal rig at every lag of the spread, then the corners of the spread at every lag.

    Corners that cannot hover are left out: a counterweight 3 % heavier lifts some arms without any thrust.
    """
    corners = itertools.product(
        spread.lag_s,
        (1.0 - spread.thrust, 1.0 + spread.thrust),
        (1.0 - spread.counterweight, 1.0 + spread.counterweight),
    )
    plants = [linear_plant(rig, lag_s, model=model, loop_effects=loop_effects) for lag_s in spread.lag_s]
    for corner in corners:
        with contextlib.suppress(PlantError):
            plants.append(linear_plant(rig, *corner, model=model, loop_effects=loop_effects))
    return plants
