"""Terms of equations: products of functions of angles, rates, thrusts and voltages, in several notations.

A term is evaluated along a flight (NumPy) and in a model (CasADi), and written for readers (SymPy, LaTeX)
and for a simulator (Python). All notations follow from one table of functions and one table of quantities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import casadi as ca
from heli_sim.model.base import Operands
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.units import NONE, Unit

_Expression = Any
"""A casadi.SX or a numpy array."""


_SIGN_WIDTH_rad_s: Final = 0.02
"""Rate below which the sign of a rate is not known: about two encoder counts within the filter's memory.
Smaller: stiffer than a simulator's step allows. Larger: friction without a corner."""
_UNIT_AND_SIGN_WIDTH: Final[Mapping[str, tuple[str, float]]] = {
    "angle": ("rad", 0.02),
    "rate": ("rad/s", _SIGN_WIDTH_rad_s),
    "thrust": ("N", 0.05),
    "voltage": ("V", 0.05),
    "time": ("s", 0.0),
}
"""For each kind of quantity its SI unit, and the absolute value below which its sign is smoothed."""


@dataclass(frozen=True)
class Quantity:
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
        return Unit.parse(_UNIT_AND_SIGN_WIDTH[self.kind][0])

    @property
    def near_zero(self) -> float:
        """Absolute value, in its unit, below which its sign is smoothed."""
        return _UNIT_AND_SIGN_WIDTH[self.kind][1]


def _state_quantity(name: str, latex: str, kind: str) -> Quantity:
    """Return a state of the model as a quantity."""
    return Quantity(lambda at: at.state[name], latex, f'at.state["{name}"]', kind)


_AXES_AND_SYMBOLS: Final = tuple(zip(AXES, (r"\theta", r"\phi", r"\psi"), strict=True))

SYMBOLS: Final[Mapping[str, Quantity]] = {
    **{axis: _state_quantity(f"{axis}_rad", latex, "angle") for axis, latex in _AXES_AND_SYMBOLS},
    **{
        f"{axis}_rate": _state_quantity(f"{axis}_rate_rad_s", rf"\dot{{{latex}}}", "rate")
        for axis, latex in _AXES_AND_SYMBOLS
    },
    "thrust": Quantity(
        lambda at: at.thrust_N[0] + at.thrust_N[1],
        "(F_f + F_b)",
        "(at.thrust_N[0] + at.thrust_N[1])",
        "thrust",
    ),
    "thrust_difference": Quantity(
        lambda at: at.thrust_N[0] - at.thrust_N[1],
        "(F_f - F_b)",
        "(at.thrust_N[0] - at.thrust_N[1])",
        "thrust",
    ),
    "own_thrust": Quantity(lambda at: at.thrust_N, "F", "at.thrust_N", "thrust", per_rotor=True),
    "other_thrust": Quantity(
        lambda at: ca.vertcat(at.thrust_N[1], at.thrust_N[0]),
        r"F_{\mathrm{other}}",
        "ca.vertcat(at.thrust_N[1], at.thrust_N[0])",
        "thrust",
        per_rotor=True,
    ),
    "own_voltage": Quantity(lambda at: at.volts_V, "V", "at.volts_V", "voltage", per_rotor=True),
    "voltage": Quantity(
        lambda at: at.volts_V[0] + at.volts_V[1], "(V_f + V_b)", "(at.volts_V[0] + at.volts_V[1])", "voltage"
    ),
    "time": Quantity(lambda at: at.time_s, "t", "at.time_s", "time"),
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
        """Write the factor in a notation.

        SymPy has functions for a lagged quantity, and LaTeX a subscript. In Python, a lagged quantity is a
        state of the effect, and `x` is the code that reads it.
        """
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
