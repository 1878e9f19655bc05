"""Effects of the catalogue, implemented in MuJoCo without the equations of the catalogue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats

from heli_benchmark.plant import STEP_S, Delay, HiddenEffect, Moment

AXES = ("elevation", "pitch", "travel")


class RotorLag(HiddenEffect):
    """Thrust follows the voltage with a first-order lag; `size` is its time constant in s."""

    late = True

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._thrust_N = np.zeros(2)
        self._decay = np.exp(-STEP_S / size)

    def thrust(self, at: Moment) -> None:
        # The lag responds exactly at the end of the step; the mean of both ends acts during the step.
        before = self._thrust_N
        self._thrust_N = at.thrust_N + (before - at.thrust_N) * self._decay
        at.thrust_N = 0.5 * (before + self._thrust_N)


class InputDelay(HiddenEffect):
    """Voltages act later; `size` is the delay in s, rounded to whole steps."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._delay = Delay(size, np.zeros(2))
        self.truth = {"size": self._delay.delay_s}

    def volts(self, at: Moment) -> None:
        at.volts_V = self._delay(at.volts_V)


class ThrustQuadratic(HiddenEffect):
    """Thrust grows with the square of the voltage; `size` is the relative increase per volt."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 + self.size * np.abs(at.above_V))


class ThrustAsymmetry(HiddenEffect):
    """The front rotor gives a share `size` more thrust, and the back rotor the same share less."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * np.array([1.0 + self.size, 1.0 - self.size])


class ThrustFade(HiddenEffect):
    """Thrust decreases steadily; `size` is the share lost in a minute."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N * (1.0 - self.size * at.flight_s / 60.0)


class ThrustStep(HiddenEffect):
    """One rotor, number `rotor`, loses a share `size` of its thrust at a random moment."""

    def __init__(self, size: float, rng: np.random.Generator, rotor: int) -> None:
        super().__init__(size, rng)
        self._rotor, self._at_s = rotor, rng.uniform(15.0, 28.0)
        self.truth = {"size": size, "at_s": self._at_s}

    def thrust(self, at: Moment) -> None:
        if at.flight_s >= self._at_s:
            at.thrust_N[self._rotor] *= 1.0 - self.size


class SupplySag(HiddenEffect):
    """The supply has an inner resistance: voltages lose a share `size` per volt of their mean."""

    def volts(self, at: Moment) -> None:
        at.volts_V = at.volts_V * (1.0 - self.size * np.abs(at.volts_V).mean())


class InflowDamping(HiddenEffect):
    """A rotor that moves along its own axis loses thrust; `size` is the loss in N per m/s."""

    def thrust(self, at: Moment) -> None:
        at.thrust_N = at.thrust_N - self.size * at.climb_m_s


class GroundEffect(HiddenEffect):
    """Thrust increases near the table, by up to a share `size`."""

    def thrust(self, at: Moment) -> None:
        # Height of the end of an arm of 0.64 m above its table at -25 deg; the effect fades over 0.15 m.
        height_m = 0.64 * (np.sin(at.angles_rad[0]) - np.sin(np.deg2rad(-25.0)))
        at.thrust_N = at.thrust_N * (1.0 + self.size * np.exp(-height_m / 0.15))


class ReactionTorque(HiddenEffect):
    """Both propellers turn the same way; `size` is the reaction torque in N m per newton of thrust."""

    back_turns: float = 1.0

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self.truth = {"size": size, "back_turns": self.back_turns}

    def torque(self, at: Moment) -> None:
        reaction_Nm = self.size * (at.thrust_N[0] + self.back_turns * at.thrust_N[1])
        # The rotors' axis in the frame of the arm: elevation turns about -y, travel about the vertical.
        at.torque_Nm[0] += reaction_Nm * -np.sin(at.angles_rad[1])
        at.torque_Nm[2] += reaction_Nm * at.up[2]


class OpposedReactionTorque(ReactionTorque):
    """The propellers turn in opposite directions: the difference of their reaction torques remains."""

    back_turns = -1.0


class SpinningRotors(HiddenEffect):
    """The rotors act as gyroscopes; `size` is their angular momentum in N m s per newton of thrust."""

    def torque(self, at: Moment) -> None:
        # Axes of the joints in a frame that turns with travel: elevation, pitch, travel.
        elevation, pitch = at.angles_rad[0], at.angles_rad[1]
        forward = np.array([np.cos(elevation), 0.0, np.sin(elevation)])
        arm_up = np.array([-np.sin(elevation), 0.0, np.cos(elevation)])
        axes = np.array([[0.0, -1.0, 0.0], -forward, [0.0, 0.0, 1.0]])
        rotor_axis = np.cos(pitch) * arm_up + np.sin(pitch) * np.array([0.0, 1.0, 0.0])
        angular_velocity = axes.T @ at.rates_rad_s
        at.torque_Nm += axes @ -np.cross(angular_velocity, self.size * at.thrust_N.sum() * rotor_axis)


class LeadingRotor(HiddenEffect):
    """The leading rotor gains thrust and the other loses it; `size` is the share per m/s of travel."""

    late = True

    def thrust(self, at: Moment) -> None:
        tangential_m_s = 0.64 * at.rates_rad_s[2] * np.cos(at.angles_rad[0]) * np.cos(at.angles_rad[1])
        edgewise_m_s = tangential_m_s - 0.64 * at.rates_rad_s[0] * np.sin(at.angles_rad[1])
        at.thrust_N = at.thrust_N * (1.0 + self.size * edgewise_m_s * np.array([-1.0, 1.0]))


class Coulomb(HiddenEffect):
    """Dry friction of an axis, number `axis`; `size` is the friction torque in N m."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis = axis

    def configure(self, model: Any) -> None:
        model.dof_frictionloss[model.joint(AXES[self._axis]).dofadr[0]] = self.size


