"""Equations of a few terms as effects of a model, which are refitted and simulated like any other effect."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import casadi as ca
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.parts import AXES
from heli_sim.rig.quantity import Prior, Quantity

from heli_lab.diagnose.discover.terms import SYMBOLS, Factor, Term
from heli_lab.diagnose.discover.units import Unit

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
    """Signs, 1, 0 or -1, with which a term of a thrust or voltage `channel` acts on the front and back
    rotor.
    """
    return _ROTORS[channel.partition(".")[2]]


@dataclass(frozen=True)
class EquationTerm:
    """A term and the channel that it acts on.

    Parameters
    ----------
    channel : str
        One of `CHANNELS`.
    term : Term
        The product of factors that is added, without its coefficient.
    """

    channel: str
    term: Term

    @property
    def coefficient_unit(self) -> Unit:
        """Unit of the coefficient: the channel's unit over the term's."""
        return Unit.parse(CHANNELS[self.channel][0]) / self.term.unit

    @property
    def key(self) -> str:
        """The term as text, such as ``torque.pitch: elevation``."""
        return f"{self.channel}: {self.term.key}"


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
        spelled = unit.replace(" ", "").replace("/", "_per_").removeprefix("1_")
        return f"c{number + 1}" + ("" if unit == "1" else f"_{spelled}")

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of all coefficients, in the order of the terms."""
        return tuple(self.coefficient(i) for i in range(len(self.terms)))

    def inner(self) -> Iterator[tuple[int, int, str, str, float, Unit]]:
        """Yield the inner parameters: index of term and factor, name in the factor, name in the equation,
        value, unit.
        """
        for i, term in enumerate(self.terms):
            for j, factor in enumerate(term.term.factors):
                for name, value in factor.numbers:
                    unit = factor.number_unit(name)
                    spelled = "" if str(unit) == "1" else "_" + str(unit).replace("/", "_per_")
                    word = "lag" if name == "s" else name
                    yield i, j, name, f"{word}{_place(i, j)}{spelled}", value, unit

    def numbers_of(self, i: int, j: int) -> dict[str, str]:
        """Names in the equation of the inner parameters of factor `j` of term `i`, by their names in the
        factor.
        """
        return {inner_name: name for a, b, inner_name, name, _, _ in self.inner() if (a, b) == (i, j)}


@dataclass(frozen=True)
class Group:
    """Candidate term of an equation: one term, or a few terms that are scored together.

    Parameters
    ----------
    terms : tuple of EquationTerm
        A single term, or sine and cosine of one angle: a wave of any phase.
    size : int
        Complexity: number of factors, of functions other than the identity, and of lags.
    """

    terms: tuple[EquationTerm, ...]
    size: int

    @property
    def key(self) -> str:
        """The terms as text, by which the group is recognised."""
        return "; ".join(term.key for term in self.terms)


def _place(i: int, j: int) -> str:
    """Short name of factor `j` of term `i`, such as ``2b``; ``2`` for its first factor."""
    return f"{i + 1}{'' if j == 0 else chr(97 + j)}"


def memory_name(i: int, j: int) -> str:
    """Name of the lag state of factor `j` of term `i`, without prefix and rotor."""
    return f"memory{_place(i, j)}"


