"""A law of a few terms as an effect of a model, so that it is refitted and flown like any other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

import casadi as ca
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.parts import AXES
from heli_sim.rig.quantity import Prior, Quantity

from heli_lab.diagnose.equation_discovery.terms import QUANTITIES, Factor, Term
from heli_lab.diagnose.equation_discovery.units import Unit

NAME: Final = "proposed_term"
"""Id of the effect that a law is."""
CHANNELS: Final[Mapping[str, tuple[str, Stage]]] = {
    **{f"torque.{axis}": ("N m", Stage.TORQUE) for axis in AXES},
    **{f"thrust.{which}": ("N", Stage.INFLOW) for which in ("both", "difference", "front", "back")},
    **{f"voltage.{which}": ("V", Stage.CURVE) for which in ("both", "front", "back")},
    **{f"measurement.{axis}": ("rad", Stage.SHAFT) for axis in AXES},
}
"""Where a term may act: its unit, and the stage of the effect. A term of ``thrust.difference`` is added to
the front rotor's thrust and taken from the back one's."""
_ROTORS: Final[Mapping[str, tuple[int, int]]] = {
    "both": (1, 1),
    "difference": (1, -1),
    "front": (1, 0),
    "back": (0, 1),
}
_LEAST_s, _MOST_s = 0.02, 5.0
"""Time constants of a lag: shorter ones are the filter's own step, longer ones the drift of the weather."""


def rotor_signs(channel: str) -> tuple[int, int]:
    """Share of a term that a `channel` of thrust or voltage adds to the front and to the back rotor."""
    return _ROTORS[channel.partition(".")[2]]


@dataclass(frozen=True)
class EquationTerm:
    """A term with the channel that it acts on.

    Parameters
    ----------
    channel : str
        One of `CHANNELS`.
    term : Term
        What is added to it, without its coefficient.
    """

    channel: str
    term: Term

    @property
    def coefficient_unit(self) -> Unit:
        """Unit of its coefficient: the channel's over the term's."""
        return Unit.parse(CHANNELS[self.channel][0]) / self.term.unit

    @property
    def key(self) -> str:
        """Channel and term as text."""
        return f"{self.channel}: {self.term.key}"