class QuadraticDrag(HiddenEffect):
    """Air drag of the travel axis; `size` is the torque in N m at 1 rad/s."""

    def torque(self, at: Moment) -> None:
        rate = at.rates_rad_s[2]
        at.torque_Nm[2] -= self.size * rate * abs(rate)


class CableSpring(HiddenEffect):
    """A cable pulls an axis, number `axis`, to a random angle; `size` is its stiffness in N m per rad."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis, self._rest_rad = axis, rng.uniform(-0.4, 0.4)
        self.truth = {"size": size, "rest_rad": self._rest_rad}

    def configure(self, model: Any) -> None:
        joint = model.joint(AXES[self._axis])
        model.jnt_stiffness[joint.id] = self.size
        model.qpos_spring[joint.qposadr[0]] = self._rest_rad


class AxisTilt(HiddenEffect):
    """The travel axis leans to a random side; `size` is its angle to the vertical in degrees."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._towards_rad = rng.uniform(-np.pi, np.pi)
        self.truth = {"size": size, "towards_rad": self._towards_rad}

    def configure(self, model: Any) -> None:
        g, tilt = np.linalg.norm(model.opt.gravity), np.deg2rad(self.size)
        sideways = np.sin(tilt) * np.array([np.cos(self._towards_rad), np.sin(self._towards_rad)])
        model.opt.gravity[:] = g * np.array([*sideways, -np.cos(tilt)])


class CounterweightShift(HiddenEffect):
    """The counterweight slips outwards at a random moment; `size` is the distance in m."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._at_s = rng.uniform(15.0, 28.0)
        self.truth = {"size": size, "at_s": self._at_s}
        self._slipped = False

    def during(self, at: Moment, model: Any) -> None:
        if at.flight_s >= self._at_s and not self._slipped:
            model.body("counterweight").pos[0] -= self.size
            self._slipped = True


class Backlash(HiddenEffect):
    """Play between an axis, number `axis`, and its encoder; `size` is the play in degrees."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis = axis
        self._encoder_rad: float | None = None

    def measured(self, angles_rad: Floats) -> Floats:
        half_rad, true_rad = np.deg2rad(self.size) / 2.0, angles_rad[self._axis]
        previous_rad = true_rad if self._encoder_rad is None else self._encoder_rad
        self._encoder_rad = float(np.clip(previous_rad, true_rad - half_rad, true_rad + half_rad))
        encoder_rad = angles_rad.copy()
        encoder_rad[self._axis] = self._encoder_rad
        return encoder_rad


