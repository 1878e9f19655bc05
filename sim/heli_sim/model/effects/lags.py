"""Effects that delay the thrust: lags of thrust or rotor speed, and dead time."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar, Final

import casadi as ca
from typing_extensions import override

from heli_sim.errors import PlantError
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects.spec import EffectFamily, EffectSpec, Parameter
from heli_sim.rig.schema import Prior, Quantity

# Thrust lags the voltage, because motor and propeller must change their speed first.
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
            effect = ROTOR_LAG.make({"rotor_lag_s": lag_s})
            fields = {name: getattr(effect, name) for name in Effect.__dataclass_fields__}
        # `fields` are those of Effect, whose types differ.
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

ROTOR_LAG: Final = EffectSpec(
    id="rotor_lag",
    effect=RotorLag,
    sentence="the rotors' thrust lags their voltage by {s}",
    equation=r"T \dot F_i = F(V_i) - F_i",
    acts_on="thrust",
    stage=Stage.LAG,
    numbers=(
        Parameter(
            "s",
            "s",
            "time constant T",
            typical=0.1,
            prior=Prior(mean=0.08, std=0.06, low=0.0, high=0.6),
            size=True,
        ),
    ),
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


# The speed of motor and propeller lags the voltage, and the thrust is the square of the speed.
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


ROTOR_SPEED_LAG: Final = EffectSpec(
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
        Parameter(
            "s",
            "s",
            "time constant T",
            typical=0.1,
            prior=Prior(mean=0.08, std=0.06, low=0.0, high=0.6),
            size=True,
        ),
        Parameter(
            "begins",
            "1",
            "z: 0 where thrust begins with the speed, 1 where it begins at the dead zone",
            typical=0.0,
            grid=(0.0, 1.0),
        ),
        Parameter(
            "pivot_V", "V", "voltage U at which it is the straight line, where V_0 = U / 2", typical=2.0
        ),
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


# Voltages act late, and thrust follows them late: a driver's dead time before a motor's lag.
class RotorLagWithDelay(RotorLag):
    """First-order lag with dead time: `rotor_lag` behind voltages that are late by a fixed time."""

    time_constant: ClassVar[str] = "lag_s"


ROTOR_LAG_WITH_DELAY: Final = EffectSpec(
    id="rotor_lag_with_delay",
    effect=RotorLagWithDelay,
    sentence="the rotors' thrust lags voltages that act {delay_s} late by {lag_s}",
    equation=r"T \dot F_i = F(V_i(t - T_d)) - F_i",
    acts_on="thrust",
    stage=Stage.LAG,
    numbers=(
        Parameter(
            "lag_s",
            "s",
            "time constant T",
            typical=0.1,
            prior=Prior(mean=0.08, std=0.06, low=0.0, high=0.6),
            size=True,
        ),
        Parameter(
            "delay_s",
            "s",
            "dead time T_d",
            typical=0.01,
            prior=Prior(mean=0.02, std=0.03, low=0.0, high=0.25),
            size=True,
        ),
    ),
    states=ROTOR_LAG.states,
    delay="delay_s",
    contains={"rotor_lag": {"s": "lag_s"}, "input_delay": {"s": "delay_s"}},
    family=LAGS,
    family_numbers={"lag_s": 1.0, "delay_s": 1.0},
    linearisable=True,
    rank=14,
    source="first-order lag with dead time, the usual model of an actuator behind a bus",
)


# Voltages act late by a fixed time: a bus, a driver or a controller holds them back.
class InputDelay(Effect):
    """Pure delay of both voltages; programs that integrate the model must pass it late voltages."""


INPUT_DELAY: Final = EffectSpec(
    id="input_delay",
    effect=InputDelay,
    sentence="the voltages act {s} late",
    equation=r"V_i \to V_i(t - T_d)",
    acts_on="input",
    stage=Stage.CURVE,
    numbers=(
        Parameter(
            "s",
            "s",
            "delay T_d",
            typical=0.02,
            prior=Prior(mean=0.02, std=0.03, low=0.0, high=0.25),
            size=True,
        ),
    ),
    delay="s",
    linearisable=True,
    rank=20,
    source="definition",
)
