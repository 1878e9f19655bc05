"""Effects of the air: inflow and edgewise flow of the rotors, ground effect, and drag of the arms."""

from __future__ import annotations

from typing import Final

import casadi as ca
from typing_extensions import override

from heli_sim.model.effect import AXES, Effect, Operands, Stage, on_axis, rotor_climb_m_s, rotor_height_m
from heli_sim.model.effects.spec import EffectSpec, Parameter
from heli_sim.rig.schema import Prior


# A rotor that moves along its own axis meets its air faster, and gives less thrust.
class InflowDamping(Effect):
    """Each rotor loses thrust in proportion to its own speed along its thrust axis."""

    # If the speed of the propeller follows the voltage, the loss grows with the thrust (`loaded` = 1). If the
    # speed is nearly constant, the loss is the same at any thrust (`loaded` = 0). Travel at a pitch angle
    # also moves the rotors along their axes, if the air in the room is at rest (`still` = 1). In a small room
    # the air soon turns with the rig, so that travel has no effect (`still` = 0).

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        through_air = {"travel_rate_rad_s": self.value(at, "still") * at.state["travel_rate_rad_s"]}
        climb_m_s = rotor_climb_m_s({**at.state, **through_air}, at.parameter)
        loaded = self.value(at, "loaded")
        return thrust_N - self.value(at, "s_per_m") * climb_m_s * (loaded * thrust_N + (1 - loaded) * _AT_N)


_AT_N: Final = 1.0
"""Thrust at which the loss is defined, if it is the same at any thrust."""


INFLOW_DAMPING: Final = EffectSpec(
    id="inflow_damping",
    effect=InflowDamping,
    sentence="each rotor loses a share of {s_per_m} of its thrust to its own climb along its axis",
    equation=(
        r"F_i \to F_i - c\, v_i (l F_i + (1 - l) \cdot 1\,\mathrm{N}), "
        r"\quad v_i = \boldsymbol{n} \cdot \dot{\boldsymbol{r}}_i"
    ),
    acts_on="thrust",
    stage=Stage.INFLOW,
    numbers=(
        Parameter(
            "s_per_m",
            "s/m",
            "share c lost for each m/s",
            typical=0.1,
            prior=Prior(mean=0.0, std=0.5, low=0.0, high=2.0),
            size=True,
        ),
        Parameter(
            "loaded",
            "1",
            "1 if the loss is proportional to the thrust, 0 if it is the same at any thrust",
            typical=1.0,
            grid=(1.0, 0.0),
        ),
        Parameter(
            "still",
            "1",
            "1 in air that stands still, 0 in air that turns with travel",
            typical=1.0,
            grid=(1.0, 0.0),
        ),
    ),
    needs=("L_a", "L_h", "L_theta"),
    linearisable=True,
    rank=80,
    source="blade element theory: the loss goes with axial speed over blade speed, and with the thrust",
)


# Near the table a rotor gives more thrust, because its wake cannot leave freely.
class GroundEffect(Effect):
    """The thrust of each rotor grows by a share that decays exponentially with the height above the table."""

    # For small rotors, the height is that of the rotor itself, which changes with pitch (`own` = 1). If both
    # rotors share one cushion of air, it is the height of the arm's end (`own` = 0).

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        height_m = rotor_height_m(at.state, at.parameter)
        end_m = ca.sum1(height_m) / 2
        above_m = end_m + self.value(at, "own") * (height_m - end_m) + self.value(at, "table_m")
        return thrust_N * (1 + self.value(at, "share") * ca.exp(-above_m / self.value(at, "height_m")))


GROUND_EFFECT: Final = EffectSpec(
    id="ground_effect",
    effect=GroundEffect,
    sentence="at the table the rotors push {share} more; over {height_m} of height this falls by a factor e",
    equation=r"F_i \to F_i (1 + a\, e^{-h_i / h_0})",
    acts_on="thrust",
    stage=Stage.GROUND,
    numbers=(
        Parameter(
            "share",
            "1",
            "share a gained at the table",
            typical=0.2,
            prior=Prior(mean=0.0, std=0.5, low=0.0, high=5.0),
            size=True,
        ),
        Parameter(
            "height_m",
            "m",
            "height h_0 over which it falls by a factor e",
            typical=0.15,
            prior=Prior(mean=0.15, std=0.1, low=0.02, high=1.5),
            grid=(0.05, 0.1, 0.2, 0.4),
        ),
        Parameter("own", "1", "how far each rotor has a height of its own", typical=1.0, grid=(0.0, 1.0)),
        Parameter(
            "table_m", "m", "how far below the elevation axis the table is, where h_i = 0", typical=0.25
        ),
    ),
    needs=("L_a", "L_h", "L_theta"),
    linearisable=True,
    rank=90,
    source=(
        "measured thrust of rotors near the ground falls off about exponentially; between one and two radii "
        "of height Cheeseman and Bennett's 1 / (1 - (R / 4h)^2) differs from that by 0.4 % of the thrust"
    ),
)


