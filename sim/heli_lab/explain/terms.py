"""Equations: terms of angles, rates, thrusts and voltages, and equations of a few terms as effects.

A term is evaluated along a flight (NumPy) and in a model (CasADi), and written for readers (SymPy, LaTeX)
and for a simulator (Python). All notations follow from one table of functions and one table of quantities.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import casadi as ca
from heli_sim.model.effect import AXES, Effect, Operands, Stage
from heli_sim.rig.schema import Prior, Quantity

from heli_lab.explain.candidates import channel_place

BASE: Final = ("N", "m", "s", "V", "rad")
"""Base units. The radian counts as 1 in the argument of a function, and is kept in units of parameters: N
m/rad is a stiffness."""
_FACTOR: Final = re.compile(r"([A-Za-z]+)(-?\d+)?")


@dataclass(frozen=True)
class Unit:
    """A unit as a product of powers."""

    exponents: tuple[int, ...] = (0,) * len(BASE)  # Exponent of each unit of `BASE`

    @classmethod
    def parse(cls, text: str) -> Unit:
        """Parse a `text` in the spelling of rig files, such as ``N m s2/rad2`` or ``1``."""
        exponents = dict.fromkeys(BASE, 0)
        for sign, part in zip((1, -1), text.partition("/")[::2], strict=True):
            for name, power in _FACTOR.findall(part):
                if name not in exponents:
                    raise ValueError(f"unknown unit '{name}' in '{text}'; use {', '.join(BASE)}")
                exponents[name] += sign * int(power or 1)
        return cls(tuple(exponents.values()))

    def __mul__(self, other: Unit) -> Unit:
        return Unit(tuple(a + b for a, b in zip(self.exponents, other.exponents, strict=True)))

    def __truediv__(self, other: Unit) -> Unit:
        return Unit(tuple(a - b for a, b in zip(self.exponents, other.exponents, strict=True)))

    def __pow__(self, power: int) -> Unit:
        return Unit(tuple(power * exponent for exponent in self.exponents))

    @property
    def is_number(self) -> bool:
        """Whether it is a pure number or an angle, and so may be the argument of a sine."""
        return not any(self.exponents[:-1])

    def __str__(self) -> str:
        def spelled(sign: int) -> str:
            """Write the units with exponents of a sign, such as ``m2 N``."""
            return " ".join(
                f"{name}{abs(power) if abs(power) > 1 else ''}"
                for name, power in zip(BASE, self.exponents, strict=True)
                if sign * power > 0
            )

        above, below = spelled(1), spelled(-1)
        return f"{above or '1'}/{below}" if below else above or "1"


NONE: Final = Unit()
"""Unit of a pure number."""


_Expression = Any
"""A casadi.SX or a numpy array."""


_SIGN_WIDTH_rad_s: Final = 0.02
"""Rate below which the sign of a rate is not known: about two encoder counts within the filter's memory.
Smaller: stiffer than a simulator's step allows. Larger: friction without a corner."""


class _SymbolKind(NamedTuple):
    """A kind of quantity."""

    unit: str  # SI unit
    sign_width: float  # Absolute value below which its sign is smoothed


_SYMBOL_KINDS: Final[Mapping[str, _SymbolKind]] = {
    "angle": _SymbolKind("rad", 0.02),
    "rate": _SymbolKind("rad/s", _SIGN_WIDTH_rad_s),
    "thrust": _SymbolKind("N", 0.05),
    "voltage": _SymbolKind("V", 0.05),
    "time": _SymbolKind("s", 0.0),
}


@dataclass(frozen=True)
class Symbol:
    """A quantity that a term may depend on."""

    value: Callable[[Operands], ca.SX]
    """Returns its expression for operands of the model; shape (2, 1), front and back, if each rotor has its
    own."""
    latex: str  # LaTeX symbol
    python: str  # Python expression in an effect file, with the operands ``at``
    kind: str  # ``angle``, ``rate``, ``thrust``, ``voltage`` or ``time``
    per_rotor: bool = False  # Whether each rotor has its own

    @property
    def unit(self) -> Unit:
        """SI unit, from which units of coefficients follow."""
        return Unit.parse(_SYMBOL_KINDS[self.kind].unit)

    @property
    def near_zero(self) -> float:
        """Absolute value, in its unit, below which its sign is smoothed."""
        return _SYMBOL_KINDS[self.kind].sign_width


