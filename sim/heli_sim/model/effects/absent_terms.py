"""Effects that remove a term of the model, because a rig may not have it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import AXES, Effect, Operands, Stage, on_axis
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.schema import Prior


class RemovedTerm(Effect):
    """The rig parameters that cause a term are reduced by a share."""

    @override
    def modified_parameters(self, at: Operands) -> Mapping[str, ca.SX]:
        remaining_share = 1 - self.value(at, "share")
        return {
            name: remaining_share * at.parameter[name] for name in TERMS[self.name][1] if name in at.parameter
        }


class RemovedDifferentialTravel(Effect):
    """A share of the paper's term P_18 is removed: (F_f - F_b) L_h sin(pitch)."""

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        term = (at.thrust_N[0] - at.thrust_N[1]) * at.parameter["L_h"] * ca.sin(at.state["pitch_rad"])
        return on_axis("travel", -self.value(at, "share") * term)


TERMS: Final[Mapping[str, tuple[str, tuple[str, ...], str]]] = {
    **{
        f"removed.friction.{axis}": (
            f"viscous friction of the {axis} axis",
            (f"friction_{axis}",),
            r"f \to (1 - s) f",
        )
        for axis in AXES
    },
    "removed.dead_zone": ("the dead zone of the thrust", ("dead_zone",), r"V_0 \to (1 - s) V_0"),
    "removed.pendulum.elevation": (
        "the restoring torque of masses below the elevation axis",
        ("L_theta",),
        r"L_\theta \to (1 - s) L_\theta",
    ),
    "removed.pendulum.pitch": (
        "the restoring torque of masses below the pitch axis",
        ("L_phi",),
        r"L_\phi \to (1 - s) L_\phi",
    ),
    "removed.drag": (
        "the air drag of travel",
        ("drag_area_arm", "drag_area_body"),
        r"C_D A \to (1 - s) C_D A",
    ),
}
"""Each term in words, the rig parameters that cause it, and its equation."""

_SHARE: Final = Parameter(
    "share",
    "1",
    "share s of the term that is missing",
    typical=1.0,
    prior=Prior(mean=0.0, std=1.0, low=0.0, high=1.0),
    size=True,
)


def _spec(name: str, words: str, numbers: tuple[str, ...], equation: str) -> EffectSpec:
    return EffectSpec(
        id=name,
        effect=RemovedTerm,
        sentence=f"{{share}} of {words} is missing",
        equation=equation,
        acts_on="parameters",
        stage=Stage.TORQUE,
        numbers=(_SHARE,),
        baseline=True,
        override=dict.fromkeys(numbers, 0.0),
        linearisable=True,
        rank=900,
        source="the baseline's own term",
    )


SPECS: Final = (
    *(_spec(name, *term) for name, term in TERMS.items()),
    EffectSpec(
        id="removed.differential_travel",
        effect=RemovedDifferentialTravel,
        sentence="{share} of P_18, the travel torque of the difference of the thrusts at pitch, is missing",
        equation=r"P_{18}: (F_f - F_b) L_h \sin\phi \to (1 - s) (F_f - F_b) L_h \sin\phi",
        acts_on="torque.travel",
        stage=Stage.TORQUE,
        numbers=(_SHARE,),
        models=("paper_printed",),
        baseline=True,
        linearisable=True,
        rank=900,
        source="(21), (23), (24) of the paper as printed; no multibody model has it",
    ),
)