@dataclass(frozen=True)
class EquationEffect(Effect):
    """An equation as an effect of a model.

    Parameters
    ----------
    name, parameters, values, states, priors, delay, stage, noise_inputs, measured_as
        Inherited from `Effect`; `equation_effect` makes them.
    multimodal, direction_of, linearisable
        Inherited from `Effect` as well.
    equation : Equation
        The terms.
    """

    equation: Equation = Equation(())

    def __hash__(self) -> int:
        return hash((self.name, self.equation, frozenset(self.values.items())))

    def _values(self, at: Operands, kind: str) -> Iterator[tuple[str, ca.SX]]:
        """Channel and value of each term, coefficient included, on a kind of channel."""
        for i, term in enumerate(self.equation.terms):
            if not term.channel.startswith(kind):
                continue
            value = self.own(at, self.equation.coefficient(i))
            for j, factor in enumerate(term.term.factors):
                value = value * self._factor(at, i, j, factor)
            yield term.channel, value

    def _factor(self, at: Operands, i: int, j: int, factor: Factor) -> ca.SX:
        """Value of factor `j` of term `i`."""
        x = SYMBOLS[factor.quantity].value(at)
        if factor.memory:
            late = self._memory(at, i, j, factor)
            x = late if factor.memory == "lag" else late - x
        names = self.equation.numbers_of(i, j)
        numbers = {inner_name: self.own(at, name) for inner_name, name in names.items()}
        value: ca.SX = factor.value(ca, x, numbers)
        return value

    def _memory(self, at: Operands, i: int, j: int, factor: Factor) -> ca.SX:
        name = memory_name(i, j)
        if not factor.each:
            return self.own(at, name)
        return ca.vertcat(self.own(at, f"{name}_front"), self.own(at, f"{name}_back"))

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Torques of the equation [N m], shape (3, 1); see `Effect.torque_Nm`."""
        parts: dict[str, ca.SX] = {}
        for channel, value in self._values(at, "torque"):
            axis = channel.partition(".")[2]
            parts[axis] = parts.get(axis, ca.SX(0)) + value
        return ca.vertcat(*(parts.get(axis, ca.SX(0)) for axis in AXES))

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Thrusts with the terms of the equation [N], shape (2, 1); see `Effect.thrust_N`."""
        for channel, value in self._values(at, "thrust"):
            thrust_N = thrust_N + ca.DM(rotor_signs(channel)) * value
        return thrust_N

    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        """Voltages with the terms of the equation [V], shape (2, 1); see `Effect.voltage_V`."""
        for channel, value in self._values(at, "voltage"):
            volts_V = volts_V + ca.DM(rotor_signs(channel)) * value
        return volts_V

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Measured angles with the terms of the equation [rad], shape (3, 1); see `Effect.measured_rad`."""
        for channel, value in self._values(at, "measurement"):
            axis = channel.partition(".")[2]
            angles_rad = angles_rad + ca.vertcat(*(value if axis == other else ca.SX(0) for other in AXES))
        return angles_rad

    def state_rates(self, at: Operands) -> ca.SX:
        """Rates of the lag states; see `Effect.state_rates`."""
        rates = []
        for i, term in enumerate(self.equation.terms):
            for j, factor in enumerate(term.term.factors):
                if factor.memory:
                    late = self._memory(at, i, j, factor)
                    lag_s = self.own(at, self.equation.numbers_of(i, j)["s"])
                    rates.append((SYMBOLS[factor.quantity].value(at) - late) / lag_s)
        return ca.vertcat(*rates)


def equation_effect(
    equation: Equation,
    prior_std: Mapping[str, float],
    held: Mapping[str, Any] | None = None,
    name: str = NAME,
) -> EquationEffect:
    """Make the effect of an equation with all coefficients at 0.

    Parameters
    ----------
    equation : Equation
        The terms.
    prior_std : Mapping[str, float]
        Prior standard deviation of each coefficient, by name without prefix.
    held : Mapping[str, Any], optional
        Inner parameters that are not estimated, by name without prefix; the width of a sign never is.
    name : str
        Id of the effect; its parameters have it as prefix.
    """
    prefix = name.replace(".", "_")
    values, priors, parameters = dict[str, float](), dict[str, Prior](), []
    for what, term in zip(equation.coefficients, equation.terms, strict=True):
        full = f"{prefix}_{what}"
        parameters.append(Quantity(full, str(term.coefficient_unit), f"coefficient of {term.term.key}"))
        values[full], priors[full] = 0.0, Prior(0.0, prior_std[what])
    for i, j, inner_name, what, value, unit in equation.inner():
        full = f"{prefix}_{what}"
        factor = equation.terms[i].term.factors[j]
        parameters.append(Quantity(full, str(unit), f"{inner_name} of {factor.form} of {factor.quantity}"))
        values[full] = value
        if what not in (held or {}) and not (factor.form == "sign" and inner_name == "width"):
            priors[full] = inner_prior(factor, inner_name, value)
    states = [
        Quantity(f"{prefix}_{memory_name(i, j)}{rotor}", str(SYMBOLS[factor.quantity].unit), "a lagged copy")
        for i, term in enumerate(equation.terms)
        for j, factor in enumerate(term.term.factors)
        if factor.memory
        for rotor in (("_front", "_back") if factor.each else ("",))
    ]
    return EquationEffect(
        name,
        parameters=tuple(parameters),
        values=values,
        states=tuple(states),
        priors=priors,
        stage=min(CHANNELS[channel][1] for channel in equation.channels),
        equation=equation,
    )


def inner_prior(factor: Factor, inner_name: str, value: float) -> Prior:
    """Prior of the inner parameter `inner_name` of a `factor`: mean `value` from the grid, as wide as the
    grid.
    """
    if inner_name == "s":
        return Prior(value, value, _MIN_s, _MAX_s)
    if inner_name == "k":
        return Prior(value, 0.3 * value, 0.3 * value, 3.0 * value)
    if inner_name == "slack":
        return Prior(value, 0.5 * value, 0.3 * value, 2.0 * value)
    width = dict(factor.numbers)["width"]
    if inner_name == "place":
        return Prior(value, width, value - 4.0 * width, value + 4.0 * width)
    return Prior(value, 0.5 * value, 0.2 * value, 5.0 * value)
