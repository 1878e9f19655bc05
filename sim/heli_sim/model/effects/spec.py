"""The description of an effect before any flight: parameters, priors, and how to make it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from heli_sim.errors import EffectError
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect, Stage
from heli_sim.rig.schema import Prior, Quantity

GridValues = tuple[float, ...] | Callable[[float], tuple[float, ...]]
"""Values to start a fit from, or a function that gives them for a flight of so many seconds."""

_DEG: Final = 180.0 / math.pi
_SPELLED: Final[Mapping[str, tuple[float, str]]] = {
    "rad": (_DEG, " deg"),
    "N m": (1e3, " mN m"),
    "1": (100.0, " %"),
    "count": (1.0, ""),
}


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Parameters
    ----------
    name : str
        Name without that of the effect; it ends in the unit.
    unit : str
        Unit, spelled as in rig files; ``1`` for a share.
    meaning : str
        One line in words.
    typical : float
        Size at which the effect is clearly visible; for a parameter that is no size, the start value of a
        fit.
    prior : Prior or None
        Distribution before the flights are used; None for a parameter that is never estimated. The prior of a
        size should be several typical sizes wide, because a narrow prior makes large effects too small.
    size : bool
        Whether it measures the size of the effect: at `neutral` there is no effect, and the effect grows
        about in proportion to it.
    neutral : float or None
        Value at which the effect does nothing, but has derivatives; any value for a parameter that is no
        size. None means 0 for a size, and `typical` for another parameter.
    grid : tuple of float, callable or None
        Start values, if the likelihood is multimodal in this parameter; a callable gets the flight's length
        in s.
    """

    name: str
    unit: str
    meaning: str
    typical: float
    prior: Prior | None = None
    size: bool = False
    neutral: float | None = None
    grid: GridValues | None = None

    @property
    def neutral_value(self) -> float:
        """Value at which the effect does nothing; for a parameter that is no size, the value to start
        from.
        """
        if self.neutral is not None:
            return self.neutral
        return 0.0 if self.size else self.typical


@dataclass(frozen=True)
class ChangeSpec:
    """An effect as a sudden change of a rig, which the twin can detect in flight.

    Parameters
    ----------
    sizes : tuple of float
        Prior standard deviation of each number of the change, in SI units: the usual size of such changes.
    positive, negative : str
        Sentences for a positive and for a negative first number, with ``{}`` for its size.
    numbers : tuple of str
        Full names of the parameters that change, at most two; empty for the effect's first parameter alone.
        Parameters whose names are joined by ``+`` change by the same amount.
    is_ramp : bool
        True if the change grows from its onset at a constant rate; False for a step.
    """

    sizes: tuple[float, ...]
    positive: str
    negative: str
    numbers: tuple[str, ...] = ()
    is_ramp: bool = False


@dataclass(frozen=True)
class EffectFamily:
    """Effects that flights hardly distinguish. A search compares each member that it names with the others.

    Parameters
    ----------
    name : str
        Name of the family.
    unclear : str
        Statement that flights do not distinguish its members.
    sentence : str
        Sentence about the number that all members have in common, with ``{}`` in its place; empty if there
        is none.
    unit : str
        Unit of the number.
    in_part : bool
        True if only some values of their parameters make the members similar: the number then has a meaning
        only if the flights do not distinguish them.
    """

    name: str
    unclear: str
    sentence: str = ""
    unit: str = "1"
    in_part: bool = False


