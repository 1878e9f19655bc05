"""What every model of the rig has in common: names, symbols, and the places where an effect may act.

A model says how thrust and torque become angular acceleration (`Model.acceleration`). Everything before that,
voltage to thrust and friction to torque, is shared; an `Effect` changes one step of that chain and may bring
parameters and states of its own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import casadi as ca
import numpy as np
import numpy.typing as npt

from heli_sim.errors import PlantError
from heli_sim.model.parts import friction_torque_Nm, thrust_N
from heli_sim.rig import RIG_QUANTITIES, Rig
from heli_sim.rig.quantity import Prior, Quantity

STATES: Final[tuple[Quantity, ...]] = (
    Quantity("elevation_rad", "rad", "long arm above level, up positive"),
    Quantity("pitch_rad", "rad", "short arm, front rotor up positive"),
    Quantity("travel_rad", "rad", "about the vertical; positive pitch accelerates it"),
    Quantity("elevation_rate_rad_s", "rad/s", "rate of elevation_rad"),
    Quantity("pitch_rate_rad_s", "rad/s", "rate of pitch_rad"),
    Quantity("travel_rate_rad_s", "rad/s", "rate of travel_rad"),
)
INPUTS: Final[tuple[Quantity, ...]] = (
    Quantity("front_V", "V", "voltage that acts on the front motor"),
    Quantity("back_V", "V", "voltage that acts on the back motor"),
)
_AXES: Final = ("elevation", "pitch", "travel")
_SHARED: Final = (
    *("thrust_gain", "dead_zone", "reverse_thrust"),
    *(f"{kind}_{axis}" for kind in ("friction", "torque") for axis in _AXES),
    *("offset_elevation", "offset_pitch"),
)
_RIG: Final = {quantity.name: quantity for quantity in RIG_QUANTITIES}


@dataclass(frozen=True)
class Situation:
    """What an equation may look at, by name.

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
    pinned : casadi.SX
        1 for each of elevation, pitch and travel that a pin holds, else 0; shape (3, 1).
    """

    state: Mapping[str, ca.SX]
    volts_V: ca.SX
    parameter: Mapping[str, ca.SX]
    time_s: ca.SX = field(default_factory=lambda: ca.SX(0))
    pinned: ca.SX = field(default_factory=lambda: ca.SX.zeros(3))


@dataclass(frozen=True)
class Effect:
    """Something that a model lacks; a subclass overrides the steps that it changes.

    Parameters
    ----------
    name : str
        Name of the effect, with its axis or rotor where it has one.
    parameters : tuple of Quantity
        Numbers of its own, none of them a number of the rig.
    values : Mapping[str, float]
        Value of each of `parameters`.
    states : tuple of Quantity
        States of its own; they start at 0.
    priors : Mapping[str, Prior]
        What is known of each of `parameters` before a flight; needed to identify it.
    delay : str
        Name of the one of `parameters`, in s, by which the voltages act late; empty for no delay. Whoever
        integrates the model hands it voltages that are late by this much.
    """

    name: str
    parameters: tuple[Quantity, ...] = ()
    values: Mapping[str, float] = field(default_factory=dict)
    states: tuple[Quantity, ...] = ()
    priors: Mapping[str, Prior] = field(default_factory=dict)
    delay: str = ""

    def thrust_N(self, at: Situation, thrust_N: ca.SX) -> ca.SX:
        """Change the thrust.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Thrust of the front and the back rotor before this effect, shape (2, 1).

        Returns
        -------
        casadi.SX
            Thrust with this effect, shape (2, 1).
        """
        return thrust_N

    def torque_Nm(self, at: Situation) -> ca.SX:
        """Add a torque.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.

        Returns
        -------
        casadi.SX
            Torque about the elevation, pitch and travel axes, shape (3, 1).
        """
        return ca.SX.zeros(3)

    def measured_rad(self, at: Situation, angles_rad: ca.SX) -> ca.SX:
        """Change what the encoders see.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        angles_rad : casadi.SX
            Elevation, pitch and travel before this effect, shape (3, 1).

        Returns
        -------
        casadi.SX
            Angles with this effect, shape (3, 1).
        """
        return angles_rad

    def state_rates(self, at: Situation) -> ca.SX:
        """Time derivatives of the effect's own states.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.

        Returns
        -------
        casadi.SX
            One rate for each of `states`, in its unit per second.
        """
        return ca.SX.zeros(len(self.states))


class Model(ABC):
    """Equations of motion of a rig, d/dt x = dynamics(x, u, p).

    Parameters
    ----------
    effects : tuple of Effect
        Effects on top of the model, applied in this order.

    Raises
    ------
    PlantError
        When two effects bring the same parameter or state, a parameter has the name of a rig's number, or two
        effects delay the voltages.
    """

    name: str
    """Short name of the model."""
    rig_parameters: tuple[str, ...]
    """Names of the rig's numbers that the model itself uses."""

    def __init__(self, effects: tuple[Effect, ...] = ()) -> None:
        self.effects = effects
        self.states: tuple[Quantity, ...] = STATES + tuple(s for e in effects for s in e.states)
        self.inputs: tuple[Quantity, ...] = INPUTS
        names = dict.fromkeys(self.rig_parameters + _SHARED)
        self.parameters: tuple[Quantity, ...] = tuple(_RIG[name] for name in names) + tuple(
            parameter for effect in effects for parameter in effect.parameters
        )
        own = [q.name for q in self.parameters[len(names) :]]
        every = [s.name for s in self.states] + own
        twice = sorted({name for name in every if every.count(name) > 1 or (name in own and name in _RIG)})
        if twice:
            raise PlantError(f"effects of '{self.name}' share the names {', '.join(twice)}; rename them")
        delays = [effect.delay for effect in effects if effect.delay]
        if len(delays) > 1:
            raise PlantError(f"{' and '.join(delays)} both delay the voltages of '{self.name}'; keep one")
        self.delay: str = delays[0] if delays else ""
        """Name of the parameter by which the voltages act late, or empty."""

    @abstractmethod
    def acceleration(self, at: Situation, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        """Angular acceleration under given thrust and torque.

        A pinned axis (`Situation.pinned`) has none, and its pin gives whatever torque that takes: where axes
        are coupled, the others accelerate otherwise than they would with that axis free.

        Parameters
        ----------
        at : Situation
            Present state, voltages and parameters.
        thrust_N : casadi.SX
            Thrust of the front and the back rotor, shape (2, 1).
        torque_Nm : casadi.SX
            Friction and other torques about the elevation, pitch and travel axes, shape (3, 1); gravity and
            thrust are the model's own business.

        Returns
        -------
        casadi.SX
            Acceleration of elevation, pitch and travel in rad/s2, shape (3, 1).
        """

    def situation(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, pinned: ca.SX | None = None
    ) -> Situation:
        """Name the entries of the three vectors.

        Parameters
        ----------
        x : casadi.SX
            State, in the order of `states`.
        u : casadi.SX
            Voltages, in the order of `inputs`.
        p : casadi.SX
            Parameters, in the order of `parameters`.
        time_s : casadi.SX, optional
            Time since the flight's first sample; 0 where it is not given.
        pinned : casadi.SX, optional
            1 for each axis that a pin holds, shape (3, 1); none where it is not given.

        Returns
        -------
        Situation
            The same expressions by name.
        """
        return Situation(
            {state.name: x[i] for i, state in enumerate(self.states)},
            u,
            {parameter.name: p[i] for i, parameter in enumerate(self.parameters)},
            ca.SX(0) if time_s is None else time_s,
            ca.SX.zeros(3) if pinned is None else pinned,
        )

    def dynamics(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, pinned: ca.SX | None = None
    ) -> ca.SX:
        """Time derivative of the state.

        Parameters
        ----------
        x : casadi.SX
            State, in the order of `states`.
        u : casadi.SX
            Voltages that act, in the order of `inputs`.
        p : casadi.SX
            Parameters, in the order of `parameters`.
        time_s : casadi.SX, optional
            Time since the flight's first sample; 0 where it is not given.
        pinned : casadi.SX, optional
            1 for each axis that a pin holds, shape (3, 1); none where it is not given.

        Returns
        -------
        casadi.SX
            Rate of each state in its unit per second. A pinned axis does not accelerate.
        """
        at = self.situation(x, u, p, time_s, pinned)
        p_at = at.parameter
        thrust = thrust_N(at.volts_V, p_at["thrust_gain"], p_at["dead_zone"], p_at["reverse_thrust"])
        torque = friction_torque_Nm(x[3:6], p_at) + ca.vertcat(*(p_at[f"torque_{axis}"] for axis in _AXES))
        for effect in self.effects:
            thrust = effect.thrust_N(at, thrust)
            torque = torque + effect.torque_Nm(at)
        rates = [effect.state_rates(at) for effect in self.effects if effect.states]
        acceleration = (1 - at.pinned) * self.acceleration(at, thrust, torque)
        return ca.vertcat(x[3:6], acceleration, *rates)

    def measurement(self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None) -> ca.SX:
        """Angles that encoders without steps would show: those of the state, their zero's offset, effects.

        Parameters
        ----------
        x : casadi.SX
            State, in the order of `states`.
        u : casadi.SX
            Voltages that act, in the order of `inputs`.
        p : casadi.SX
            Parameters, in the order of `parameters`.
        time_s : casadi.SX, optional
            Time since the flight's first sample; 0 where it is not given.

        Returns
        -------
        casadi.SX
            Elevation, pitch and travel in rad, shape (3, 1).
        """
        at = self.situation(x, u, p, time_s)
        offsets_deg = ca.vertcat(at.parameter["offset_elevation"], at.parameter["offset_pitch"], 0)
        angles = x[0:3] + offsets_deg * (np.pi / 180.0)
        for effect in self.effects:
            angles = effect.measured_rad(at, angles)
        return angles

    def parameter_values(self, rig: Rig) -> npt.NDArray[np.float64]:
        """Numbers for the symbols of `parameters`.

        Parameters
        ----------
        rig : Rig
            Gives the values of its own names; effects give theirs.

        Returns
        -------
        numpy.ndarray
            Values in the units of `parameters`, shape (len(parameters),).
        """
        own = {name: value for effect in self.effects for name, value in effect.values.items()}
        return np.array([rig[q.name].value if q.name in rig else own[q.name] for q in self.parameters])
