"""Equations of a rig as a twin uses them, and the possible changes of the rig in flight.

Each change changes one or two parameters. Effects of the catalogue describe themselves as changes
(`heli_sim.model.effects.ChangeSpec`); this file lists only changes that are no effect of the catalogue. The
errors of the rig's parameters are unknown constants of a flight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.evaluate.trajectories import AlongTrajectory, Trajectory
from heli_sim.model.base import Effect, Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue
from heli_sim.model.effects.spec import format_estimate
from heli_sim.rig import Rig

from heli_lab.fit.flight_model import model_along, model_functions, without_random_effects

SUPPLY: Final = "supply"
"""Parameter of a change that is no parameter of the model: a share of both motor voltages."""
SCALES: Final = {f"encoder_scale_{axis}": axis for axis in AXES}
"""Parameters of changes that are no parameters of the model: a share of the counts per turn of an encoder,
with the axis of each. From the onset on, the encoder adds that share of each turn; its angle does not jump
at the onset."""


@dataclass(frozen=True)
class Change:
    """A hypothesis: from an unknown onset on, one or two rig parameters are different."""

    id: str  # Id of the effect of the catalogue, or another unique name
    parameters: tuple[str, ...]
    """One or two parameters of the extended model that the change adds to, or `SUPPLY`, or one of `SCALES`.
    Parameters joined by ``+`` change by the same amount."""
    sizes: tuple[float, ...]
    """Prior standard deviation of the change of each parameter in flight, SI. A wider prior costs evidence
    (Occam's razor)."""
    unit: str  # Unit of the first parameter
    positive_text: str
    """positive_text, negative_text: Sentence if the first parameter grows or falls; ``{}`` is the amount."""
    negative_text: str
    is_ramp: bool = False  # True if the change grows from its onset at a constant rate; False for a step
    non_negative: bool = False  # True if the first parameter cannot fall
    initial_sizes: tuple[float, ...] = ()
    """Prior standard deviation of each parameter if a flight begins with the difference; empty if the
    difference is as large as a change in flight."""

    @property
    def sizes_from_start(self) -> tuple[float, ...]:
        """Prior standard deviation of each parameter if a flight begins with the difference, SI."""
        return self.initial_sizes or self.sizes

    @property
    def is_scale(self) -> bool:
        """Whether it is a wrong scale of an encoder."""
        return self.parameters[0] in SCALES

    @property
    def is_jump(self) -> bool:
        """Whether it is a jump of an encoder's zero."""
        return self.id.startswith("zero_offset.")

    def words(self, size: float, std: float) -> str:
        """Describe the change by the estimate `size` of its first parameter and the standard error `std`."""
        return (self.negative_text if size < 0 else self.positive_text).format(
            format_estimate(abs(size), std, self.unit)
        )


def _catalogue_changes() -> tuple[Change, ...]:
    """Return the changes that the effects of the catalogue describe."""
    return tuple(
        Change(
            spec.id,
            parameters=spec.change.numbers or (spec.full(spec.numbers[0].name),),
            sizes=spec.change.sizes,
            unit=spec.numbers[0].unit,
            positive_text=spec.change.positive,
            negative_text=spec.change.negative,
            is_ramp=spec.change.is_ramp,
            non_negative=spec.is_one_sided,
        )
        for spec in catalogue().values()
        if spec.change is not None
    )


_SUPPLY_STEP: Final = Change(
    "supply_step",
    parameters=(SUPPLY,),
    sizes=(0.1,),
    unit="1",
    positive_text="the supply lost {} of its voltage",
    negative_text="the supply gained {} of its voltage",
)
SCALE_CHANGE_STD: Final = 0.03
"""Standard deviation of the change of an encoder's scale in flight, as a share: a coupling that slips, or
lines of the disc that dirt hides. By judgement. A gust moves the axis that it disturbs, so the angle since an
onset is correlated with the innovations after it. Without this prior, scales of 24 to 42 % explained gusts:
four of the six highest evidences of `python -m tests.twin` (2026-11). Larger: gusts are taken for a wrong
scale. Smaller: a coupling that slips by a tenth is detected late."""
_WRONG_SCALE_STD: Final = 0.5
"""Standard deviation of the error of a scale with which a flight begins, as a share: a decoder that counts
one edge of two, or a disc with half the lines."""
_ENCODER_SCALES: Final = tuple(
    Change(
        f"encoder_scale.{axis}",
        parameters=(parameter,),
        sizes=(SCALE_CHANGE_STD,),
        unit="1",
        positive_text=f"the {axis} encoder counts {{}} more than its counts per turn",
        negative_text=f"the {axis} encoder counts {{}} fewer than its counts per turn",
        initial_sizes=(_WRONG_SCALE_STD,),
    )
    for parameter, axis in SCALES.items()
)


def all_changes() -> tuple[Change, ...]:
    """Return the changes that effects of the catalogue describe, then those that are no effect."""
    return (*_catalogue_changes(), _SUPPLY_STEP, *_ENCODER_SCALES)


def extended(model: Model, changes: Sequence[Change] | None = None) -> Model:
    """Add the effects of possible changes to a model, of all by default, at values at which they do
    nothing.
    """
    # The derivatives by their parameters are then derivatives by the changes. The effects act from 0 s on.
    # The filter itself sets the derivatives to zero before an onset.
    specs = catalogue()
    present_names = {effect.name for effect in model.effects}
    effects: dict[str, Effect] = {}
    for change in changes_of(model) if changes is None else changes:
        if change.id in specs and change.id not in present_names:
            spec = specs[change.id]
            onsets_s = {name: 0.0 for name in spec.neutral if name.endswith("_at_s")}
            effects[change.id] = spec.make({**spec.neutral, **onsets_s})
    return type(model)((*model.effects, *effects.values()))


def changes_of(model: Model) -> tuple[Change, ...]:
    """Return the possible changes of a rig with these equations."""
    specs = catalogue()

    def is_possible(change: Change) -> bool:
        return change.id not in specs or specs[change.id].suits(model)

    return tuple(filter(is_possible, all_changes()))


def model_parameters(changes: Sequence[Change]) -> tuple[str, ...]:
    """Return the parameters of the extended model that the changes add to, each once."""
    names = (name for change in changes for entry in change.parameters for name in entry.split("+"))
    return tuple(dict.fromkeys(name for name in names if name != SUPPLY and name not in SCALES))


SUPPLY_STD: Final = 0.03
"""Standard deviation of the supply voltage between days, as a share: a supply set by hand, amplifiers that
are warm or cold. By judgement. The first seconds of a flight show the supply to a percent, so this number
hardly matters. Smaller: another day's supply contradicts the rig. Larger: a flight needs longer to
settle."""


@dataclass(frozen=True)
class ParameterUncertainty:
    """Covariance of the errors of a rig's parameters, and the voltages for which these hold."""

    names: tuple[str, ...]  # Parameters of the model
    covariance: Floats  # (n, n): Covariance of their errors, SI
    supply_std: float  # Standard deviation of the share by which the supply of a flight differs
    low_V: Floats  # low_V, high_V: (2,): Voltages of both rotors between which the parameters hold [V]
    high_V: Floats

    def outside_V(self, volts_V: Floats) -> Floats:
        """Return by how much `volts_V`, shape (2,), are outside the range for which the parameters hold [V],
        shape (2,).
        """
        return np.maximum(self.low_V - volts_V, 0.0) + np.maximum(volts_V - self.high_V, 0.0)

    def directions(self, free: Sequence[str]) -> Floats:
        """Return independent errors of one standard deviation each: amounts of the parameters `free`, and of
        the supply in the last row, shape (free + 1, errors).
        """
        variance, vectors = np.linalg.eigh(self.covariance)
        amounts = vectors * np.sqrt(np.maximum(variance, 0.0))
        rows = [free.index(name) for name in self.names]
        count = len(rows)
        directions = np.zeros((len(free) + 1, count + 1))
        directions[rows, :count] = amounts
        directions[-1, count] = self.supply_std
        return directions[:, np.any(directions != 0.0, axis=0)]


EXACT: Final = ParameterUncertainty(
    (), covariance=np.zeros((0, 0)), supply_std=0.0, low_V=np.full(2, -np.inf), high_V=np.full(2, np.inf)
)
"""Parameters without an error, for all voltages."""


ZEROS: Final = ("offset_elevation", "offset_pitch")
"""Encoders with an observable zero. The zero of travel cannot be distinguished from a constant torque."""


_RATE_STEPS: Final = 10
"""Number of steps over which the initial rates are averaged: 0.1 s."""


class TwinModel:
    """Equations of a rig with their derivatives by the state and by possible changes."""

    # `parameters` has shape (p,). `directions` has shape (free parameters + 1, errors). `weights` has shape
    # (free parameters + 1, columns). `prior_sizes` has shape (columns,). `prior_changes` has shape (free
    # parameters + 1, columns).

    def __init__(
        self,
        model: Model,
        rig: Rig,
        uncertainty: ParameterUncertainty = EXACT,
        changes: tuple[Change, ...] | None = None,
    ) -> None:
        # The filter models the disturbances itself.
        deterministic = without_random_effects(model)
        self.rig, self.model, self.uncertainty = rig, deterministic, uncertainty
        self.changes: tuple[Change, ...] = changes_of(deterministic) if changes is None else changes
        # Parameters by which derivatives are needed: those of the changes, and the uncertain ones.
        free = tuple(dict.fromkeys((*model_parameters(self.changes), *uncertainty.names)))
        self.functions = model_functions(extended(deterministic, self.changes), free)
        extended_model = self.functions.model.source
        self.functions_without_derivatives = model_functions(extended_model, ())
        self.parameters: Floats = extended_model.parameter_values(rig)
        self.states = len(extended_model.states)
        self.delay_s = self._delay_of(extended_model)
        dead_zone_V = extended_model.dead_zone_V(self.parameters)
        self.min_thrust_V = -np.inf if dead_zone_V is None else dead_zone_V
        self.measure = self._measurement_function(extended_model)
        self.resets = self._reset_function(extended_model)
        self.directions: Floats = uncertainty.directions(free)
        self._describe_changes()
        self.zero_tolerance_rad: Floats = np.deg2rad([rig[name].tolerance for name in ZEROS])

    def _describe_changes(self) -> None:
        """Set the attributes that state what each change does: weights, priors, frictions and scales."""
        change_parameters = [name for change in self.changes for name in change.parameters]
        self.weights: Floats = self._change_weights(change_parameters)
        # After an alarm, a scale may be as wrong as one with which a flight begins.
        self.prior_sizes: Floats = np.array(
            [size for change in self.changes for size in change.sizes_from_start]
        )
        self.prior_changes: Floats = self.weights * self.prior_sizes
        self.frictions = [
            (self.functions.free.index(name), axis)
            for axis, name in enumerate(f"coulomb_friction_{axis_name}_Nm" for axis_name in AXES)
            if name in self.functions.free
        ]
        self.scales = [
            (column, AXES.index(SCALES[name]))
            for column, name in enumerate(change_parameters)
            if name in SCALES
        ]

    def _delay_of(self, model: Model) -> float:
        """Return the delay between a voltage and its action [s]; 0 if the model has none."""
        if not model.delay:
            return 0.0
        return float(self.parameters[self.functions.names.index(model.delay)])

    def _reset_function(self, model: Model) -> AlongTrajectory | None:
        """Return the function that sets states at the end of a step; None if no effect sets states."""
        if all(type(effect).reset_map is Effect.reset_map for effect in self.model.effects):
            return None
        return model_along(model, lambda x, u, p, t: [model.reset_map(x, u, p, t)])

    def _change_weights(self, change_parameters: Sequence[str]) -> Floats:
        """Return the amount of each free parameter and, in the last row, of the supply, per unit of each
        parameter of the changes, (free + 1, columns).
        """
        # The columns of encoder scales are zero, because they change no parameter of the model.
        free = self.functions.free
        weights = np.zeros((len(free) + 1, len(change_parameters)))
        for column, joined_names in enumerate(change_parameters):
            for name in joined_names.split("+"):
                if name not in SCALES:
                    row = len(free) if name == SUPPLY else free.index(name)
                    weights[row, column] = 1.0
        return weights

    def _measurement_function(self, model: Model) -> AlongTrajectory:
        """Return the measured angles, (3,), with their derivatives by states and by free parameters."""

        # State x, voltages u, parameters p and time t, as symbols.
        def angles_and_derivatives(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
            angles = model.measurement(x, u, p, t)
            free = ca.vertcat(*(p[i] for i in self.functions.places))
            return [angles, ca.jacobian(angles, x), ca.jacobian(angles, free)]

        return model_along(model, angles_and_derivatives)

    def at(self, t_s: float, state: Floats, volts_V: Floats, step_s: float) -> Trajectory:
        """Return the point at which the functions are evaluated: time `t_s`, `state` of shape (n,) or (k, n),
        voltages `volts_V`, (2,), in a step of `step_s`.
        """
        rows = np.atleast_2d(state)
        # A filter does this in each step. For two numbers, np.repeat is quicker than np.broadcast_to.
        inputs_V = np.repeat(volts_V[np.newaxis], len(rows), axis=0)
        return Trajectory(np.full(len(rows), t_s), rows, inputs_V, step_s, self.parameters)


def start_state(twin: TwinModel, t_s: Floats, angles_rad: Floats, volts_V: Floats, step_s: float) -> Floats:
    """Return the state from which the filter starts, (states,): that at the end of some measured steps.
    Shapes: `t_s` (n,), `angles_rad` (n, 3), `volts_V` (n, 2).
    """
    rate_steps = min(_RATE_STEPS, len(t_s) - 1)
    last_rate_rad_s = np.zeros(3)
    if rate_steps:
        last_rate_rad_s = (angles_rad[-1] - angles_rad[-1 - rate_steps]) / (rate_steps * step_s)
    state = np.concatenate((angles_rad[-1], last_rate_rad_s))
    state[: len(ZEROS)] -= np.deg2rad([twin.rig[name].value for name in ZEROS])
    if twin.functions.extra_states:
        # The states of effects follow from the measured motion.
        rates_rad_s = np.gradient(angles_rad, step_s, axis=0) if len(t_s) > 1 else np.zeros_like(angles_rad)
        motion = np.hstack((angles_rad, rates_rad_s))
        trajectory = Trajectory(t_s + 0.5 * step_s, motion, volts_V, step_s, twin.parameters)
        effect_states = twin.functions.integrate(trajectory, np.sign(rates_rad_s))
        state = np.concatenate((state, effect_states[-2]))
    return state
