"""Thrust follows the voltage late: motor and propeller have to change their speed first."""

from __future__ import annotations

from typing import Final

import casadi as ca

from heli_sim.errors import PlantError
from heli_sim.model.base import Effect, Situation
from heli_sim.model.parts import thrust_N as static_thrust_N
from heli_sim.rig.quantity import Prior, Quantity

# The millisecond of Runge-Kutta is stable down to 0.36 ms and accurate to 0.1 % from here on.
_LEAST_s: Final = 0.001


class RotorLag(Effect):
    """First-order lag of each rotor's thrust behind its static value F(V).

    Real rigs of this kind show 0.09 to 0.15 s. It replaces the thrust, so it comes first among the effects
    that change the thrust.

    Parameters
    ----------
    lag_s : float
        Time constant, s.

    Raises
    ------
    PlantError
        When the time constant is too short to be simulated in millisecond steps.
    """

    def __init__(self, lag_s: float) -> None:
        if not lag_s >= _LEAST_s:
            raise PlantError(f"rotor_lag_s = {lag_s} is below {_LEAST_s}; leave the effect out instead")
        super().__init__(
            "rotor_lag",
            parameters=(Quantity("rotor_lag_s", "s", "time constant of thrust behind voltage"),),
            values={"rotor_lag_s": lag_s},
            states=(
                Quantity("front_thrust_N", "N", "thrust of the front rotor"),
                Quantity("back_thrust_N", "N", "thrust of the back rotor"),
            ),
            priors={"rotor_lag_s": Prior(0.08, 0.06, low=_LEAST_s, high=0.6)},
        )

    def thrust_N(self, at: Situation, thrust_N: ca.SX) -> ca.SX:
        """Replace the static thrust by the state.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Static thrust, shape (2, 1).

        Returns
        -------
        casadi.SX
            Lagged thrust, shape (2, 1).
        """
        return ca.vertcat(at.state["front_thrust_N"], at.state["back_thrust_N"])

    def state_rates(self, at: Situation) -> ca.SX:
        """Pull each thrust towards its static value.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.

        Returns
        -------
        casadi.SX
            Rates in N/s, shape (2, 1).
        """
        p = at.parameter
        wanted_N = static_thrust_N(at.volts_V, p["thrust_gain"], p["dead_zone"], p["reverse_thrust"])
        return (wanted_N - self.thrust_N(at, wanted_N)) / p["rotor_lag_s"]