def _state_quantity(name: str, latex: str, kind: str) -> Symbol:
    """Return a state of the model as a quantity."""
    return Symbol(lambda at: at.state[name], latex, f'at.state["{name}"]', kind)


_AXES_AND_SYMBOLS: Final = tuple(zip(AXES, (r"\theta", r"\phi", r"\psi"), strict=True))

SYMBOLS: Final[Mapping[str, Symbol]] = {
    **{axis: _state_quantity(f"{axis}_rad", latex, "angle") for axis, latex in _AXES_AND_SYMBOLS},
    **{
        f"{axis}_rate": _state_quantity(f"{axis}_rate_rad_s", rf"\dot{{{latex}}}", "rate")
        for axis, latex in _AXES_AND_SYMBOLS
    },
    "thrust": Symbol(
        lambda at: at.thrust_N[0] + at.thrust_N[1],
        "(F_f + F_b)",
        "(at.thrust_N[0] + at.thrust_N[1])",
        "thrust",
    ),
    "thrust_difference": Symbol(
        lambda at: at.thrust_N[0] - at.thrust_N[1],
        "(F_f - F_b)",
        "(at.thrust_N[0] - at.thrust_N[1])",
        "thrust",
    ),
    "own_thrust": Symbol(lambda at: at.thrust_N, "F", "at.thrust_N", "thrust", per_rotor=True),
    "other_thrust": Symbol(
        lambda at: ca.vertcat(at.thrust_N[1], at.thrust_N[0]),
        r"F_{\mathrm{other}}",
        "ca.vertcat(at.thrust_N[1], at.thrust_N[0])",
        "thrust",
        per_rotor=True,
    ),
    "own_voltage": Symbol(lambda at: at.volts_V, "V", "at.volts_V", "voltage", per_rotor=True),
    "voltage": Symbol(
        lambda at: at.volts_V[0] + at.volts_V[1], "(V_f + V_b)", "(at.volts_V[0] + at.volts_V[1])", "voltage"
    ),
    "time": Symbol(lambda at: at.time_s, "t", "at.time_s", "time"),
}
"""Quantities that a term may depend on, by symbol."""


@dataclass(frozen=True)
class Form:
    """A shape of function, of one quantity."""

    value: Callable[..., _Expression]
    """Returns its value for a module (numpy or casadi), the quantity and the function's parameters."""
    sympy: str
    """sympy, latex, python: Notations, with ``{x}`` for the quantity and ``{NAME}`` for a parameter."""
    latex: str
    python: str
    power: int | None  # Power of the quantity's unit that its unit is; None for a pure number
    parameter_names: tuple[str, ...] = ()  # Names of its parameters, in the order of the arguments of `value`
    needs_angle: bool = False  # Whether the quantity must be an angle


FORMS: Final[Mapping[str, Form]] = {
    "linear": Form(lambda _m, x: x, "{x}", "{x}", "{x}", 1),
    "square": Form(lambda _m, x: x * x, "{x}**2", "{x}^2", "{x} ** 2", 2),
    "cube": Form(lambda _m, x: x * x * x, "{x}**3", "{x}^3", "{x} ** 3", 3),
    "abs": Form(lambda m, x: m.fabs(x), "Abs({x})", "|{x}|", "ca.fabs({x})", 1),
    "signed_square": Form(lambda m, x: x * m.fabs(x), "{x}*Abs({x})", "{x} |{x}|", "{x} * ca.fabs({x})", 2),
    "sign": Form(
        lambda m, x, width: m.tanh(x / width),
        "tanh({x}/{width})",
        r"\tanh({x} / {width})",
        "ca.tanh({x} / {width})",
        None,
        ("width",),
    ),
    **{
        wave: Form(
            lambda m, x, k, wave=wave: getattr(m, wave)(k * x),
            f"{wave}({{k}}*{{x}})",
            rf"\{wave}({{k}}\,{{x}})",
            f"ca.{wave}({{k}} * {{x}})",
            None,
            ("k",),
            needs_angle=True,
        )
        for wave in ("sin", "cos")
    },
    "bump": Form(
        lambda m, x, place, width: m.exp(-0.5 * ((x - place) / width) ** 2),
        "exp(-(({x} - {place})/{width})**2/2)",
        r"\exp(-(({x} - {place})/{width})^2/2)",
        "ca.exp(-0.5 * (({x} - {place}) / {width}) ** 2)",
        None,
        ("place", "width"),
    ),
    "beyond": Form(
        lambda m, x, slack: m.fmax(x - slack, 0.0) - m.fmax(-x - slack, 0.0),
        "(Max({x} - {slack}, 0) - Max(-{x} - {slack}, 0))",
        r"[\max({x} - {slack}, 0) - \max(-{x} - {slack}, 0)]",
        "(ca.fmax({x} - {slack}, 0) - ca.fmax(-{x} - {slack}, 0))",
        1,
        ("slack",),
    ),
}
"""Functions of which terms are products, by name."""


