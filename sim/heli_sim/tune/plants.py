"""The linear plants that one set of gains has to fly."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from heli_sim.model import MultibodyModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig

Floats = npt.NDArray[np.float64]

# A rotor without lag is one with a lag too short for any loop here to see: all plants then have the same
# states.
NO_LAG_s: Final = 0.004


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
    """

    lag_s: tuple[float, ...] = (0.0, 0.075, 0.15)
    thrust: float = 0.2
    counterweight: float = 0.03
    rotor: float = 0.03


@dataclass(frozen=True)
class LinearPlant:
    """A rig hovering at level, linearised. At level, elevation and the pair pitch and travel are apart.

    Parameters
    ----------
    lag_s, thrust, counterweight : float
        Lag, and the factors on thrust gain and counterweight.
    elevation_A, elevation_B : ndarray (3, 3), (3,)
        States elevation, its rate, thrust of both rotors; input the collective, V.
    tilt_A, tilt_B : ndarray (5, 5), (5,)
        States pitch, travel, their rates, difference of the thrusts; input the differential, V.
    hover_V : float
        Sum of both voltages above the dead zone.
    """

    lag_s: float
    thrust: float
    counterweight: float
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
    rig: Rig, lag_s: float = 0.0, thrust: float = 1.0, counterweight: float = 1.0
) -> LinearPlant:
    """Linearise the multibody model of a rig at level.

    Parameters
    ----------
    rig : Rig
        The rig.
    lag_s : float
        Lag of the thrust, s.
    thrust : float
        Factor on the thrust gain.
    counterweight : float
        Factor on the mass of the counterweight.

    Returns
    -------
    LinearPlant
        The linear plant.

    Raises
    ------
    PlantError
        When the rig cannot hover.
    """
    rig = rig.replace(thrust_gain=thrust * rig["thrust_gain"].value, M_w=counterweight * rig["M_w"].value)
    model = MultibodyModel((RotorLag(max(lag_s, NO_LAG_s)),))
    at = trim(model, rig)
    first = derivatives(model, rig, at.state, at.volts_V)
    # The two thrusts as their sum and their difference, the two voltages likewise.
    states = np.eye(8)
    states[6:, 6:] = [[1.0, 1.0], [1.0, -1.0]]
    A = states @ first.A @ np.linalg.inv(states)
    B = states @ first.B @ np.array([[0.5, 0.5], [0.5, -0.5]])
    elevation, tilt = [0, 3, 6], [1, 2, 4, 5, 7]
    hover_V = float(np.sum(at.volts_V) - 2.0 * rig["dead_zone"].value)
    return LinearPlant(
        lag_s,
        thrust,
        counterweight,
        A[np.ix_(elevation, elevation)],
        B[elevation, 0],
        A[np.ix_(tilt, tilt)],
        B[tilt, 1],
        hover_V,
    )


def spread_plants(rig: Rig, spread: Spread) -> Sequence[LinearPlant]:
    """Every corner of the spread, at every lag.

    Parameters
    ----------
    rig : Rig
        The rig in the middle.
    spread : Spread
        How far it may be from its numbers.

    Returns
    -------
    sequence of LinearPlant
        The rig itself at every lag, in the spread's order; then its corners at every lag.

    Raises
    ------
    PlantError
        When one of them cannot hover.
    """
    corners = itertools.product(
        spread.lag_s,
        (1.0 - spread.thrust, 1.0 + spread.thrust),
        (1.0 - spread.counterweight, 1.0 + spread.counterweight),
    )
    own = [linear_plant(rig, lag_s) for lag_s in spread.lag_s]
    return [*own, *(linear_plant(rig, *corner) for corner in corners)]