@dataclass(frozen=True)
class Equation:
    """A sum of terms on one or more channels."""

    terms: tuple[EquationTerm, ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """Where it acts."""
        return tuple(dict.fromkeys(term.channel for term in self.terms))

    @property
    def key(self) -> str:
        """The law as text, with its inner numbers, without its coefficients."""
        return "; ".join(term.key for term in self.terms)

    def coefficient(self, number: int) -> str:
        """Name of the coefficient of term `number`, from 0, without the effect's prefix."""
        unit = str(self.terms[number].coefficient_unit)
        spelled = unit.replace(" ", "").replace("/", "_per_").removeprefix("1_")
        return f"c{number + 1}" + ("" if unit == "1" else f"_{spelled}")

    @property
    def coefficients(self) -> tuple[str, ...]:
        """Names of all coefficients."""
        return tuple(self.coefficient(i) for i in range(len(self.terms)))

    def inner(self) -> Iterator[tuple[int, int, str, str, float, Unit]]:
        """Numbers of factors: term, factor, the number's own name, its name in the law, value and unit."""
        for i, term in enumerate(self.terms):
            for j, factor in enumerate(term.term.factors):
                for name, value in factor.numbers:
                    unit = factor.number_unit(name)
                    spelled = "" if str(unit) == "1" else "_" + str(unit).replace("/", "_per_")
                    word = "lag" if name == "s" else name
                    yield i, j, name, f"{word}{_place(i, j)}{spelled}", value, unit

    def numbers_of(self, i: int, j: int) -> dict[str, str]:
        """Names in the law of the numbers of factor `j` of term `i`, by their own names."""
        return {inner_name: name for a, b, inner_name, name, _, _ in self.inner() if (a, b) == (i, j)}


def _place(i: int, j: int) -> str:
    return f"{i + 1}{'' if j == 0 else chr(97 + j)}"


def memory_name(i: int, j: int) -> str:
    """Name of the state of factor `j` of term `i`, without prefix and rotor."""
    return f"memory{_place(i, j)}"


@dataclass(frozen=True)
class EquationEffect(Effect):
    """A law as an effect.

    Parameters
    ----------
    name, parameters, values, states, priors, delay, stage, noise_inputs, measured_as
        Inherited from `Effect`; `equation_effect` makes them.
    multimodal, direction_of
        Inherited from `Effect` as well.
    equation : Equation
        Its terms.
    """

    equation: Equation = Equation(())

    def __hash__(self) -> int:
        return hash((self.name, self.equation, frozenset(self.values.items())))

    def _values(self, at: Operands, kind: str) -> Iterator[tuple[str, ca.SX]]:
        """Each term of a kind of channel with its coefficient: its channel and its value."""
        for i, term in enumerate(self.equation.terms):
            if not term.channel.startswith(kind):
                continue
            value = self.own(at, self.equation.coefficient(i))
            for j, factor in enumerate(term.term.factors):
                value = value * self._factor(at, i, j, factor)
            yield term.channel, value

    def _factor(self, at: Operands, i: int, j: int, factor: Factor) -> ca.SX:
        x = QUANTITIES[factor.quantity].value(at)
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
        """Add its torques [N m], shape (3, 1); see `Effect.torque_Nm`."""
        parts: dict[str, ca.SX] = {}
        for channel, value in self._values(at, "torque"):
            axis = channel.partition(".")[2]
            parts[axis] = parts.get(axis, ca.SX(0)) + value
        return ca.vertcat(*(parts.get(axis, ca.SX(0)) for axis in AXES))

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Add its thrusts [N], shape (2, 1); see `Effect.thrust_N`."""
        for channel, value in self._values(at, "thrust"):
            thrust_N = thrust_N + ca.DM(rotor_signs(channel)) * value
        return thrust_N

    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        """Add its voltages [V], shape (2, 1); see `Effect.voltage_V`."""
        for channel, value in self._values(at, "voltage"):
            volts_V = volts_V + ca.DM(rotor_signs(channel)) * value
        return volts_V

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Add to what encoders show [rad], shape (3, 1); see `Effect.measured_rad`."""
        for channel, value in self._values(at, "measurement"):
            axis = channel.partition(".")[2]
            angles_rad = angles_rad + ca.vertcat(*(value if axis == other else ca.SX(0) for other in AXES))
        return angles_rad

    def state_rates(self, at: Operands) -> ca.SX:
        """First-order lags of what has a memory; see `Effect.state_rates`."""
        rates = []
        for i, term in enumerate(self.equation.terms):
            for j, factor in enumerate(term.term.factors):
                if factor.memory:
                    late = self._memory(at, i, j, factor)
                    lag_s = self.own(at, self.equation.numbers_of(i, j)["s"])
                    rates.append((QUANTITIES[factor.quantity].value(at) - late) / lag_s)
        return ca.vertcat(*rates)


def equation_effect(
    equation: Equation,
    reported_std: Mapping[str, float],
    held: Mapping[str, Any] | None = None,
    name: str = NAME,
) -> EquationEffect:
    """Make the effect of a law with all coefficients at 0.

    Parameters
    ----------
    equation : Equation
        Its terms.
    reported_std : Mapping[str, float]
        Prior standard deviation of each coefficient, by name without prefix.
    held : Mapping[str, Any], optional
        Inner numbers that are not estimated, by name without prefix; the width of a sign never is.
    name : str
        Name of the effect.
    """
    prefix = name.replace(".", "_")
    values, priors, parameters = dict[str, float](), dict[str, Prior](), []
    for what, term in zip(equation.coefficients, equation.terms, strict=True):
        full = f"{prefix}_{what}"
        parameters.append(Quantity(full, str(term.coefficient_unit), f"coefficient of {term.term.key}"))
        values[full], priors[full] = 0.0, Prior(0.0, reported_std[what])
    for i, j, inner_name, what, value, unit in equation.inner():
        full = f"{prefix}_{what}"
        factor = equation.terms[i].term.factors[j]
        parameters.append(Quantity(full, str(unit), f"{inner_name} of {factor.form} of {factor.quantity}"))
        values[full] = value
        if what not in (held or {}) and not (factor.form == "sign" and inner_name == "width"):
            priors[full] = inner_prior(factor, inner_name, value)
    states = [
        Quantity(
            f"{prefix}_{memory_name(i, j)}{rotor}", str(QUANTITIES[factor.quantity].unit), "a lagged copy"
        )
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
    """Return the prior of the number `inner_name` of a `factor`: centred on the grid's `value`, as wide as
    the grid.
    """
    if inner_name == "s":
        return Prior(value, value, _LEAST_s, _MOST_s)
    if inner_name == "k":
        return Prior(value, 0.3 * value, 0.3 * value, 3.0 * value)
    if inner_name == "slack":
        return Prior(value, 0.5 * value, 0.3 * value, 2.0 * value)
    width = dict(factor.numbers)["width"]
    if inner_name == "place":
        return Prior(value, width, value - 4.0 * width, value + 4.0 * width)
    return Prior(value, 0.5 * value, 0.2 * value, 5.0 * value)