class Eccentricity(HiddenEffect):
    """An encoder, number `axis`, is mounted off centre; `size` is the amplitude of its error in degrees."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis, self._phase_rad = axis, rng.uniform(-np.pi, np.pi)
        # The other axes turn little, so that an error once per revolution would look like a wrong scale.
        self._order = int(rng.choice([1, 2])) if axis == 2 else 2
        self.truth = {"size": size, "order": self._order, "phase_rad": self._phase_rad}

    def measured(self, angles_rad: Floats) -> Floats:
        encoder_rad = angles_rad.copy()
        phase_rad = self._order * angles_rad[self._axis] + self._phase_rad
        encoder_rad[self._axis] += np.deg2rad(self.size) * np.sin(phase_rad)
        return encoder_rad


class ZeroOffset(HiddenEffect):
    """The arm is not level at power-up about an axis, number `axis`; `size` is the angle in degrees."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size * rng.choice([-1.0, 1.0]), rng)
        self._axis = axis

    def rest(self, state: Floats) -> None:
        state[self._axis] += np.deg2rad(self.size)


class PeriodicTorque(HiddenEffect):
    """A sinusoidal torque of random frequency about an axis, number `axis`; `size` is its amplitude, N m."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis, self._phase_rad = axis, rng.uniform(-np.pi, np.pi)
        self._frequency_Hz = rng.uniform(0.3, 2.5)
        self.truth = {"size": size, "frequency_Hz": self._frequency_Hz}

    def torque(self, at: Moment) -> None:
        phase_rad = 2.0 * np.pi * self._frequency_Hz * at.time_s + self._phase_rad
        at.torque_Nm[self._axis] += self.size * np.sin(phase_rad)


class RandomTorque(HiddenEffect):
    """A random torque about an axis, number `axis`; `size` is its standard deviation in N m."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis, self._lasts_s = axis, rng.uniform(0.2, 0.8)
        self.truth = {"size": size, "lasts_s": self._lasts_s}
        self._decay = np.exp(-STEP_S / self._lasts_s)
        self._torque_Nm = 0.0

    def torque(self, at: Moment) -> None:
        innovation_Nm = self.size * np.sqrt(1.0 - self._decay**2)
        self._torque_Nm = self._decay * self._torque_Nm + innovation_Nm * self.flight_rng.standard_normal()
        at.torque_Nm[self._axis] += self._torque_Nm


class NoFriction(HiddenEffect):
    """An axis, number `axis`, without a share `size` of its friction."""

    def __init__(self, size: float, rng: np.random.Generator, axis: int) -> None:
        super().__init__(size, rng)
        self._axis = axis

    def configure(self, model: Any) -> None:
        model.dof_damping[model.joint(AXES[self._axis]).dofadr[0]] *= 1.0 - self.size


class NoDeadZone(HiddenEffect):
    """Drivers that compensate the dead zone; `size` is the voltage in V that they add."""

    def volts(self, at: Moment) -> None:
        at.volts_V = np.where(at.volts_V > 0.0, at.volts_V + self.size, 0.0)


class NoPendulum(HiddenEffect):
    """The `bodies` are at the height of the axis; `size` is the removed share of their offset."""

    def __init__(self, size: float, rng: np.random.Generator, bodies: tuple[str, ...]) -> None:
        super().__init__(size, rng)
        self._bodies = bodies

    def configure(self, model: Any) -> None:
        for name in self._bodies:
            model.body(name).pos[2] *= 1.0 - self.size


Maker = Callable[[float, np.random.Generator], HiddenEffect]


