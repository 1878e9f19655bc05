"""The base class of effects, and equations that all models of the rig share."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Final

import casadi as ca
from heli_host.declaration import AXES

from heli_sim.rig.schema import Prior, Quantity

__all__ = [
    "AXES",
    "friction_torque_Nm",
    "on_axis",
    "rotor_climb_m_s",
    "rotor_height_m",
    "smooth_step",
    "thrust_N",
    "upright_torque_Nm",
]


_STEP_WIDTH_s: Final = 0.01


def thrust_N(volts_V: ca.SX, gain_N_per_V: ca.SX, dead_zone_V: ca.SX, reverse: ca.SX | float = 0.0) -> ca.SX:
    """Return the thrust of rotors at given voltages: F = k (V - V_0) above V_0, otherwise 0 (equation 31)."""
    # The paper measured only positive voltages. A rotor that can be driven backwards gives, beyond the dead
    # zone, a share of this thrust in the opposite direction.
    forward_V = ca.fmax(volts_V - dead_zone_V, 0.0)
    backward_V = ca.fmax(-volts_V - dead_zone_V, 0.0)
    return gain_N_per_V * (forward_V - reverse * backward_V)


def friction_torque_Nm(rates_rad_s: ca.SX, parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Return the viscous friction of the three bearings, R = -f rate, shape (3, 1): equations 12, 17, 21."""
    # `rates_rad_s` holds the rates of elevation, pitch and travel, shape (3, 1). The coefficients in
    # `parameter` are friction_elevation, friction_pitch and friction_travel in N m s/rad.
    coefficients = ca.vertcat(
        parameter["friction_elevation"], parameter["friction_pitch"], parameter["friction_travel"]
    )
    return -coefficients * rates_rad_s