@dataclass(frozen=True)
class Factor:
    """A factor of a term: a function of one quantity, or of its lagged value."""

    form: str  # Function, a key of `FORMS`
    quantity: str  # Quantity, a key of `SYMBOLS`
    parameters: tuple[tuple[str, float], ...] = ()
    """Name and value of the function's parameters, and of ``s``, the time constant of a lag in seconds."""
    lag_filter: str = ""
    """Empty for the quantity itself, ``lag`` for the quantity behind a first-order lag, ``washout`` for the
    lagged quantity less the quantity."""

    def __post_init__(self) -> None:
        if FORMS[self.form].needs_angle and not SYMBOLS[self.quantity].unit.is_number:
            raise ValueError(f"{self.form} of {self.quantity} [{SYMBOLS[self.quantity].unit}]")

    @property
    def unit(self) -> Unit:
        """SI unit."""
        power = FORMS[self.form].power
        return NONE if power is None else SYMBOLS[self.quantity].unit ** power

    @property
    def per_rotor(self) -> bool:
        """Whether each rotor has its own."""
        return SYMBOLS[self.quantity].per_rotor

    def value(self, module: Any, x: _Expression, parameters: Mapping[str, Any] | None = None) -> _Expression:
        """Evaluate the function."""
        values = {**dict(self.parameters), **(parameters or {})}
        form = FORMS[self.form]
        return form.value(module, x, *(values[name] for name in form.parameter_names))

    def parameter_unit(self, name: str) -> Unit:
        """Unit of the parameter `name`."""
        if name == "s":
            return Unit.parse("s")
        return NONE if name == "k" else SYMBOLS[self.quantity].unit

    def formatted(self, notation: str, symbols: Mapping[str, str], x: str | None = None) -> str:
        """Write the factor in a notation."""
        # SymPy has functions for a lagged quantity, and LaTeX a subscript. In Python, a lagged quantity is a
        # state of the effect, and `x` is the code that reads it.
        quantity = SYMBOLS[self.quantity]
        if x is None:
            x = {"sympy": self.quantity, "latex": quantity.latex, "python": quantity.python}[notation]
            if self.lag_filter and notation == "sympy":
                x = f"{self.lag_filter}({x}, {symbols['s']})"
            elif self.lag_filter and notation == "latex":
                lag = rf"{x}_{{{symbols['s']}}}"
                x = lag if self.lag_filter == "lag" else rf"({lag} - {x})"
        return str(getattr(FORMS[self.form], notation)).format(x=x, **symbols)


@dataclass(frozen=True)
class Term:
    """A product of `factors`; 1 if there are none."""

    factors: tuple[Factor, ...]

    @property
    def unit(self) -> Unit:
        """SI unit."""
        unit = NONE
        for factor in self.factors:
            unit = unit * factor.unit
        return unit

    @property
    def quantities(self) -> tuple[str, ...]:
        """Quantities that it depends on, each once."""
        return tuple(dict.fromkeys(factor.quantity for factor in self.factors))

    @property
    def key(self) -> str:
        """The term as text, with values of its inner parameters."""
        return "*".join(
            factor.formatted("sympy", {name: f"{value:.4g}" for name, value in factor.parameters})
            for factor in self.factors
        )


NAME: Final = "proposed_term"
"""Id of the effect that a proposed equation becomes."""


class EquationChannel(NamedTuple):
    """A place where a term may act."""

    unit: str  # Unit of the term
    stage: Stage  # Stage of the effect


