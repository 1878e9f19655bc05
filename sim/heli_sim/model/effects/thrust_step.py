"""A rotor loses thrust suddenly: a propeller blade chips, a magnet comes off."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.parts import smooth_step
from heli_sim.rig.quantity import Prior


class ThrustStep(Effect):
    """From an unknown moment on, one rotor gives less thrust."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        factor = 1 - self.value(at, "share") * smooth_step(at.time_s, self.value(at, "at_s"))
        return thrust_N * (ca.vertcat(factor, 1) if self.place == "front" else ca.vertcat(1, factor))


def moments_s(seconds: float) -> tuple[float, ...]:
    """Return the moments at which a fit starts its search: each second of a flight of `seconds`."""
    return tuple(float(second) for second in range(1, max(2, int(seconds))))


def _spec(rotor: str) -> EffectSpec:
    return EffectSpec(
        id=f"thrust_step.{rotor}",
        effect=ThrustStep,
        sentence=f"the {rotor} rotor loses {{share}} of its thrust at {{at_s}}",
        equation=rf"F_{rotor[0]} \to F_{rotor[0]} (1 - s\, [t > t_0])",
        acts_on="thrust",
        stage=Stage.GAIN,
        numbers=(
            Parameter("share", "1", "share s lost", 0.1, Prior(0.0, 0.4, low=-1.0, high=1.0), size=True),
            Parameter("at_s", "s", "moment t_0", 20.0, Prior(30.0, 60.0, low=0.0), grid=moments_s),
        ),
        time_varying=True,
        change=ChangeSpec(
            (0.1,),
            f"the {rotor} rotor lost {{}} of its thrust",
            f"the {rotor} rotor gained {{}} of its thrust",
        ),
        rank=60,
        source="definition",
    )


SPECS: Final = (_spec("front"), _spec("back"))
