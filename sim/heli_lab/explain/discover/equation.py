"""Equations of a few terms as effects of a model, which are refitted and simulated like any other effect."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

import casadi as ca
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.parts import AXES
from heli_sim.rig.quantity import Prior, Quantity

from heli_lab.explain.discover.terms import SYMBOLS, Factor, Term
from heli_lab.explain.discover.units import Unit

NAME: Final = "proposed_term"
"""Id of the effect that a proposed equation becomes."""
CHANNELS: Final[Mapping[str, tuple[str, Stage]]] = {
    **{f"torque.{axis}": ("N m", Stage.TORQUE) for axis in AXES},
    **{f"thrust.{which}": ("N", Stage.INFLOW) for which in ("both", "difference", "front", "back")},
    **{f"voltage.{which}": ("V", Stage.CURVE) for which in ("both", "front", "back")},
    **{f"measurement.{axis}": ("rad", Stage.SHAFT) for axis in AXES},
}
"""Where a term may act: its unit, and the stage of the effect. A term of ``thrust.difference`` is added to
the front rotor's thrust and subtracted from the back rotor's."""
_ROTORS: Final[Mapping[str, tuple[int, int]]] = {
    "both": (1, 1),
    "difference": (1, -1),
    "front": (1, 0),
    "back": (0, 1),
}
_MIN_s, _MAX_s = 0.02, 5.0
"""Bounds of a lag's time constant: below, it is the filter's own step; above, a slow disturbance."""


def rotor_signs(channel: str) -> tuple[int, int]:
    """Return the signs with which a term of a thrust or voltage `channel` acts on the two rotors.

    They are 1, 0 or -1, for the front and for the back rotor.
    """
    return _ROTORS[channel.partition(".")[2]]


@dataclass(frozen=True)
class EquationTerm:
    """A term and the channel that it acts on."""

    channel: str  # One of `CHANNELS`
    term: Term  # The product of factors that is added, without its coefficient

    @property
    def coefficient_unit(self) -> Unit:
        """Unit of the coefficient: the channel's unit over the term's."""
        return Unit.parse(CHANNELS[self.channel][0]) / self.term.unit

    @property
    def key(self) -> str:
        """The term as text, such as ``torque.pitch: elevation``."""
        return f"{self.channel}: {self.term.key}"


class InnerParameter(NamedTuple):
    """Parameter inside a function of an equation, such as the periods per turn of a sine."""

    term: int  # term, factor: Index of the term in the equation, and of the factor in the term
    factor: int
    name_in_factor: str
    """name_in_factor, name: Name in the factor, such as ``k``, and in the equation, such as ``k1b``."""
    name: str
    value: float  # Value in the grammar, in `unit`
    unit: Unit
    is_sign_width: bool  # Whether it is the width over which a sign is smoothed, which is never estimated


@dataclass(frozen=True)
class Equation:
    """A sum of terms on one or more channels."""

    terms: tuple[EquationTerm, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that it acts on, each once, in the order of its terms."""
        return tuple(dict.fromkeys(term.channel for term in self.terms))

    @property
    def key(self) -> str:
        """The equation as text, with its inner parameters, without its coefficients."""
        return "; ".join(term.key for term in self.terms)

    def coefficient(self, number: int) -> str:
        """Name of the coefficient of term `number`, from 0, without the effect's prefix:
        ``c1_Nm_per_rad``.
        """
        unit = str(self.terms[number].coefficient_unit)
        unit_suffix = unit.replace(" ", "").replace("/", "_per_").removeprefix("1_")
        return f"c{number + 1}" + ("" if unit == "1" else f"_{unit_suffix}")

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of all coefficients, in the order of the terms."""
        return tuple(self.coefficient(i) for i in range(len(self.terms)))

    @property
    def lagged_factors(self) -> list[tuple[int, int, Factor]]:
        """Factors behind a lag, each after the index of its term and its index in that term."""
        return [
            (i, j, factor)
            for i, term in enumerate(self.terms)
            for j, factor in enumerate(term.term.factors)
            if factor.lag_filter
        ]

    def inner_parameters(self) -> Iterator[InnerParameter]:
        """Yield the parameters inside the functions, in the order of terms and factors."""
        for i, term in enumerate(self.terms):
            for j, factor in enumerate(term.term.factors):
                for name, value in factor.parameters:
                    unit = factor.parameter_unit(name)
                    unit_suffix = "" if str(unit) == "1" else "_" + str(unit).replace("/", "_per_")
                    word = "lag" if name == "s" else name
                    full_name = f"{word}{_factor_label(i, j)}{unit_suffix}"
                    is_sign_width = factor.form == "sign" and name == "width"
                    yield InnerParameter(i, j, name, full_name, value, unit, is_sign_width)

    def inner_names(self, i: int, j: int) -> dict[str, str]:
        """Return the names of the inner parameters of factor `j` of term `i`.

        The keys are their names in the factor, and the values their names in the equation.
        """
        return {
            parameter.name_in_factor: parameter.name
            for parameter in self.inner_parameters()
            if (parameter.term, parameter.factor) == (i, j)
        }


@dataclass(frozen=True)
class TermGroup:
    """Terms that are scored together, as one."""

    terms: tuple[EquationTerm, ...]  # A single term, or sine and cosine of one angle: a wave of any phase
    complexity: int  # Number of factors, of functions other than the identity, and of lags

    @property
    def key(self) -> str:
        """The terms as text, by which the group is recognised."""
        return "; ".join(term.key for term in self.terms)


def _factor_label(i: int, j: int) -> str:
    """Return the label of factor `j` of term `i` in names of parameters.

    The factors of term 0 are ``1``, ``1b``, ``1c``.
    """
    return f"{i + 1}{'' if j == 0 else chr(97 + j)}"


def lag_state_name(i: int, j: int) -> str:
    """Name of the lag state of factor `j` of term `i`, without prefix and rotor."""
    return f"memory{_factor_label(i, j)}"


@dataclass(frozen=True)
class EquationEffect(Effect):
    """An equation as an effect of a model."""

    equation: Equation = Equation(())  # The terms

    def __hash__(self) -> int:
        return hash((self.name, self.equation, frozenset(self.values.items())))

    def _channel_values(self, at: Operands, kind: str) -> Iterator[tuple[str, ca.SX]]:
        """Yield channel and value of each term, coefficient included.

        Only terms on channels of a kind such as ``torque`` are evaluated.
        """
        for i, term in enumerate(self.equation.terms):
            if not term.channel.startswith(kind):
                continue
            value = self.value(at, self.equation.coefficient(i))
            for j, factor in enumerate(term.term.factors):
                value = value * self._factor_value(at, i, j, factor)
            yield term.channel, value

    def _factor_value(self, at: Operands, i: int, j: int, factor: Factor) -> ca.SX:
        """Return the value of factor `j` of term `i`, shape (1, 1), or (2, 1) if each rotor has its own."""
        x = SYMBOLS[factor.quantity].value(at)
        if factor.lag_filter:
            lagged = self._lag_state(at, i, j, factor)
            x = lagged if factor.lag_filter == "lag" else lagged - x
        names = self.equation.inner_names(i, j)
        parameters = {inner_name: self.value(at, name) for inner_name, name in names.items()}
        value: ca.SX = factor.value(ca, x, parameters)
        return value

    def _lag_state(self, at: Operands, i: int, j: int, factor: Factor) -> ca.SX:
        """Return the state of the first-order lag of a factor.

        The shape is (1, 1), or (2, 1) if each rotor has its own state.
        """
        name = lag_state_name(i, j)
        if not factor.per_rotor:
            return self.value(at, name)
        return ca.vertcat(self.value(at, f"{name}_front"), self.value(at, f"{name}_back"))

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Torques of the equation [N m], shape (3, 1); see `Effect.torque_Nm`."""
        torque_by_axis: dict[str, ca.SX] = {}
        for channel, value in self._channel_values(at, "torque"):
            axis = channel.partition(".")[2]
            torque_by_axis[axis] = torque_by_axis.get(axis, ca.SX(0)) + value
        return ca.vertcat(*(torque_by_axis.get(axis, ca.SX(0)) for axis in AXES))

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Thrusts with the terms of the equation [N], shape (2, 1); see `Effect.thrust_N`."""
        for channel, value in self._channel_values(at, "thrust"):
            thrust_N = thrust_N + ca.DM(rotor_signs(channel)) * value
        return thrust_N

    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        """Voltages with the terms of the equation [V], shape (2, 1); see `Effect.voltage_V`."""
        for channel, value in self._channel_values(at, "voltage"):
            volts_V = volts_V + ca.DM(rotor_signs(channel)) * value
        return volts_V

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Measured angles with the terms of the equation [rad], shape (3, 1); see `Effect.measured_rad`."""
        for channel, value in self._channel_values(at, "measurement"):
            axis = channel.partition(".")[2]
            angles_rad = angles_rad + ca.vertcat(*(value if axis == other else ca.SX(0) for other in AXES))
        return angles_rad

    def state_rates(self, at: Operands) -> ca.SX:
        """Rates of the lag states; see `Effect.state_rates`."""
        rates = []
        for i, j, factor in self.equation.lagged_factors:
            lag_s = self.value(at, self.equation.inner_names(i, j)["s"])
            rates.append((SYMBOLS[factor.quantity].value(at) - self._lag_state(at, i, j, factor)) / lag_s)
        return ca.vertcat(*rates)