@dataclass(frozen=True)
class OnAxis:
    """Factory of an effect of a class, `kind`, at a `place`: number of an axis or rotor, or names of
    bodies.
    """

    # Unlike a lambda, it can be pickled.

    kind: Callable[..., HiddenEffect]
    place: Any

    def __call__(self, size: float, rng: np.random.Generator) -> HiddenEffect:
        return self.kind(size, rng, self.place)


class ListedEffect(NamedTuple):
    """How to hide an effect of the catalogue, and its sizes in cases without disturbances."""

    maker: Maker
    small: float
    large: float


class OtherForm(NamedTuple):
    """How to hide an effect in another form than that of the catalogue, in one size."""

    effect: str  # Id in the catalogue
    maker: Maker
    size: float


LISTED: dict[str, ListedEffect] = {
    "rotor_lag": ListedEffect(RotorLag, 0.03, 0.12),
    "input_delay": ListedEffect(InputDelay, 0.01, 0.03),
    "thrust_quadratic": ListedEffect(ThrustQuadratic, 0.06, 0.2),
    "thrust_asymmetry": ListedEffect(ThrustAsymmetry, 0.03, 0.1),
    "thrust_fade": ListedEffect(ThrustFade, 0.05, 0.15),
    "thrust_step.front": ListedEffect(OnAxis(ThrustStep, 0), 0.05, 0.15),
    "thrust_step.back": ListedEffect(OnAxis(ThrustStep, 1), 0.05, 0.15),
    "supply_sag": ListedEffect(SupplySag, 0.03, 0.08),
    "inflow_damping": ListedEffect(InflowDamping, 0.1, 0.3),
    "ground_effect": ListedEffect(GroundEffect, 0.1, 0.3),
    "rotor_reaction_torque": ListedEffect(ReactionTorque, 0.01, 0.03),
    "coulomb_friction.elevation": ListedEffect(OnAxis(Coulomb, 0), 0.02, 0.06),
    "coulomb_friction.pitch": ListedEffect(OnAxis(Coulomb, 1), 0.005, 0.02),
    "coulomb_friction.travel": ListedEffect(OnAxis(Coulomb, 2), 0.01, 0.03),
    "travel_drag_quadratic": ListedEffect(QuadraticDrag, 0.05, 0.15),
    "cable_spring.elevation": ListedEffect(OnAxis(CableSpring, 0), 0.05, 0.2),
    "cable_spring.travel": ListedEffect(OnAxis(CableSpring, 2), 0.03, 0.1),
    "axis_tilt": ListedEffect(AxisTilt, 1.0, 3.0),
    "counterweight_shift": ListedEffect(CounterweightShift, 0.003, 0.01),
    "backlash.elevation": ListedEffect(OnAxis(Backlash, 0), 0.3, 0.8),
    "backlash.pitch": ListedEffect(OnAxis(Backlash, 1), 0.3, 0.8),
    "backlash.travel": ListedEffect(OnAxis(Backlash, 2), 0.3, 0.8),
    "encoder_eccentricity.elevation": ListedEffect(OnAxis(Eccentricity, 0), 0.3, 0.8),
    "encoder_eccentricity.pitch": ListedEffect(OnAxis(Eccentricity, 1), 0.3, 0.8),
    "encoder_eccentricity.travel": ListedEffect(OnAxis(Eccentricity, 2), 0.8, 2.5),
    "zero_offset.elevation": ListedEffect(OnAxis(ZeroOffset, 0), 1.0, 3.0),
    "zero_offset.pitch": ListedEffect(OnAxis(ZeroOffset, 1), 1.0, 3.0),
    "periodic_torque.elevation": ListedEffect(OnAxis(PeriodicTorque, 0), 0.01, 0.05),
    "periodic_torque.pitch": ListedEffect(OnAxis(PeriodicTorque, 1), 0.003, 0.01),
    "periodic_torque.travel": ListedEffect(OnAxis(PeriodicTorque, 2), 0.01, 0.04),
    "random_torque.elevation": ListedEffect(OnAxis(RandomTorque, 0), 0.02, 0.08),
    "random_torque.pitch": ListedEffect(OnAxis(RandomTorque, 1), 0.004, 0.015),
    "random_torque.travel": ListedEffect(OnAxis(RandomTorque, 2), 0.015, 0.05),
}
"""Factory, small and large size of each effect. No zero offset of travel: its zero is arbitrary."""