# The rotor that leads in travel meets undisturbed air, and gives more thrust than the one in its wake.
class EdgewiseFlow(Effect):
    """The leading rotor gains thrust and the other one loses it, in proportion to the edgewise speed."""

    # A rotor that moves in its own plane takes in more air at its leading edge, and so does a pair of rotors.
    # The resulting torque raises the leading side. It opposes the pitch that drives travel, and so stabilises
    # the rig.

    @override
    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        state, p = at.state, at.parameter
        cos_elevation, sin_elevation = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
        around_m_s = (p["L_a"] * cos_elevation + p["L_theta"] * sin_elevation) * state["travel_rate_rad_s"]
        up_m_s = p["L_a"] * state["elevation_rate_rad_s"]
        pitch = state["pitch_rad"]
        edgewise_m_s = around_m_s * ca.cos(pitch) - up_m_s * ca.sin(pitch)
        # Positive travel moves the back rotor ahead of the front one.
        return thrust_N * (1 + self.value(at, "s_per_m") * edgewise_m_s * ca.vertcat(-1, 1))


EDGEWISE_FLOW: Final = EffectSpec(
    id="edgewise_flow",
    effect=EdgewiseFlow,
    sentence=(
        "the rotor that leads in travel gains a share of {s_per_m} of its thrust, and the other loses it"
    ),
    equation=(
        r"F_f \to F_f (1 - c\, v), \quad F_b \to F_b (1 + c\, v), "
        r"\quad v = L_a (\dot\psi \cos\theta \cos\phi - \dot\theta \sin\phi)"
    ),
    acts_on="thrust",
    stage=Stage.INFLOW,
    numbers=(
        Parameter(
            "s_per_m",
            "s/m",
            "share c for each m/s",
            typical=0.08,
            prior=Prior(mean=0.0, std=0.3, low=0.0, high=1.0),
            size=True,
        ),
    ),
    needs=("L_a", "L_theta"),
    linearisable=True,
    rank=210,
    source="helicopter theory: a rotor in edgewise flow has more inflow at its trailing edge, and pitches up",
)


# Air drag of an arm that turns, which goes with the square of its speed.
class DragQuadratic(Effect):
    """Torque against an axis in proportion to the square of its rate; the effect's name begins with the
    axis.
    """

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        axis = self.name.partition("_")[0]
        rate = at.state[f"{axis}_rate_rad_s"]
        return on_axis(axis, -self.value(at, "Nms2") * rate * ca.fabs(rate))


def _drag_quadratic(axis: str, symbol: str, typical_Nms2: float, prior: Prior, source: str) -> EffectSpec:
    return EffectSpec(
        id=f"{axis}_drag_quadratic",
        effect=DragQuadratic,
        sentence=f"the air brakes {axis} by {{Nms2}}, with the square of its rate",
        equation=rf"\tau_{symbol} = -d\, \dot{symbol} |\dot{symbol}|",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter(
                "Nms2", "N m s2/rad2", "torque d at 1 rad/s", typical=typical_Nms2, prior=prior, size=True
            ),
        ),
        linearisable=True,
        rank=120,
        source=source,
    )


# The size has the lower bound 0, because drag opposes motion. With negative sizes, it had been named in two
# flights that had no such effect, next to dry friction (2026-11).
_BROADSIDE: Final = "drag of bodies: the square of the speed; (22) of the paper has it for travel alone"

DRAG_QUADRATIC: Final = (
    _drag_quadratic(AXES[0], r"\theta", 0.1, Prior(mean=0.0, std=0.5, low=0.0, high=2.0), _BROADSIDE),
    _drag_quadratic(AXES[1], r"\phi", 0.02, Prior(mean=0.0, std=0.1, low=0.0, high=2.0), _BROADSIDE),
    _drag_quadratic(
        AXES[2],
        r"\psi",
        0.07,
        Prior(mean=0.0, std=0.5, low=0.0, high=2.0),
        "(22) of the paper, made to oppose motion",
    ),
)
