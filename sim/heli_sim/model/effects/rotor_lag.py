"""Thrust lags the voltage, because motor and propeller must change their speed first."""

from __future__ import annotations

from typing import ClassVar, Final

import casadi as ca
from typing_extensions import override

from heli_sim.errors import PlantError
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectFamily, EffectSpec, Parameter
from heli_sim.rig.quantity import Prior, Quantity

MIN_LAG_s: Final = 0.004
"""Shortest lag that is integrated, s. Identification takes Runge-Kutta steps of 10 ms, which are stable for
lags above 3.6 ms."""


class RotorLag(Effect):
    """First-order lag of each rotor's thrust behind the thrust that its voltage commands.

    If the lag T is below 4 ms, the thrust is a weighted mean of a thrust that lags by 4 ms and one that does
    not lag, with a mean delay of T. At T = 0 the effect does nothing, and still has a derivative.

    Parameters
    ----------
    lag_s : float
        Time constant, s. Real rigs of this kind show 0.09 to 0.15 s.
    **fields : object
        Keyword arguments of `Effect`, which `EffectSpec.make` gives instead of `lag_s`.

    Raises
    ------
    PlantError
        When the time constant is negative or not a number.
    """

    def __init__(self, lag_s: float = 0.0, **fields: object) -> None:
        if not fields:
            if not lag_s >= 0.0:
                raise PlantError(
                    f"rotor_lag_s = {lag_s} must not be negative", "leave the effect out instead"
                )
            effect = SPEC.make({"rotor_lag_s": lag_s})
            fields = {name: getattr(effect, name) for name in Effect.__dataclass_fields__}
        super().__init__(**fields)  # type: ignore[arg-type]

    time_constant: ClassVar[str] = "s"
    """Short name of the parameter that is the time constant: ``s`` for ``rotor_lag_s``."""

    @property
    def lag_s(self) -> float:
        """Time constant, s."""
        return self.values[f"{self.prefix}_{self.time_constant}"]

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        share = ca.fmin(self.value(at, self.time_constant) / MIN_LAG_s, 1.0)
        return share * self._lagged_thrust_N(at) + (1 - share) * thrust_N

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return (at.thrust_N - self._lagged_thrust_N(at)) / ca.fmax(
            self.value(at, self.time_constant), MIN_LAG_s
        )

    def _lagged_thrust_N(self, at: Operands) -> ca.SX:
        return ca.vertcat(self.value(at, "front_N"), self.value(at, "back_N"))


LAGS: Final = EffectFamily(
    name="lag of the rotors",
    unclear="these flights do not show whether thrust or rotor speed lags, or whether a part is dead time",
    sentence="the rotors lag their voltage by {} in all",
    unit="s",
)
"""All members delay the response of the thrust about a hover by the sum of their times."""

SPEC: Final = EffectSpec(
    id="rotor_lag",
    effect=RotorLag,
    sentence="the rotors' thrust lags their voltage by {s}",
    equation=r"T \dot F_i = F(V_i) - F_i",
    acts_on="thrust",
    stage=Stage.LAG,
    numbers=(Parameter("s", "s", "time constant T", 0.1, Prior(0.08, 0.06, low=0.0, high=0.6), size=True),),
    states=(
        Quantity("front_N", "N", "thrust that the front rotor has reached"),
        Quantity("back_N", "N", "thrust that the back rotor has reached"),
    ),
    family=LAGS,
    family_numbers={"s": 1.0},
    linearisable=True,
    rank=10,
    source="first-order model of a motor with a propeller about an operating point",
)
"""In a model: the parameter `rotor_lag_s`, and the states `rotor_lag_front_N` and `rotor_lag_back_N`."""
