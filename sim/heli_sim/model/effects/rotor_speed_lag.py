"""The speed of motor and propeller lags the voltage, and the thrust is the square of the speed."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.rotor_lag import LAGS, MIN_LAG_s
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.quantity import Prior, Quantity


class RotorSpeedLag(Effect):
    """First-order lag of each rotor's speed behind its voltage, and thrust as the square of the speed.

    The square replaces the model's straight line of thrust over voltage. The speed is expressed as the
    voltage that holds it. With `begins` = 0 the parabola starts at speed 0, as for a propeller; with `begins`
    = 1 it starts at the end of the dead zone. The thrust gain of the rig scales it. At the voltage `pivot_V`
    it agrees with the straight line of a rig whose dead zone is half of `pivot_V`; with `begins` = 0 it is
    also tangent there. Effects on the thrust act on the result.

    If the lag T is below 4 ms, the thrust is a weighted mean of the parabola that lags by 4 ms and of the
    straight line. At T = 0 the effect does nothing.
    """

    @property
    def lag_s(self) -> float:
        """Time constant, s."""
        return self.values[f"{self.prefix}_s"]

    def with_lag(self, lag_s: float) -> RotorSpeedLag:
        """Return the same effect with another time constant `lag_s`, s."""
        return replace(self, values={**self.values, f"{self.prefix}_s": lag_s})

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        share = ca.fmin(self.value(at, "s") / MIN_LAG_s, 1.0)
        return share * self._thrust_of_speeds_N(at) + (1 - share) * thrust_N

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return (at.volts_V - self._speed_V(at)) / ca.fmax(self.value(at, "s"), MIN_LAG_s)

    @property
    @override
    def pushes_below_dead_zone(self) -> bool:
        return True

    def _thrust_of_speeds_N(self, at: Operands) -> ca.SX:
        """Return the thrust of both rotors at their present speeds, shape (2, 1)."""
        p, speed_V, begins = at.parameter, self._speed_V(at), self.value(at, "begins")
        forward_V = ca.fmax(speed_V - begins * p["dead_zone"], 0.0)
        backward_V = ca.fmax(-speed_V - begins * p["dead_zone"], 0.0)
        scale_V = 0.5 * self.value(at, "pivot_V") * (2 - begins) ** 2
        return p["thrust_gain"] * (forward_V**2 - p["reverse_thrust"] * backward_V**2) / scale_V

    def _speed_V(self, at: Operands) -> ca.SX:
        return ca.vertcat(self.value(at, "front_V"), self.value(at, "back_V"))


SPEC: Final = EffectSpec(
    id="rotor_speed_lag",
    effect=RotorSpeedLag,
    sentence="the rotors' speed lags their voltage by {s}, and their thrust is the square of the speed",
    equation=(
        r"T \dot w_i = V_i - w_i, \quad "
        r"F_i = k \frac{(w_i - z V_0)^2}{(2 - z)^2 U / 2}"
    ),
    acts_on="thrust",
    stage=Stage.SPEED,
    numbers=(
        Parameter("s", "s", "time constant T", 0.1, Prior(0.08, 0.06, low=0.0, high=0.6), size=True),
        Parameter(
            "begins",
            "1",
            "z: 0 where thrust begins with the speed, 1 where it begins at the dead zone",
            0.0,
            grid=(0.0, 1.0),
        ),
        Parameter("pivot_V", "V", "voltage U at which it is the straight line, where V_0 = U / 2", 2.0),
    ),
    states=(
        Quantity("front_V", "V", "speed of the front rotor, as the voltage that holds it"),
        Quantity("back_V", "V", "speed of the back rotor, as the voltage that holds it"),
    ),
    # A second lag next to this one would be a second name for the same motor.
    excludes=("rotor_lag", "rotor_lag_with_delay"),
    family=LAGS,
    family_numbers={"s": 1.0},
    linearisable=True,
    rank=12,
    source="propeller theory: thrust is the square of the speed; a motor's speed lags its voltage",
)