MORE_LISTED: dict[str, ListedEffect] = {
    "edgewise_flow": ListedEffect(LeadingRotor, 0.04, 0.12),
    "gyroscopic_torque": ListedEffect(SpinningRotors, 0.02, 0.05),
}
"""The same for effects from measured flights; a separate list, so that other cases keep their seeds."""

OTHER_FORMS: dict[str, OtherForm] = {
    "rotor_reaction_torque-opposed": OtherForm("rotor_reaction_torque", OpposedReactionTorque, 0.03),
    "removed.friction.elevation-gone": OtherForm("removed.friction.elevation", OnAxis(NoFriction, 0), 1.0),
    "removed.friction.pitch-gone": OtherForm("removed.friction.pitch", OnAxis(NoFriction, 1), 1.0),
    "removed.friction.travel-gone": OtherForm("removed.friction.travel", OnAxis(NoFriction, 2), 1.0),
    "removed.dead_zone-gone": OtherForm("removed.dead_zone", NoDeadZone, 1.0),
    "removed.pendulum.elevation-gone": OtherForm(
        "removed.pendulum.elevation", OnAxis(NoPendulum, ("long_arm", "counterweight", "body")), 1.0
    ),
    "removed.pendulum.pitch-gone": OtherForm(
        "removed.pendulum.pitch", OnAxis(NoPendulum, ("short_arm", "front_rotor", "back_rotor")), 1.0
    ),
}
"""Effect, factory and size of cases of one size: other forms, and absent terms of the baseline."""


class SpeedLag(HiddenEffect):
    """Thrust is the square of a rotor speed that lags; `size` is the time constant in s."""

    # It acts first.
    # At 2 V the thrust equals that of the straight line with a dead zone of 1 V.

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._speed_V = np.zeros(2)
        self._rho = np.exp(-STEP_S / size)

    def thrust(self, at: Moment) -> None:
        before = self._speed_V
        self._speed_V = at.volts_V + (before - at.volts_V) * self._rho
        speed_V = 0.5 * (before + self._speed_V)
        at.thrust_N = at.gain_N_per_V * speed_V * np.abs(speed_V) / 4.0


class Flywheels(SpinningRotors):
    """Rotors act as flywheels that lag by 0.1 s; `size` is the angular momentum in N m s per volt."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        super().__init__(size, rng)
        self._both_V = 0.0

    def torque(self, at: Moment) -> None:
        self._both_V += (float(at.volts_V.sum()) - self._both_V) * (1.0 - np.exp(-STEP_S / 0.1))
        thrust_N, at.thrust_N = at.thrust_N, np.array([self._both_V, 0.0])
        super().torque(at)
        at.thrust_N = thrust_N


class SupplyFade(HiddenEffect):
    """The supply decreases steadily; `size` is the share of the voltage lost in a minute."""

    def volts(self, at: Moment) -> None:
        at.volts_V = at.volts_V * (1.0 - self.size * at.flight_s / 60.0)


class PitchDrag(HiddenEffect):
    """Air drag of the pitch axis; `size` is the torque in N m at 1 rad/s."""

    def torque(self, at: Moment) -> None:
        rate = at.rates_rad_s[1]
        at.torque_Nm[1] -= self.size * rate * abs(rate)


MEASURED_EFFECTS: dict[str, tuple[Maker, float]] = {
    "rotor_speed_lag": (SpeedLag, 0.11),
    "flywheel": (Flywheels, 0.015),
    "supply_fade": (SupplyFade, 0.08),
    "pitch_drag_quadratic": (PitchDrag, 0.08),
}
"""Factory of each, and its typical size."""
