"""The common part of all models of the rig: names, symbols, and the chain from voltage to measured angle.

A model defines how thrust and torque become angular acceleration (`Model.acceleration`). Everything before
that, voltage to thrust and friction to torque, is shared. An `Effect` changes one step of that chain and may
add its own parameters and states.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Collection
from dataclasses import replace
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from typing_extensions import override

from heli_sim.errors import PlantError
from heli_sim.model.effect import AXES, Effect, Operands, Stage, friction_torque_Nm, thrust_N
from heli_sim.rig import RIG_QUANTITIES, Rig
from heli_sim.rig.schema import ENCODER_COUNTS, Quantity

__all__ = ["INPUTS", "STATES", "Effect", "Model", "Operands", "Stage"]


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

_SHARED: Final = (
    *("thrust_gain", "dead_zone", "reverse_thrust"),
    *(f"{kind}_{axis}" for kind in ("friction", "torque") for axis in AXES),
    *("offset_elevation", "offset_pitch"),
    # What a measured angle shows of a rate depends on the size of a count.
    *ENCODER_COUNTS,
)
_RIG: Final = {quantity.name: quantity for quantity in RIG_QUANTITIES}


class Model(ABC):
    """Equations of motion of a rig, d/dt x = dynamics(x, u, p).

    Parameters
    ----------
    effects : tuple of Effect
        Effects on top of the model, in any order; they are applied by their stage.

    Raises
    ------
    PlantError
        When two effects bring the same parameter or state, a parameter has the name of a rig's number, or two
        effects delay the voltages.
    """

    name: str
    """Short name of the model."""
    rig_parameters: tuple[str, ...]
    """Names of the rig parameters that the model itself uses."""

    def __init__(self, effects: tuple[Effect, ...] = ()) -> None:
        self.effects = effects = tuple(sorted(effects, key=lambda effect: effect.stage))
        self.states: tuple[Quantity, ...] = STATES + tuple(s for e in effects for s in e.states)
        self.inputs: tuple[Quantity, ...] = INPUTS
        names = dict.fromkeys(self.rig_parameters + _SHARED)
        self.parameters: tuple[Quantity, ...] = tuple(_RIG[name] for name in names) + tuple(
            parameter for effect in effects for parameter in effect.parameters
        )
        effect_parameters = [q.name for q in self.parameters[len(names) :]]
        all_names = [s.name for s in self.states] + effect_parameters
        conflicts = {name for name in all_names if all_names.count(name) > 1}
        conflicts |= {name for name in effect_parameters if name in _RIG}
        if conflicts:
            raise PlantError(
                f"effects of '{self.name}' share the names {', '.join(sorted(conflicts))}",
                "give each another name",
            )
        delays = [effect.delay for effect in effects if effect.delay]
        if len(delays) > 1:
            raise PlantError(
                f"{' and '.join(delays)} both delay the voltages of '{self.name}'", "leave one of them out"
            )
        self.delay: str = delays[0] if delays else ""
        """Name of the parameter by which the voltages act late, or empty."""

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of `parameters`, in their order."""
        return tuple(quantity.name for quantity in self.parameters)

    @property
    def is_plain(self) -> bool:
        """Whether the class alone determines the equations: no effects, and no constructor of its own."""
        return not self.effects and type(self).__init__ is Model.__init__

    # Plain models of a class are equal, so that what is derived from their equations is derived once.
    def __eq__(self, other: object) -> bool:
        if isinstance(other, Model) and self.is_plain and other.is_plain:
            return type(self) is type(other)
        return self is other

    def __hash__(self) -> int:
        return hash(type(self)) if self.is_plain else object.__hash__(self)

    def values_in(self, label: str, values: Floats) -> Floats:
        """Return the values of all parameters in one flight, named by `label`.

        They differ between flights if an effect is an event, such as a step of the thrust: its moment belongs
        to one flight, and in the others the event never happens.

        Parameters
        ----------
        values : ndarray (p,)
            Values of all parameters, in the order of `parameters`.
        """
        result = values.copy()
        for effect in self.effects:
            if effect.flight and effect.moment:
                index = self.parameter_names.index(effect.moment)
                result[index] = effect.values_in(label, {effect.moment: values[index]})[effect.moment]
        return result

    def dead_zone_V(self, parameters: Floats, free: Collection[str] = ()) -> float | None:
        """Return the voltage below which no rotor gives thrust, if there is one.

        Parameters
        ----------
        parameters : ndarray (p,)
            All parameters, in the order of `parameters`.
        free : collection of str
            Parameters that are being estimated; the result must hold for all their values.

        Returns
        -------
        float or None
            None if rotors may push at lower voltages, because they can be reversed or by an effect.
        """
        names = self.parameter_names
        if parameters[names.index("reverse_thrust")] or "reverse_thrust" in free:
            return None
        if any(effect.pushes_below_dead_zone for effect in self.effects):
            return None
        return float(parameters[names.index("dead_zone")])

    @abstractmethod
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        """Return the angular acceleration of elevation, pitch and travel [rad/s2], shape (3, 1).

        A locked axis (`Operands.locked`) does not accelerate. Its lock gives the torque that this needs,
        which also changes the acceleration of axes that are coupled with it.

        Parameters
        ----------
        thrust_N : casadi.SX
            Thrust of the front and the back rotor, shape (2, 1).
        torque_Nm : casadi.SX
            Friction and other torques about the elevation, pitch and travel axes, shape (3, 1), without those
            of gravity and thrust, which the model adds.
        """

    def operands(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, locked: ca.SX | None = None
    ) -> Operands:
        """Collect the arguments of an equation by the names of states and parameters.

        Parameters
        ----------
        x : casadi.SX
            State, in the order of `states`.
        u : casadi.SX
            Voltages, in the order of `inputs`.
        p : casadi.SX
            Parameters, in the order of `parameters`.
        time_s : casadi.SX, optional
            Time since the flight's first sample; 0 by default.
        locked : casadi.SX, optional
            1 for each locked axis, shape (3, 1); by default, no axis is locked.
        """
        return Operands(
            {state.name: x[i] for i, state in enumerate(self.states)},
            u,
            {parameter.name: p[i] for i, parameter in enumerate(self.parameters)},
            ca.SX(0) if time_s is None else time_s,
            ca.SX.zeros(3) if locked is None else locked,
        )

    def dynamics(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, locked: ca.SX | None = None
    ) -> ca.SX:
        """Return the rate of each state in its unit per second.

        `x`, `u`, `p`, `time_s` and `locked` are those of `operands`; `u` are the voltages that act, after any
        delay. A locked axis does not accelerate.
        """
        at, effect_rates = self._torque_operands_and_state_rates(x, u, p, time_s, locked)
        parameter, thrust = at.parameter, at.thrust_N
        constant = ca.vertcat(*(parameter[f"torque_{axis}"] for axis in AXES))
        torque = friction_torque_Nm(x[3:6], parameter) + constant
        for effect in self.effects:
            torque = torque + effect.torque_Nm(at)
        acceleration = self._with_friction(at, thrust, self.acceleration(at, thrust, torque))
        return ca.vertcat(x[3:6], (1 - at.locked) * acceleration, *effect_rates)

    def driven(self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None) -> Operands:
        """Return the operands as the torques see them: with the voltages and thrusts after all effects.

        `x`, `u`, `p` and `time_s` are those of `operands`.
        """
        return self._torque_operands_and_state_rates(x, u, p, time_s, locked=None)[0]

    def _torque_operands_and_state_rates(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None, locked: ca.SX | None
    ) -> tuple[Operands, list[ca.SX]]:
        """Return the operands of the torques, and the rates of the states that the effects add."""
        at = self._with_modified_parameters(self.operands(x, u, p, time_s, locked))
        for effect in self.effects:
            at = replace(at, volts_V=effect.voltage_V(at, at.volts_V))
        parameter = at.parameter
        thrust = thrust_N(
            at.volts_V, parameter["thrust_gain"], parameter["dead_zone"], parameter["reverse_thrust"]
        )
        rates = []
        for effect in self.effects:
            at = replace(at, thrust_N=thrust)
            thrust = effect.thrust_N(at, thrust)
            if effect.states:
                rates.append(effect.state_rates(at))
        return replace(at, thrust_N=thrust), rates

    def _with_friction(self, at: Operands, thrust: ca.SX, acceleration: ca.SX) -> ca.SX:
        """Add the effect of dry friction, whose torque depends on the acceleration without it."""
        # In each model, the acceleration is linear in the torque; the factor is the mobility, shape (3, 3).
        frictional = [effect for effect in self.effects if effect.has_friction]
        if not frictional:
            return acceleration
        torque = ca.SX.sym("torque", 3)
        mobility = ca.jacobian(self.acceleration(at, thrust, torque), torque)
        # A locked axis has a mobility of 0; its lock, 1, keeps the reciprocal finite.
        inertia = 1 / (ca.diag(mobility) + at.locked)
        friction = [effect.friction_Nm(at, acceleration, inertia) for effect in frictional]
        return acceleration + mobility @ sum(friction, ca.SX.zeros(3))

    def reset_map(self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None) -> ca.SX:
        """Return the state after the resets that effects make at the end of each integration step.

        An example is play, whose state jumps. `x` and `time_s` are the state and time after the step; `u` and
        `p` are those of `operands`. The result is `x` if no effect resets a state.
        """
        at = self._with_modified_parameters(self.operands(x, u, p, time_s))
        return ca.vertcat(x[:6], *(effect.reset_map(at) for effect in self.effects if effect.states))

    def diffusion(self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX, step_s: float, normal: ca.SX) -> ca.SX:
        """Return the increment of the state in one step of a simulation by the noise that drives the effects.

        Parameters
        ----------
        x : casadi.SX
            State after the step, in the order of `states`.
        u : casadi.SX
            Voltages that act, in the order of `inputs`.
        p : casadi.SX
            Parameters, in the order of `parameters`.
        time_s : casadi.SX
            Time after the step.
        step_s : float
            Length of the step.
        normal : casadi.SX
            Independent random numbers with mean 0 and variance 1, shape (noise_inputs, 1).
        """
        at = self._with_modified_parameters(self.operands(x, u, p, time_s))
        increments, first = [ca.SX.zeros(6)], 0
        for effect in self.effects:
            if effect.states:
                increments.append(effect.diffusion(at, step_s, normal[first : first + effect.noise_inputs]))
                first += effect.noise_inputs
        return ca.vertcat(*increments)

    @property
    def noise_inputs(self) -> int:
        """Dimension of the white noise that drives the states of the effects in a simulation."""
        return sum(effect.noise_inputs for effect in self.effects)

    def _with_modified_parameters(self, at: Operands) -> Operands:
        """Let each effect replace parameters of the rig; a later effect sees what earlier ones replaced."""
        for effect in self.effects:
            at = replace(at, parameter={**at.parameter, **effect.modified_parameters(at)})
        return at

    def measurement(self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None) -> ca.SX:
        """Return the angles that encoders without quantisation would measure [rad], shape (3, 1).

        These are elevation, pitch and travel of the state, with zero offsets and with the effects that act in
        the encoders. `x`, `u`, `p` and `time_s` are those of `operands`.
        """
        at = self._with_modified_parameters(self.operands(x, u, p, time_s))
        offsets_deg = ca.vertcat(at.parameter["offset_elevation"], at.parameter["offset_pitch"], 0)
        angles = x[0:3] + offsets_deg * (np.pi / 180.0)
        for effect in self.effects:
            angles = effect.measured_rad(at, angles)
        return angles

    def parameter_values(self, rig: Rig) -> Floats:
        """Return the values of `parameters`, from the `rig` and the effects, shape (len(parameters),)."""
        effect_values = {name: value for effect in self.effects for name, value in effect.values.items()}
        return np.array(
            [rig[q.name].value if q.name in rig else effect_values[q.name] for q in self.parameters]
        )


class Locked(Model):
    """A model with locked axes: they do not accelerate, and the others feel the reactions of the locks."""

    def __init__(self, model: Model, locked: tuple[bool, bool, bool]) -> None:
        self._model = model
        self._locked = ca.SX([float(is_locked) for is_locked in locked])
        locked_axes = [axis for axis, is_locked in zip(AXES, locked, strict=True) if is_locked]
        self.name = f"{model.name} with {' and '.join(locked_axes) or 'nothing'} locked"
        self.effects = model.effects
        self.states, self.inputs, self.parameters = model.states, model.inputs, model.parameters
        self.delay = model.delay

    @override
    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        return self._model.acceleration(at, thrust_N, torque_Nm)

    @override
    def dynamics(
        self, x: ca.SX, u: ca.SX, p: ca.SX, time_s: ca.SX | None = None, locked: ca.SX | None = None
    ) -> ca.SX:
        # A locked axis keeps its rate. A fit estimates that rate from the flight, and finds that it is 0.
        all_locked = self._locked if locked is None else ca.fmax(self._locked, locked)
        return self._model.dynamics(x, u, p, time_s, all_locked)

    @override
    def parameter_values(self, rig: Rig) -> Floats:
        return self._model.parameter_values(rig)
