"""Effects on the voltage and on the size of the thrust: curve, asymmetry, fades, steps, and the supply."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import Effect, Operands, Stage, smooth_step
from heli_sim.model.effects.spec import ChangeSpec, EffectFamily, EffectSpec, Parameter
from heli_sim.rig.schema import Prior


# Thrust grows with the square of the speed, so its curve over the voltage is bent.
class ThrustQuadratic(Effect):
    """A share of the thrust goes with the square of the voltage above the dead zone."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        # Bent about one point, which leaves the gain near what it was.
        above_V = ca.fabs(thrust_N) / at.parameter["thrust_gain"]
        return thrust_N * (1 + self.value(at, "share") * (above_V / self.value(at, "pivot_V") - 1))


THRUST_QUADRATIC: Final = EffectSpec(
    id="thrust_quadratic",
    effect=ThrustQuadratic,
    sentence="{share} of the thrust at {pivot_V} above the dead zone goes with the square of the voltage",
    equation=r"F_i = k e_i (1 + q (|e_i| / e_0 - 1)), \quad e_i = V_i - V_0",
    acts_on="thrust",
    stage=Stage.CURVE,
    numbers=(
        Parameter(
            "share",
            "1",
            "quadratic share q",
            typical=0.3,
            prior=Prior(mean=0.0, std=0.6, low=-1.0, high=1.5),
            size=True,
        ),
        Parameter(
            "pivot_V", "V", "voltage e_0 above the dead zone at which the thrust is not changed", typical=1.0
        ),
    ),
    linearisable=True,
    rank=30,
    source="propeller theory: thrust goes with the square of the speed; (31) of the paper is a straight line",
)


# The two rotors differ: one pushes more than the other at the same voltage.
class ThrustAsymmetry(Effect):
    """The front rotor pushes more by a share, the back rotor less by the same."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        share = self.value(at, "share")
        return thrust_N * ca.vertcat(1 + share, 1 - share)


THRUST_ASYMMETRY: Final = EffectSpec(
    id="thrust_asymmetry",
    effect=ThrustAsymmetry,
    sentence="the front rotor pushes {share} more, and the back rotor as much less, than their mean",
    equation=r"F_f \to (1 + a) F_f, \quad F_b \to (1 - a) F_b",
    acts_on="thrust",
    stage=Stage.GAIN,
    numbers=(
        Parameter(
            "share",
            "1",
            "share a",
            typical=0.05,
            prior=Prior(mean=0.0, std=0.3, low=-0.9, high=0.9),
            size=True,
        ),
    ),
    linearisable=True,
    rank=40,
    source="definition; what both rotors gain together is the thrust gain k",
)


# Thrust falls during the flight: motors and drivers get warm.
class ThrustFade(Effect):
    """Both thrusts fall with time, linearly or towards a lower level."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return thrust_N * remaining_share(at.time_s, self.value(at, "per_s"), self.value(at, "bend_per_s"))


def remaining_share(time_s: ca.SX, per_s: ca.SX, bend_per_s: ca.SX) -> ca.SX:
    """Return the remaining share of a fading quantity: 1 - r (1 - exp(-b t)) / b, or 1 - r t if b is 0."""
    bend = bend_per_s * time_s
    is_straight = ca.fabs(bend) < 1e-3  # a series avoids 0 / 0
    safe_bend = ca.if_else(is_straight, 1.0, bend)
    mean_decay = ca.if_else(is_straight, 1 - bend / 2 + bend**2 / 6, (1 - ca.exp(-safe_bend)) / safe_bend)
    return 1 - per_s * time_s * mean_decay


def bends_per_s(seconds: float) -> tuple[float, ...]:
    """Return the rates of levelling off at which a fit starts [1/s]."""
    return (0.0, 0.5 / seconds, 1.0 / seconds, 3.0 / seconds)


_BEND: Final = Parameter(
    "bend_per_s",
    "1/s",
    "rate kappa at which the loss levels off; kappa = r is an exponential fall to nothing",
    typical=0.0,
    prior=Prior(mean=0.0, std=0.03, low=-0.02, high=1.0),
    grid=bends_per_s,
)

FADES: Final = EffectFamily(
    name="fading thrust", unclear="these flights do not show whether the supply fades or the thrust"
)
"""About a hover, both take a share of the thrust; only the dead zone and the thrust curve differ."""

THRUST_FADE: Final = EffectSpec(
    id="thrust_fade",
    effect=ThrustFade,
    sentence="the thrust fades by {per_s} at first, levelling off at {bend_per_s}",
    equation=r"F_i \to F_i (1 - r (1 - e^{-\kappa t}) / \kappa), \quad \kappa \to 0: 1 - r t",
    acts_on="thrust",
    stage=Stage.GAIN,
    numbers=(
        Parameter(
            "per_s",
            "1/s",
            "share r lost per second",
            typical=0.003,
            prior=Prior(mean=0.0, std=0.02, low=-0.02, high=0.1),
            size=True,
        ),
        _BEND,
    ),
    family=FADES,
    time_varying=True,
    change=ChangeSpec(
        sizes=(0.01,),
        positive="both rotors lose {} of their thrust",
        negative="both rotors gain {} of their thrust",
        # From its onset a fade is a ramp of what both rotors lose.
        numbers=("thrust_step_front_share+thrust_step_back_share",),
        is_ramp=True,
    ),
    rank=50,
    source="first-order warming of a motor, of which a straight line and an exponential are limits",
)