CHANNELS: Final[Mapping[str, EquationChannel]] = {
    **{f"torque.{axis}": EquationChannel("N m", Stage.TORQUE) for axis in AXES},
    **{
        f"thrust.{rotors}": EquationChannel("N", Stage.INFLOW)
        for rotors in ("both", "difference", "front", "back")
    },
    **{f"voltage.{rotors}": EquationChannel("V", Stage.CURVE) for rotors in ("both", "front", "back")},
    **{f"measurement.{axis}": EquationChannel("rad", Stage.SHAFT) for axis in AXES},
}
"""Where a term may act, by name. A term of ``thrust.difference`` is added to the front rotor's thrust and
subtracted from the back rotor's."""
_ROTORS: Final[Mapping[str, tuple[int, int]]] = {
    "both": (1, 1),
    "difference": (1, -1),
    "front": (1, 0),
    "back": (0, 1),
}
_MIN_s, _MAX_s = 0.02, 5.0
"""Bounds of a lag's time constant: below, it is the filter's own step; above, a slow disturbance."""


def rotor_signs(channel: str) -> tuple[int, int]:
    """Return the signs with which a term of a thrust or voltage `channel` acts on the two rotors."""
    # They are 1, 0 or -1, for the front and for the back rotor.
    return _ROTORS[channel_place(channel)]


@dataclass(frozen=True)
class EquationTerm:
    """A term and the channel that it acts on."""

    channel: str  # One of `CHANNELS`
    term: Term  # The product of factors that is added, without its coefficient

    @property
    def coefficient_unit(self) -> Unit:
        """Unit of the coefficient: the channel's unit over the term's."""
        return Unit.parse(CHANNELS[self.channel].unit) / self.term.unit

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

    def coefficient_name(self, number: int) -> str:
        """Return the name of the coefficient of term `number`, counted from 0, such as ``c1_Nm_per_rad``."""
        unit = str(self.terms[number].coefficient_unit)
        unit_suffix = unit.replace(" ", "").replace("/", "_per_").removeprefix("1_")
        return f"c{number + 1}" + ("" if unit == "1" else f"_{unit_suffix}")

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names of all coefficients, in the order of the terms."""
        return tuple(self.coefficient_name(i) for i in range(len(self.terms)))

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
        """Return the names of the inner parameters of factor `j` of term `i`."""
        # The keys are their names in the factor, and the values their names in the equation.
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
    """Return the label of factor `j` of term `i` in names of parameters."""
    # The factors of term 0 are ``1``, ``1b``, ``1c``.
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
        """Yield channel and value of each term on a channel of a kind, such as ``torque``."""
        for i, term in enumerate(self.equation.terms):
            if term.channel.startswith(kind):
                coefficient = self.value(at, self.equation.coefficient_name(i))
                factors = [self._factor_value(at, i, j, factor) for j, factor in enumerate(term.term.factors)]
                yield term.channel, math.prod(factors, start=coefficient)

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
        """Return the state of the first-order lag of a factor."""
        # The shape is (1, 1), or (2, 1) if each rotor has its own state.
        name = lag_state_name(i, j)
        if not factor.per_rotor:
            return self.value(at, name)
        return ca.vertcat(self.value(at, f"{name}_front"), self.value(at, f"{name}_back"))

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Torques of the equation [N m], shape (3, 1); see `Effect.torque_Nm`."""
        torque_by_axis: dict[str, ca.SX] = {}
        for channel, value in self._channel_values(at, "torque"):
            axis = channel_place(channel)
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
            axis = channel_place(channel)
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
    equation: Equation, prior_std: Mapping[str, float], held: Collection[str] = (), name: str = NAME
) -> EquationEffect:
    """Make the effect of an equation with all coefficients at 0."""
    # `held`: Names of the inner parameters that keep their values: they get no prior.
    prefix = name.replace(".", "_")
    values, priors, parameters = dict[str, float](), dict[str, Prior](), []
    for coefficient, term in zip(equation.coefficient_names, equation.terms, strict=True):
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
        stage=min(CHANNELS[channel].stage for channel in equation.channels),
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
        return Prior(mean=value, std=value, low=_MIN_s, high=_MAX_s)
    if inner_name == "place":
        width = dict(factor.parameters)["width"]
        return Prior(mean=value, std=width, low=value - 4.0 * width, high=value + 4.0 * width)
    std, low, high = _INNER_PRIOR[inner_name]
    return Prior(mean=value, std=std * value, low=low * value, high=high * value)