@dataclass(frozen=True)
class EffectSpec:
    """An effect of the catalogue.

    Parameters
    ----------
    id : str
        Name, followed by a dot and the axis, the rotor or the term, if there is one.
    effect : type of Effect
        Class of the equations; its constructor takes the keyword arguments of `Effect`.
    sentence : str
        Sentence for the report; ``{name}`` stands for the value of the parameter ``name``.
    equation : str
        LaTeX.
    acts_on : str
        ``input``, ``thrust``, ``torque.<axis>``, ``measurement.<axis>`` or ``parameters``.
    numbers : tuple of Parameter
        Its parameters. The first is the one that ``ID=VALUE`` sets.
    states : tuple of Quantity
        Its states, named without the effect's name.
    source : str
        Where the equation comes from.
    delay : str
        Name of the parameter that delays the voltages; empty for none.
    noise_inputs : int
        Dimension of the white noise that drives its states in a simulation.
    measured_as : Mapping[str, str]
        States that an encoder measures, and the axis of each.
    needs : tuple of str
        Rig parameters that a model must have for the effect to make sense.
    models : tuple of str
        Names of the models for which the effect makes sense; empty for all models with the parameters
        `needs`.
    baseline : bool
        Whether the effect removes a term of the model instead of adding one.
    override : Mapping[str, float]
        With `baseline`: rig parameters, and the value that each has without the term.
    contains : Mapping[str, Mapping[str, str]]
        Effects that are special cases of this one (nested models), by id. Each entry maps the parameters of
        the special case to those of this effect, by short names; the other parameters are neutral.
    excludes : tuple of str
        Ids of further effects that no model may have together with this one; naming one side is enough.
    family : EffectFamily or None
        Family that it belongs to.
    family_numbers : Mapping[str, float]
        Weights of the parameters in the sum that is the family's number, by short name.
    family_divisor : str
        Rig parameter by which that sum is divided; empty for none.
    linearisable : bool
        True if a linear model at hover contains the effect; False if the effect is not smooth there, or only
        biases a measurement. The design of gains reports effects that its linear plants do not contain.
    time_varying : bool
        True if the effect changes the rig during a flight, as a step or a fade; it is then in no linear
        plant, and an experiment for it must last longer.
    change : ChangeSpec or None
        The effect as a sudden change in flight; None if a twin does not look for it.
    rank : int
        Place in the catalogue, lowest first; equal ranks by the name of the file.
    """

    id: str
    effect: type[Effect]
    sentence: str
    equation: str
    acts_on: str
    stage: Stage
    numbers: tuple[Parameter, ...]
    states: tuple[Quantity, ...] = ()
    source: str = ""
    delay: str = ""
    noise_inputs: int = 0
    measured_as: Mapping[str, str] = field(default_factory=dict)
    needs: tuple[str, ...] = ()
    models: tuple[str, ...] = ()
    baseline: bool = False
    override: Mapping[str, float] = field(default_factory=dict)
    contains: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    excludes: tuple[str, ...] = ()
    family: EffectFamily | None = None
    family_numbers: Mapping[str, float] = field(default_factory=dict)
    family_divisor: str = ""
    linearisable: bool = False
    time_varying: bool = False
    change: ChangeSpec | None = None
    rank: int = 500

    @property
    def prefix(self) -> str:
        """First part of the names of its parameters and states."""
        return self.id.replace(".", "_")

    @property
    def parameters(self) -> tuple[Quantity, ...]:
        """The effect's parameters by their full names, as in a model with the effect."""
        return tuple(
            Quantity(self.full(parameter.name), parameter.unit, parameter.meaning)
            for parameter in self.numbers
        )

    @property
    def priors(self) -> dict[str, Prior]:
        """Prior of each parameter that flights may estimate, by full name."""
        return {
            self.full(parameter.name): parameter.prior
            for parameter in self.numbers
            if parameter.prior is not None
        }

    @property
    def neutral(self) -> dict[str, float]:
        """Values of all parameters at which the effect does nothing, by full name."""
        return {self.full(parameter.name): parameter.neutral_value for parameter in self.numbers}

    @property
    def typical(self) -> dict[str, float]:
        """Values of all parameters at which the effect is clearly visible, by full name."""
        return {self.full(parameter.name): parameter.typical for parameter in self.numbers}

    @property
    def size(self) -> tuple[str, ...]:
        """Full names of the parameters that enter almost linearly and measure the size."""
        return tuple(self.full(parameter.name) for parameter in self.numbers if parameter.size)

    @property
    def grid(self) -> dict[str, GridValues]:
        """Parameters in which the likelihood is multimodal, by full name, with the values to start from."""
        return {
            self.full(parameter.name): parameter.grid
            for parameter in self.numbers
            if parameter.grid is not None
        }

    @property
    def is_one_sided(self) -> bool:
        """Whether the first parameter cannot be negative, as for a friction."""
        prior = self.numbers[0].prior
        return prior is not None and prior.low >= 0.0

    def full(self, name: str) -> str:
        """Full name of a parameter or state in a model, from its short `name`: ``share`` of the effect
        ``thrust_step.front`` is ``thrust_step_front_share``. `Effect.value` finds it again by the short name.
        """
        return f"{self.prefix}_{name}"

    def suits(self, model: Model) -> bool:
        """Whether a model has what the effect changes: the parameters that the effect needs, or the term that
        it removes.
        """
        if self.models and model.name not in self.models:
            return False
        return {*self.needs, *self.override} <= set(model.parameter_names)

    def compatible_with(self, other: EffectSpec) -> bool:
        """Whether one model may have this and the `other` effect.

        It may not if one of them contains or excludes the other, if both delay the voltages, or if both are
        equations of the thrust's lag (`Stage.LAG`).
        """
        nested = other.id in self.contains or self.id in other.contains
        excluded = other.id in self.excludes or self.id in other.excludes
        same_role = bool(self.delay and other.delay) or self.stage == other.stage == Stage.LAG
        return other.id != self.id and not (nested or excluded or same_role)

    def from_contained(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values by full name at which this effect equals the effects that it contains.

        Parameters
        ----------
        values : Mapping[str, float]
            Values of the contained effects' parameters by full name, others are ignored; parameters without a
            value become `neutral`.
        """
        result = dict(self.neutral)
        for contained, names in self.contains.items():
            for contained_name, name in names.items():
                contained_full = f"{contained.replace('.', '_')}_{contained_name}"
                if contained_full in values:
                    result[self.full(name)] = values[contained_full]
        return result

    def make(self, values: Mapping[str, float] | None = None) -> Effect:
        """Make an effect of this kind, for a model.

        Parameters
        ----------
        values : Mapping[str, float], optional
            Values by full name; `neutral` for those not given.

        Raises
        ------
        EffectError
            When a name is unknown or a value is out of range.
        """
        all_values = dict(self.neutral)
        for name, value in (values or {}).items():
            self._check_values(name, value)
            all_values[name] = float(value)
        return self.effect(
            name=self.id,
            parameters=self.parameters,
            values=all_values,
            states=tuple(Quantity(self.full(s.name), s.unit, s.meaning) for s in self.states),
            priors=self.priors,
            delay=self.full(self.delay) if self.delay else "",
            stage=self.stage,
            noise_inputs=self.noise_inputs,
            linearisable=self.linearisable and not self.time_varying,
            measured_as={self.full(state): axis for state, axis in self.measured_as.items()},
            multimodal=tuple(name for name in self.grid if name in self.priors),
        )

    def grid_values(self, seconds: float) -> dict[str, tuple[float, ...]]:
        """Start values on a flight of `seconds`, for each parameter of `grid`; values outside the range of
        the prior are left out.
        """
        return {
            name: self._within_prior(name, grid(seconds) if callable(grid) else grid)
            for name, grid in self.grid.items()
        }

    def describe(self, values: Mapping[str, float], stds: Mapping[str, float] | None = None) -> str:
        """Describe the effect with its values in one sentence without a full stop: angles in degrees, torques
        in mN m, shares in per cent.

        Parameters
        ----------
        values : Mapping[str, float]
            Values by full name; `neutral` for those not given.
        stds : Mapping[str, float], optional
            Standard errors by full name.
        """
        known = {**self.neutral, **values}
        texts = {
            parameter.name: format_estimate(
                known[self.full(parameter.name)], (stds or {}).get(self.full(parameter.name)), parameter.unit
            )
            for parameter in self.numbers
        }
        return self.sentence.format(**texts)

    def _within_prior(self, name: str, values: tuple[float, ...]) -> tuple[float, ...]:
        """Leave out values outside the range of the prior: a grid scales with the length of the flight, and a
        very short flight gives such values.
        """
        prior = self.priors.get(name)
        if prior is None:
            return values
        return tuple(value for value in values if prior.low <= value <= prior.high) or (self.typical[name],)

    def _check_values(self, name: str, value: float) -> None:
        """Raise an EffectError for an unknown parameter or a value out of range."""
        ranges = {q.name: self.priors.get(q.name) for q in self.parameters}
        if name not in ranges:
            raise EffectError(f"'{self.id}' has no '{name}'", f"choose from {', '.join(ranges)}")
        prior = ranges[name]
        low, high = (prior.low, prior.high) if prior is not None else (-math.inf, math.inf)
        if not (math.isfinite(value) and low <= value <= high):
            unit = next(q.unit for q in self.parameters if q.name == name)
            raise EffectError(f"{name} = {value:g} {unit} is out of range", f"give {low:g} to {high:g}")


def format_estimate(value: float, std: float | None, unit: str) -> str:
    """Format an estimate with its standard error, such as ``0.12 ± 0.01 s``: two digits of the error; three
    digits of a number without an error.
    """
    factor, unit_text = _SPELLED.get(unit, (1.0, f" {unit}"))
    value *= factor
    if std is None or not math.isfinite(std) or std <= 0.0:
        return f"{value:.3g}{unit_text}"
    std *= factor
    # Two digits where they begin with 1 or 2, one digit otherwise.
    digits = -math.floor(np.log10(std)) + (1 if std / 10 ** math.floor(np.log10(std)) < 2.95 else 0)
    if digits <= 0:
        return f"{round(value, digits):.0f} ± {round(std, digits):.0f}{unit_text}"
    return f"{value:.{digits}f} ± {std:.{digits}f}{unit_text}"