# A rotor loses thrust suddenly: a propeller blade chips, a magnet comes off.
class ThrustStep(Effect):
    """From an unknown moment on, one rotor gives less thrust."""

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        factor = 1 - self.value(at, "share") * smooth_step(at.time_s, self.value(at, "at_s"))
        return thrust_N * (ca.vertcat(factor, 1) if self.place == "front" else ca.vertcat(1, factor))


def moments_s(seconds: float) -> tuple[float, ...]:
    """Return the moments at which a fit starts its search: each second of a flight of `seconds`."""
    return tuple(float(second) for second in range(1, max(2, int(seconds))))


def _thrust_step(rotor: str) -> EffectSpec:
    return EffectSpec(
        id=f"thrust_step.{rotor}",
        effect=ThrustStep,
        sentence=f"the {rotor} rotor loses {{share}} of its thrust at {{at_s}}",
        equation=rf"F_{rotor[0]} \to F_{rotor[0]} (1 - s\, [t > t_0])",
        acts_on="thrust",
        stage=Stage.GAIN,
        numbers=(
            Parameter(
                "share",
                "1",
                "share s lost",
                typical=0.1,
                prior=Prior(mean=0.0, std=0.4, low=-1.0, high=1.0),
                size=True,
            ),
            Parameter(
                "at_s",
                "s",
                "moment t_0",
                typical=20.0,
                prior=Prior(mean=30.0, std=60.0, low=0.0),
                grid=moments_s,
            ),
        ),
        time_varying=True,
        change=ChangeSpec(
            sizes=(0.1,),
            positive=f"the {rotor} rotor lost {{}} of its thrust",
            negative=f"the {rotor} rotor gained {{}} of its thrust",
        ),
        rank=60,
        source="definition",
    )


THRUST_STEPS: Final = (_thrust_step("front"), _thrust_step("back"))


# The voltage of the supply falls under load, so that each motor gets less when the other is driven.
class SupplySag(Effect):
    """Both motors lose voltage in proportion to the load, which is the sum of their voltages."""

    # If switching drivers share the supply, each motor loses a share of its own voltage (`line` = 0). If the
    # motors share a supply line with a resistance, both lose the same voltage (`line` = 1).

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        load_V = ca.fabs(volts_V[0]) + ca.fabs(volts_V[1])
        line = self.value(at, "line")
        return volts_V - self.value(at, "per_V") * load_V * ((1 - line) * volts_V + line * _LINE_V)


_LINE_V: Final = 1.0
"""Motor voltage to which the loss refers, if both motors lose the same voltage."""

SUPPLY_SAG: Final = EffectSpec(
    id="supply_sag",
    effect=SupplySag,
    sentence="the supply sags by {per_V}, a share for each volt on either motor",
    equation=r"V_i \to V_i - s (|V_f| + |V_b|) ((1 - l) V_i + l \cdot 1\,\mathrm{V})",
    acts_on="input",
    stage=Stage.CURVE,
    numbers=(
        Parameter(
            "per_V",
            "1/V",
            "share s lost for each volt",
            typical=0.02,
            prior=Prior(mean=0.0, std=0.1, low=0.0, high=0.2),
            size=True,
        ),
        Parameter(
            "line",
            "1",
            "0 where each driver loses a share of its voltage, 1 where both lose the same voltage",
            typical=0.0,
            grid=(0.0, 1.0),
        ),
    ),
    linearisable=True,
    rank=70,
    source="Ohm: a driver passes on a share of the supply, whose current goes with both motors' voltages",
)


# The supply's voltage falls during the flight: a battery runs down.
class SupplyFade(Effect):
    """Both motors lose a share of their voltage that grows with time, in a straight line or towards a lower
    level.
    """

    # The dead zone stays where it is, so a share lost here costs the more of a thrust the smaller it is;
    # `thrust_fade` takes the same share of any.

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * remaining_share(at.time_s, self.value(at, "per_s"), self.value(at, "bend_per_s"))


SUPPLY_FADE: Final = EffectSpec(
    id="supply_fade",
    effect=SupplyFade,
    sentence="the supply's voltage fades by {per_s} at first, levelling off at {bend_per_s}",
    equation=r"V_i \to V_i (1 - r (1 - e^{-\kappa t}) / \kappa), \quad \kappa \to 0: 1 - r t",
    acts_on="input",
    stage=Stage.SUPPLY,
    numbers=(
        Parameter(
            "per_s",
            "1/s",
            "share r of the voltage lost per second",
            typical=0.001,
            prior=Prior(mean=0.0, std=0.01, low=-0.01, high=0.05),
            size=True,
        ),
        _BEND,
    ),
    family=FADES,
    time_varying=True,
    rank=72,
    source="discharge of a battery: steep at first and flat after, or nearly straight",
)