def equation_effect(
    equation: Equation,
    prior_std: Mapping[str, float],
    held: Collection[str] = (),
    name: str = NAME,
) -> EquationEffect:
    """Make the effect of an equation with all coefficients at 0."""
    prefix = name.replace(".", "_")
    values, priors, parameters = dict[str, float](), dict[str, Prior](), []
    for coefficient, term in zip(equation.coefficients, equation.terms, strict=True):
        full_name = f"{prefix}_{coefficient}"
        parameters.append(Quantity(full_name, str(term.coefficient_unit), f"coefficient of {term.term.key}"))
        values[full_name], priors[full_name] = 0.0, Prior(0.0, prior_std[coefficient])
    for inner in equation.inner_parameters():
        full_name = f"{prefix}_{inner.name}"
        factor = equation.terms[inner.term].term.factors[inner.factor]
        meaning = f"{inner.name_in_factor} of {factor.form} of {factor.quantity}"
        parameters.append(Quantity(full_name, str(inner.unit), meaning))
        values[full_name] = inner.value
        if inner.name not in held and not inner.is_sign_width:
            priors[full_name] = inner_prior(factor, inner.name_in_factor, inner.value)
    return EquationEffect(
        name,
        parameters=tuple(parameters),
        values=values,
        states=tuple(_lag_states(equation, prefix)),
        priors=priors,
        stage=min(CHANNELS[channel][1] for channel in equation.channels),
        equation=equation,
    )