def rotor_climb_m_s(state: Mapping[str, ca.SX], parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Return the speed of the front and the back rotor along the thrust axis, shape (2, 1)."""
    # The speed is positive if the rotor climbs. It depends on the angles and rates in `state`, and on L_a,
    # L_h and L_theta in `parameter` [m]. It follows from virtual work: thrust times climb is the power that
    # the thrust gives to the axes.
    cos_elevation, sin_elevation = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    cos_pitch, sin_pitch = ca.cos(state["pitch_rad"]), ca.sin(state["pitch_rad"])
    travel_rad_s = state["travel_rate_rad_s"]
    mean_m_s = (
        parameter["L_a"] * cos_pitch * state["elevation_rate_rad_s"]
        + (parameter["L_a"] * cos_elevation + parameter["L_theta"] * sin_elevation) * sin_pitch * travel_rad_s
    )
    difference_m_s = parameter["L_h"] * (state["pitch_rate_rad_s"] - sin_elevation * travel_rad_s)
    return ca.vertcat(mean_m_s + difference_m_s, mean_m_s - difference_m_s)


def rotor_height_m(state: Mapping[str, ca.SX], parameter: Mapping[str, ca.SX]) -> ca.SX:
    """Return the height of the front and the back rotor above the elevation axis, shape (2, 1)."""
    # Cosine and sine of the elevation.
    c, s = ca.cos(state["elevation_rad"]), ca.sin(state["elevation_rad"])
    mean_m = parameter["L_a"] * s - parameter["L_theta"] * c
    difference_m = parameter["L_h"] * ca.sin(state["pitch_rad"]) * c
    return ca.vertcat(mean_m + difference_m, mean_m - difference_m)


def upright_torque_Nm(state: Mapping[str, ca.SX], torque_Nm: ca.SX) -> ca.SX:
    """Convert a torque about the thrust direction of the short arm to torques about the axes, shape (3,
    1).
    """
    pitch, elevation = state["pitch_rad"], state["elevation_rad"]
    return torque_Nm * ca.vertcat(-ca.sin(pitch), 0, ca.cos(pitch) * ca.cos(elevation))


def smooth_step(time_s: ca.SX, moment_s: ca.SX) -> ca.SX:
    """Return 0 before and 1 after `moment_s` as a function of `time_s` [s], smoothed over about 20 ms."""
    # The smoothing gives the step a derivative by the moment, which a fit needs.
    return 0.5 * (1 + ca.tanh((time_s - moment_s) / _STEP_WIDTH_s))


def on_axis(axis: str, value: ca.SX) -> ca.SX:
    """Return a vector over the axes, shape (3, 1), with `value` for one `axis` and 0 for the others."""
    return ca.vertcat(*(value if axis == name else ca.SX(0) for name in AXES))


@dataclass(frozen=True)
class Operands:
    """Operands of an equation, by name.

    Parameters
    ----------
    state : Mapping[str, casadi.SX]
        Scalars by state name, those of effects included.
    volts_V : casadi.SX
        Voltages that act on the front and the back motor, shape (2, 1).
    parameter : Mapping[str, casadi.SX]
        Scalars by parameter name, in the units of `Model.parameters`.
    time_s : casadi.SX
        Time since the flight's first sample.
    locked : casadi.SX
        1 for each of elevation, pitch and travel that is locked, else 0; shape (3, 1).
    thrust_N : casadi.SX
        Thrust of the front and the back rotor, shape (2, 1). For torques, it is the final thrust; for thrusts
        and for rates of an effect's states, the thrust after the effects before it; for measurements, zero.
    """

    state: Mapping[str, ca.SX]
    volts_V: ca.SX
    parameter: Mapping[str, ca.SX]
    time_s: ca.SX = field(default_factory=lambda: ca.SX(0))
    locked: ca.SX = field(default_factory=lambda: ca.SX.zeros(3))
    thrust_N: ca.SX = field(default_factory=lambda: ca.SX.zeros(2))


NEVER_s: Final = 1e6
"""Moment of what does not happen in a flight: eleven days. The step function is exactly 0 before."""


class Stage(IntEnum):
    """Place in the chain from voltage to angle where an effect acts. A model sorts its effects by it; effects
    of the same stage must give the same result in any order.
    """

    SUPPLY = 0
    """The supply without load."""
    SPEED = 1
    """Speed of motor and propeller, from which the thrust follows."""
    CURVE = 2
    """The static curve of thrust against voltage."""
    GAIN = 3
    """A factor on a rotor's thrust."""
    LAG = 4
    """Thrust, which follows a speed that cannot jump."""
    INFLOW = 5
    """The air that the propeller meets."""
    GROUND = 6
    """The air that the propeller leaves behind."""
    TORQUE = 7
    """Torques about the axes."""
    PLAY = 8
    """Between an axis and its encoder's shaft."""
    SHAFT = 9
    """On the encoder's shaft."""
    ZERO = 10
    """Where the encoder's zero is."""


@dataclass(frozen=True)
class Effect:
    """Something that a model lacks; a subclass overrides the steps that it changes.

    Parameters
    ----------
    name : str
        Name of the effect, followed by its axis or rotor if any, as in ``coulomb_friction.travel``.
    parameters : tuple of Quantity
        Parameters that the effect adds to those of the rig. Their names begin with `prefix`.
    values : Mapping[str, float]
        Value of each of `parameters`.
    states : tuple of Quantity
        States that the effect adds; they start at 0. Their names begin with `prefix`.
    priors : Mapping[str, Prior]
        Distributions before a flight, for the `parameters` that may be estimated; the others are fixed.
    delay : str
        Name of the parameter that is a delay of the voltages, in s; empty for no delay. Programs that
        integrate the model must pass it voltages that are delayed by this time.
    noise_inputs : int
        Dimension of the white noise that drives its states in a simulation.
    measured_as : Mapping[str, str]
        Axis of each state that an encoder measures, by the state's name: at any moment of a flight, the
        value of this state is the measured angle.
    direction_of : Mapping[str, str]
        Axis of each state that is the direction in which the axis moved last, -1 to 1, by the state's name.
        A measured flight shows this direction.
    multimodal : tuple of str
        Names of the parameters in which the likelihood is multimodal, such as a frequency. A fit has to start
        near their values, and holds them while other parameters are still far from their estimates.
    linearisable : bool
        True if a linear model at hover contains the effect.
    flight : str
        Label of the flight in which it happens at the moment ``at_s``; empty if it happens in every flight.
    other_moments_s : Mapping[str, float]
        With `flight`: moments in further flights, by label. In all other flights, it never happens.
    """

    name: str
    parameters: tuple[Quantity, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    states: tuple[Quantity, ...] = ()
    priors: Mapping[str, Prior] = field(default_factory=dict)
    delay: str = ""
    stage: Stage = Stage.GAIN
    noise_inputs: int = 0
    measured_as: Mapping[str, str] = field(default_factory=dict)
    direction_of: Mapping[str, str] = field(default_factory=dict)
    multimodal: tuple[str, ...] = ()
    linearisable: bool = False
    flight: str = ""
    other_moments_s: Mapping[str, float] = field(default_factory=dict)

    # Equal effects have equal hashes, so that what is made for a set of effects can be cached.
    def __hash__(self) -> int:
        return hash((self.name, frozenset(self.values.items())))

    @property
    def prefix(self) -> str:
        """First part of the names of its parameters and states: the effect's name with underscores for
        dots.
        """
        return self.name.replace(".", "_")

    @property
    def place(self) -> str:
        """Axis or rotor: the last part of the effect's name, after the last dot."""
        return self.name.rpartition(".")[2]

    @property
    def moment(self) -> str:
        """Name of the parameter that is the moment of the event; empty if the effect has none."""
        name = f"{self.prefix}_at_s"
        return name if any(quantity.name == name for quantity in self.parameters) else ""

    def values_in(self, label: str, values: Mapping[str, float]) -> dict[str, float]:
        """Return the parameter `values` in the flight `label`: the moment of an event belongs to one
        flight.
        """
        result = {**values}
        if self.flight and label != self.flight and self.moment:
            result[self.moment] = self.other_moments_s.get(label, NEVER_s)
        return result

    def value(self, at: Operands, short_name: str) -> ca.SX:
        """Value of one of the effect's own parameters or states, in its unit.

        Parameters
        ----------
        at : Operands
            All parameters and states of the model, by full name.
        short_name : str
            Name without the effect's prefix, such as ``share``: the model knows that of the effect
            ``thrust_step.front`` as ``thrust_step_front_share``.
        """
        full_name = f"{self.prefix}_{short_name}"
        return at.parameter[full_name] if full_name in at.parameter else at.state[full_name]

    def modified_parameters(self, at: Operands) -> Mapping[str, ca.SX]:
        """Rig parameters by name, after the effect has modified them and before they are used."""
        return {}

    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        """Change the voltages `volts_V` of the front and the back motor, shape (2, 1), before the thrust
        curve.
        """
        return volts_V

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Change the thrust `thrust_N` of the front and the back rotor, shape (2, 1)."""
        return thrust_N

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Add a torque about the elevation, pitch and travel axes, shape (3, 1); `at` holds the present
        state, voltages and parameters, and the final thrust.
        """
        return ca.SX.zeros(3)

    def friction_Nm(self, at: Operands, acceleration_rad_s2: ca.SX, inertia_kg_m2: ca.SX) -> ca.SX:
        """Add a torque, shape (3, 1), that depends on the acceleration without this torque, as dry friction
        does at standstill.

        Parameters
        ----------
        at : Operands
            Present state, voltages and parameters, and the final thrust.
        acceleration_rad_s2 : casadi.SX
            Acceleration of elevation, pitch and travel without any such torque, shape (3, 1).
        inertia_kg_m2 : casadi.SX
            Torque about each axis over the acceleration that it gives that axis, shape (3, 1).
        """
        return ca.SX.zeros(3)

    @property
    def pushes_below_dead_zone(self) -> bool:
        """Whether rotors may give thrust at voltages within the rig's dead zone."""
        return False

    @property
    def has_friction(self) -> bool:
        """Whether the effect overrides `friction_Nm`."""
        return type(self).friction_Nm is not Effect.friction_Nm

    def energy_J(self, at: Operands) -> ca.SX:
        """Potential energy of the effect's torque, such as a spring's; 0 if it has none."""
        return ca.SX(0)

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Change the angles `angles_rad` of elevation, pitch and travel, shape (3, 1), that the encoders
        measure.
        """
        return angles_rad

    def state_rates(self, at: Operands) -> ca.SX:
        """Time derivatives of the states that the effect adds: one for each of `states`, in its unit per
        second.
        """
        return ca.SX.zeros(len(self.states))

    def with_measured_angles(self) -> Effect:
        """The same effect for flights whose angles were measured. If measured angles make the effect simpler,
        this is another effect with the same parameters.
        """
        return self

    def alternative_starts(self, parameters: Mapping[str, float]) -> tuple[Mapping[str, float], ...]:
        """Other initial states from which a prediction may have to start, if the angles do not determine
        them.

        Each is a mapping from names of states to offsets from the values that the measured angles suggest,
        computed with the values of all `parameters` of the model.
        """
        return ()

    def reset_map(self, at: Operands) -> ca.SX:
        """Reset the states that the effect adds, in the order of `states`, after a step of any length, for
        changes that rates do not describe, such as backlash. `at` holds voltages, parameters and the state
        after the step.
        """
        return ca.vertcat(*(at.state[state.name] for state in self.states))

    def diffusion(self, at: Operands, step_s: float, normal: ca.SX) -> ca.SX:
        """Increment of the states that the effect adds, in the order of `states`, by their driving noise in
        one step of a simulation. A fit leaves it out.

        Parameters
        ----------
        at : Operands
            State after the step, voltages and parameters.
        step_s : float
            Length of the step.
        normal : casadi.SX
            Independent random numbers with mean 0 and variance 1, shape (noise_inputs, 1).
        """
        return ca.SX.zeros(len(self.states))
