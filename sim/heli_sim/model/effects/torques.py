"""Effects that are torques about the axes: dry friction, springs, tilt, a moved weight, disturbances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import casadi as ca
import numpy as np
from typing_extensions import override

from heli_sim.model.effect import AXES, Effect, Operands, Stage, on_axis, smooth_step
from heli_sim.model.effects.spec import ChangeSpec, EffectSpec, Parameter
from heli_sim.model.effects.thrust import moments_s
from heli_sim.rig.schema import Prior, Quantity

# Dry friction of an axis: its size does not depend on the speed, and it can hold the axis at rest.
_RATE_STD_COUNTS_PER_s: Final = 2.9335
"""Standard error of a moving axis' rate as a flight shows it, in encoder counts per second: 0.0045 rad/s with
4096 counts.

It was set on nineteen simulated flights with dry friction (2026-11), where the most likely values were 0.004
rad/s without disturbances and 0.004 to 0.012 rad/s in gusts. With half of it, friction in gusts is estimated
up to an eighth too small, and the difference is attributed to fast gusts. With twice of it, friction without
disturbances is estimated a tenth too large."""


class CoulombFriction(Effect):
    """The torque that would bring the axis to rest within a short time, limited to the size of dry
    friction.
    """

    # Friction with the sign of the speed could neither be integrated nor differentiated. A smoothed sign
    # would let the axis creep under a load that friction should hold. This form holds the axis, and its
    # steepness, 1 over the time, is the same for a heavy and a light axis.

    @override
    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        stopping_Nm = inertia_kg_m2[AXES.index(self.place)] * self._stopping_rad_s2(at, acceleration_rad_s2)
        max_Nm = self.value(at, "Nm")
        return on_axis(self.place, -ca.fmin(ca.fmax(stopping_Nm, -max_Nm), max_Nm))

    def _stopping_rad_s2(self, at: Operands, acceleration_rad_s2: ca.SX) -> ca.SX:
        """Return the deceleration that brings the axis to rest within the short time."""
        rate_rad_s = at.state[f"{self.place}_rate_rad_s"]
        return acceleration_rad_s2[AXES.index(self.place)] + rate_rad_s / self.value(at, "hold_s")

    @override
    def with_measured_angles(self) -> Effect:
        return CoulombFrictionOfMeasuredRate(
            name=self.name,
            parameters=self.parameters,
            values=self.values,
            priors=self.priors,
            stage=self.stage,
        )


class CoulombFrictionOfMeasuredRate(CoulombFriction):
    """Coulomb friction along a measured flight: its mean over the uncertain rate of the axis."""

    # Such a mean is a describing function (Gelb and Vander Velde 1968). Near standstill the encoders do not
    # show in which direction the axis creeps, so the mean friction is smaller than the full one. A rate of
    # exactly zero marks an axis at rest, whose friction is not averaged.

    @override
    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        count_rad = 2.0 * math.pi / at.parameter[f"encoder_counts_{self.place}"]
        uncertainty_rad_s2 = _RATE_STD_COUNTS_PER_s * count_rad / self.value(at, "hold_s")
        stopping_rad_s2 = self._stopping_rad_s2(at, acceleration_rad_s2)
        moving_Nm = self.value(at, "Nm") * ca.erf(stopping_rad_s2 / (math.sqrt(2.0) * uncertainty_rad_s2))
        at_rest_Nm = super().friction_Nm(at, acceleration_rad_s2, inertia_kg_m2)
        is_at_rest = at.state[f"{self.place}_rate_rad_s"] == 0.0
        return ca.if_else(is_at_rest, at_rest_Nm, -on_axis(self.place, moving_Nm))


def _coulomb_friction(axis: str, typical_Nm: float) -> EffectSpec:
    return EffectSpec(
        id=f"coulomb_friction.{axis}",
        effect=CoulombFriction,
        sentence=f"the {axis} axis has dry friction of {{Nm}}",
        equation=r"\tau = -\min(\max(J (\dot\omega_0 + \omega / T), -c), c)",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter(
                "Nm",
                "N m",
                "torque c",
                typical=typical_Nm,
                prior=Prior(mean=0.0, std=3 * typical_Nm, low=0.0, high=0.5),
                size=True,
                # Not 0: there both bounds of the torque are the same, and it has no derivative by c.
                neutral=1e-14,
            ),
            Parameter(
                "hold_s",
                "s",
                "time T within which it brings the axis to rest",
                typical=0.01,
                prior=Prior(mean=0.008, std=0.005, low=0.004, high=0.05),
            ),
        ),
        change=ChangeSpec(
            sizes=(2.0 * typical_Nm,),
            positive=f"the {axis} axis has {{}} more dry friction",
            negative=f"the {axis} axis has {{}} less dry friction",
        ),
        rank=110,
        source=(
            "Coulomb, with standstill as a damped constraint as solvers of rigid bodies pose it; Runge-Kutta "
            "steps of 10 ms, as identification takes them, are stable down to T = 3.6 ms"
        ),
    )


COULOMB_FRICTIONS: Final = tuple(
    _coulomb_friction(axis, size) for axis, size in zip(AXES, (0.03, 0.01, 0.02), strict=True)
)


# A cable acts like a spring when an axis turns.
class CableSpring(Effect):
    """Torque towards the angle at which the cable is relaxed, in proportion to the distance from it."""

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        return on_axis(self.place, -self.value(at, "Nm_per_rad") * self._deflection_rad(at))

    @override
    def energy_J(self, at: Operands) -> ca.SX:
        return 0.5 * self.value(at, "Nm_per_rad") * self._deflection_rad(at) ** 2

    def _deflection_rad(self, at: Operands) -> ca.SX:
        return at.state[f"{self.place}_rad"] - self.value(at, "rest_rad")


def _cable_spring(axis: str) -> EffectSpec:
    return EffectSpec(
        id=f"cable_spring.{axis}",
        effect=CableSpring,
        sentence=f"a cable pulls {axis} with {{Nm_per_rad}} towards {{rest_rad}}",
        equation=r"\tau = -k (q - q_0)",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter(
                "Nm_per_rad",
                "N m/rad",
                "stiffness k",
                typical=0.05,
                prior=Prior(mean=0.0, std=0.5, low=-2.0, high=5.0),
                size=True,
            ),
            Parameter(
                "rest_rad",
                "rad",
                "rest angle q_0",
                typical=0.0,
                prior=Prior(mean=0.0, std=0.5, low=-6.3, high=6.3),
            ),
        ),
        linearisable=True,
        change=ChangeSpec(
            sizes=(0.1, 0.03),
            positive=f"a cable pulls {axis} with {{}}",
            negative=f"a cable pushes {axis} with {{}}",
            # About an angle at rest a cable is a stiffness and a constant torque.
            numbers=(f"cable_spring_{axis}_Nm_per_rad", f"torque_{axis}"),
        ),
        rank=130,
        source="Hooke; a constant pull beside it is the rig's torque_" + axis,
    )


CABLE_SPRINGS: Final = (_cable_spring("elevation"), _cable_spring("travel"))


# The travel axis is not vertical, so that gravity turns travel towards the low side.
class AxisTilt(Effect):
    """Gravity of all masses, if the true vertical leans in the frame of the rig."""

    # The upward vertical leans by `x_rad` towards the direction of the long arm at travel 0, and by `y_rad`
    # towards its direction after a quarter turn of positive travel.

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        # Minus the gradient of the potential that the tilt adds.
        q = ca.SX.sym("q", 3)
        torque = -ca.gradient(self._potential_J(at, q), q)
        return ca.substitute(torque, q, ca.vertcat(*(at.state[f"{axis}_rad"] for axis in AXES)))

    @override
    def energy_J(self, at: Operands) -> ca.SX:
        return self._potential_J(at, ca.vertcat(*(at.state[f"{axis}_rad"] for axis in AXES)))

    def _potential_J(self, at: Operands, q: ca.SX) -> ca.SX:
        """Return the potential energy that the tilt adds at the angles `q`."""
        x, y = self.value(at, "x_rad"), self.value(at, "y_rad")
        angle2 = x**2 + y**2
        # Change of the unit vector by the lean a: horizontal part sin|a| (x, y)/|a|, vertical part cos|a| -
        # 1. Taylor series to 4th order have derivatives at 0, and are exact enough up to 1 rad.
        up = ca.vertcat(ca.vertcat(x, y) * (1 - angle2 / 6 + angle2**2 / 120), -angle2 / 2 + angle2**2 / 24)
        return at.parameter["g"] * ca.dot(up, _moment_kg_m(at.parameter, q))


def _moment_kg_m(p: Mapping[str, ca.SX], q: ca.SX) -> ca.SX:
    """Return the sum of mass times position of the five masses, in the frame of the rig, shape (3, 1)."""
    cos_elevation, sin_elevation = ca.cos(q[0]), ca.sin(q[0])
    cos_pitch, sin_pitch = ca.cos(q[1]), ca.sin(q[1])
    short_arm_kg = p["M_f"] + p["M_b"] + p["M_h"]
    # At pitch 0, the masses of the short arm are L_phi below its axis, and the rotors L_h to either side.
    y_level, z_level = (p["M_b"] - p["M_f"]) * p["L_h"], -p["L_phi"] * short_arm_kg
    y, z = y_level * cos_pitch + z_level * sin_pitch, z_level * cos_pitch - y_level * sin_pitch
    x = p["M_l"] * p["L_x"] - p["M_w"] * p["L_b"] + short_arm_kg * p["L_a"]
    z = z - p["L_theta"] * (p["M_l"] + p["M_w"] + short_arm_kg)
    along, up = x * cos_elevation - z * sin_elevation, x * sin_elevation + z * cos_elevation
    return ca.vertcat(along * ca.cos(q[2]) - y * ca.sin(q[2]), along * ca.sin(q[2]) + y * ca.cos(q[2]), up)


AXIS_TILT: Final = EffectSpec(
    id="axis_tilt",
    effect=AxisTilt,
    sentence="the travel axis leans by {x_rad} towards the arm at travel 0 and by {y_rad} across",
    equation=r"U = g\, \boldsymbol{n} \cdot \sum m_j \boldsymbol{r}_j,\ \boldsymbol{n} \approx (a_x, a_y, 1)",
    acts_on="torque.travel",
    stage=Stage.TORQUE,
    numbers=(
        Parameter(
            "x_rad",
            "rad",
            "lean a_x towards the arm",
            typical=0.03,
            prior=Prior(mean=0.0, std=0.1, low=-0.5, high=0.5),
            size=True,
        ),
        Parameter(
            "y_rad",
            "rad",
            "lean a_y across the arm",
            typical=0.0,
            prior=Prior(mean=0.0, std=0.1, low=-0.5, high=0.5),
            size=True,
        ),
    ),
    needs=("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x", "g"),
    linearisable=True,
    rank=140,
    source="potential of the five masses of Table 2",
)


# The counterweight slips along the arm at one moment of the flight.
class CounterweightShift(Effect):
    """From an unknown moment on, the counterweight is farther out on the arm."""

    @override
    def modified_parameters(self, at: Operands) -> Mapping[str, ca.SX]:
        shift_m = self.value(at, "m") * smooth_step(at.time_s, self.value(at, "at_s"))
        return {"L_b": at.parameter["L_b"] + shift_m}


COUNTERWEIGHT_SHIFT: Final = EffectSpec(
    id="counterweight_shift",
    effect=CounterweightShift,
    sentence="the counterweight slips by {m} outwards at {at_s}",
    equation=r"L_b \to L_b + \Delta\, [t > t_0]",
    acts_on="parameters",
    stage=Stage.TORQUE,
    numbers=(
        Parameter(
            "m",
            "m",
            "distance Delta, outwards",
            typical=0.005,
            prior=Prior(mean=0.0, std=0.03, low=-0.1, high=0.1),
            size=True,
        ),
        Parameter(
            "at_s", "s", "moment t_0", typical=20.0, prior=Prior(mean=30.0, std=60.0, low=0.0), grid=moments_s
        ),
    ),
    needs=("L_b", "M_w"),
    time_varying=True,
    change=ChangeSpec(
        sizes=(0.01,),
        positive="the counterweight slipped by {} outwards",
        negative="the counterweight slipped by {} inwards",
    ),
    rank=150,
    source="definition; no flight distinguishes a shift from a mass that falls off",
)


# A torque that oscillates at a fixed frequency, for example by an unbalanced shaft or a shaking table.
_HIGHEST_Hz: Final = 5.0
"""Highest frequency of the search; above it, the inertia of an axis hides the effect of the torque."""


class PeriodicTorque(Effect):
    """A torque that is the sum of a sine and a cosine of time."""

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        phase = 2 * np.pi * self.value(at, "Hz") * at.time_s
        torque = self.value(at, "sin_Nm") * ca.sin(phase) + self.value(at, "cos_Nm") * ca.cos(phase)
        return on_axis(self.place, torque)


def _frequencies_Hz(seconds: float) -> tuple[float, ...]:
    """Return the frequencies at which a fit starts."""
    return tuple(np.arange(0.05, _HIGHEST_Hz, 0.5 / seconds).tolist())


def _periodic_torque(axis: str, typical_Nm: float) -> EffectSpec:
    wide = Prior(mean=0.0, std=2 * typical_Nm, low=-1.0, high=1.0)
    return EffectSpec(
        id=f"periodic_torque.{axis}",
        effect=PeriodicTorque,
        sentence=f"a torque of {{sin_Nm}} (sine) and {{cos_Nm}} (cosine) shakes {axis} at {{Hz}}",
        equation=r"\tau = a \sin 2\pi f t + b \cos 2\pi f t",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter("sin_Nm", "N m", "amplitude a of the sine", typical=typical_Nm, prior=wide, size=True),
            Parameter("cos_Nm", "N m", "amplitude b of the cosine", typical=0.0, prior=wide, size=True),
            Parameter(
                "Hz",
                "Hz",
                "frequency f",
                typical=0.5,
                prior=Prior(mean=0.5, std=2.0, low=0.01, high=20.0),
                grid=_frequencies_Hz,
            ),
        ),
        rank=190,
        source="definition",
    )


PERIODIC_TORQUES: Final = tuple(
    _periodic_torque(axis, size) for axis, size in zip(AXES, (0.05, 0.01, 0.03), strict=True)
)


# Gusts: a random torque with a size and a correlation time.
class RandomTorque(Effect):
    """Ornstein-Uhlenbeck process: white noise through a first-order lag."""

    # A simulation draws the noise from its seed. Identification cannot know the noise and uses the mean of
    # the process, which decays from its value at the start of a window.

    @override
    def torque_Nm(self, at: Operands) -> ca.SX:
        return on_axis(self.place, self.value(at, "now_Nm"))

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return -self.value(at, "now_Nm") / self.value(at, "s")

    @override
    def diffusion(self, at: Operands, step_s: float, normal: ca.SX) -> ca.SX:
        # Exact sampling: the stationary standard deviation is Nm for any length of step.
        return self.value(at, "Nm") * ca.sqrt(1 - ca.exp(-2 * step_s / self.value(at, "s"))) * normal


def _random_torque(axis: str, typical_Nm: float) -> EffectSpec:
    return EffectSpec(
        id=f"random_torque.{axis}",
        effect=RandomTorque,
        sentence=f"gusts of {{Nm}} (standard deviation) that last {{s}} push {axis}",
        equation=r"\dot d = -d / T + \sigma \sqrt{2 / T}\, w, \quad \tau = d",
        acts_on=f"torque.{axis}",
        stage=Stage.TORQUE,
        numbers=(
            Parameter(
                "Nm",
                "N m",
                "standard deviation sigma",
                typical=typical_Nm,
                prior=Prior(mean=0.0, std=typical_Nm, low=0.0, high=2.0),
                size=True,
            ),
            Parameter(
                "s",
                "s",
                "correlation time T",
                typical=0.5,
                prior=Prior(mean=0.5, std=0.5, low=0.02, high=20.0),
            ),
        ),
        states=(Quantity("now_Nm", "N m", f"random torque d on the {axis} axis"),),
        noise_inputs=1,
        rank=200,
        source="the simplest coloured noise; Dryden's gusts are of this kind",
    )


RANDOM_TORQUES: Final = tuple(
    _random_torque(axis, size) for axis, size in zip(AXES, (0.03, 0.005, 0.02), strict=True)
)
