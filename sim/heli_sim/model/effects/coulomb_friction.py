"""Dry friction of an axis: as large at any speed, and it changes sign with the speed."""

from __future__ import annotations

from typing import Final

import casadi as ca

from heli_sim.model.effect import Effect, Situation, Stage
from heli_sim.model.effects.kind import EffectKind, Parameter
from heli_sim.model.parts import AXES, on_axis
from heli_sim.rig.quantity import Prior


class CoulombFriction(Effect):
    """Torque against the motion, rounded about standstill so that it can be integrated and differentiated."""

    def torque_Nm(self, at: Situation) -> ca.SX:
        """Torque against the rate.

        Parameters
        ----------
        at : Situation
            Present state and parameters.

        Returns
        -------
        casadi.SX
            Torque in N m, shape (3, 1).
        """
        rate = at.state[f"{self.place}_rate_rad_s"]
        return on_axis(self.place, -self.own(at, "Nm") * ca.tanh(rate / self.own(at, "round_rad_s")))


def _kind(axis: str, typical_Nm: float) -> EffectKind:
    return EffectKind(
        id=f"coulomb_friction.{axis}",
        effect=CoulombFriction,
        says=f"the {axis} axis has dry friction of {{Nm}}",
        equation=r"\tau = -c \tanh(\omega / \omega_0)",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter("Nm", "N m", "torque c", typical_Nm, Prior(0.0, typical_Nm, -0.5, 0.5), size=True),
            Parameter(
                "round_rad_s",
                "rad/s",
                "rate omega_0 below which it is rounded off",
                0.002,
                neutral=0.01,
                scan=(0.01, 0.005, 0.003, 0.002),
            ),
        ),
        source=(
            "Coulomb; below 0.002 rad/s, a count of the encoder in 0.8 s, no flight shows the rounding, but "
            "a fit finds its way there only through the rounder ones"
        ),
    )


KINDS: Final = tuple(_kind(axis, size) for axis, size in zip(AXES, (0.03, 0.01, 0.02), strict=True))