def _lag_states(equation: Equation, prefix: str) -> Iterator[Quantity]:
    """Yield a state for each lagged factor of an equation, or one per rotor if each rotor has its own."""
    for i, j, factor in equation.lagged_factors:
        unit = str(SYMBOLS[factor.quantity].unit)
        for rotor in ("_front", "_back") if factor.per_rotor else ("",):
            yield Quantity(f"{prefix}_{lag_state_name(i, j)}{rotor}", unit, "a lagged copy")


_INNER_PRIOR: Final[Mapping[str, tuple[float, float, float]]] = {
    "k": (0.3, 0.3, 3.0),
    "slack": (0.5, 0.3, 2.0),
    "width": (0.5, 0.2, 5.0),
}
"""Standard deviation, lower and upper bound of periods per turn, of a slack and of a bump's width. They are
multiples of the values in the grammar, and let a refit reach the neighbouring values there."""


def inner_prior(factor: Factor, inner_name: str, value: float) -> Prior:
    """Return the prior of the parameter `inner_name` of a `factor`, about its `value` in the grammar."""
    if inner_name == "s":
        return Prior(value, value, _MIN_s, _MAX_s)
    if inner_name == "place":
        width = dict(factor.parameters)["width"]
        return Prior(value, width, value - 4.0 * width, value + 4.0 * width)
    std, low, high = _INNER_PRIOR[inner_name]
    return Prior(value, std * value, low * value, high * value)
