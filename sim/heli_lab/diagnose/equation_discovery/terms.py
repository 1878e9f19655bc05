"""Terms of a law: products of functions of angles, rates, thrusts and voltages, in four notations.

A term is computed along a flight (numpy), in a model (CasADi), and written for people (SymPy, LaTeX) and for
a simulator (Python). All four come from one table of functions and one of quantities.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import casadi as ca
from heli_sim.model.base import Operands
from heli_sim.model.parts import AXES

from heli_lab.diagnose.equation_discovery.units import NONE, Unit

_Value = Any
"""A casadi.SX or a numpy array."""


@dataclass(frozen=True)
class Quantity:
    """Something that a term may depend on.

    Parameters
    ----------
    value : callable
        Its expression by the operands of an equation; (2, 1), front and back, where it is each rotor's own.
    unit : Unit
        SI; the unit of a coefficient follows from it.
    latex : str
        How it is written for people.
    python : str
        How it is written in an effect file, by the operands ``at``.
    kind : str
        ``angle``, ``rate``, ``thrust``, ``voltage`` or ``time``.
    near_zero : float
        Size, in its unit, below which its sign is smoothed.
    each : bool
        Whether it is each rotor's own.
    """

    value: Callable[[Operands], ca.SX]
    unit: Unit
    latex: str
    python: str
    kind: str
    near_zero: float = 0.0
    each: bool = False


def _state(name: str) -> Callable[[Operands], ca.SX]:
    return lambda at: at.state[name]


_GREEK: Final = (r"\theta", r"\phi", r"\psi")
_REST_rad_s: Final = 0.02
"""Rate up to which an axis is nearly at rest, about two encoder counts in the filter's memory: a law cannot
tell its sign there. Smaller: stiffer than a simulator's step follows. Larger: friction without a corner."""
_STILL_N: Final = 0.05
_STILL_V: Final = 0.05

QUANTITIES: Final[Mapping[str, Quantity]] = {
    **{
        axis: Quantity(
            _state(f"{axis}_rad"), Unit.parse("rad"), latex, f'at.state["{axis}_rad"]', "angle", 0.02
        )
        for axis, latex in zip(AXES, _GREEK, strict=True)
    },
    **{
        f"{axis}_rate": Quantity(
            _state(f"{axis}_rate_rad_s"),
            Unit.parse("rad/s"),
            rf"\dot{{{latex}}}",
            f'at.state["{axis}_rate_rad_s"]',
            "rate",
            _REST_rad_s,
        )
        for axis, latex in zip(AXES, _GREEK, strict=True)
    },
    "thrust": Quantity(
        lambda at: at.thrust_N[0] + at.thrust_N[1],
        Unit.parse("N"),
        "(F_f + F_b)",
        "(at.thrust_N[0] + at.thrust_N[1])",
        "thrust",
        _STILL_N,
    ),
    "thrust_difference": Quantity(
        lambda at: at.thrust_N[0] - at.thrust_N[1],
        Unit.parse("N"),
        "(F_f - F_b)",
        "(at.thrust_N[0] - at.thrust_N[1])",
        "thrust",
        _STILL_N,
    ),
    "own_thrust": Quantity(
        lambda at: at.thrust_N, Unit.parse("N"), "F", "at.thrust_N", "thrust", _STILL_N, each=True
    ),
    "other_thrust": Quantity(
        lambda at: ca.vertcat(at.thrust_N[1], at.thrust_N[0]),
        Unit.parse("N"),
        r"F_{\mathrm{other}}",
        "ca.vertcat(at.thrust_N[1], at.thrust_N[0])",
        "thrust",
        _STILL_N,
        each=True,
    ),
    "own_voltage": Quantity(
        lambda at: at.volts_V, Unit.parse("V"), "V", "at.volts_V", "voltage", _STILL_V, each=True
    ),
    "voltage": Quantity(
        lambda at: at.volts_V[0] + at.volts_V[1],
        Unit.parse("V"),
        "(V_f + V_b)",
        "(at.volts_V[0] + at.volts_V[1])",
        "voltage",
        _STILL_V,
    ),
    "time": Quantity(lambda at: at.time_s, Unit.parse("s"), "t", "at.time_s", "time"),
}
"""What a term may depend on, by the symbol that stands for it."""


@dataclass(frozen=True)
class Form:
    """A function of one quantity.

    Parameters
    ----------
    value : callable
        Its value by the functions' module (numpy or casadi), the quantity and the function's numbers.
    sympy, latex, python : str
        How it is written, with ``{x}`` for the quantity and ``{NAME}`` for a number.
    power : int or None
        Power of the quantity's unit that it has; None for a pure number.
    numbers : tuple of str
        Numbers of its own.
    pure : bool
        Whether the quantity must be an angle.
    odd : bool
        Whether its sign turns with the quantity's.
    """

    value: Callable[..., _Value]
    sympy: str
    latex: str
    python: str
    power: int | None
    numbers: tuple[str, ...] = ()
    pure: bool = False
    odd: bool = False


FORMS: Final[Mapping[str, Form]] = {
    "linear": Form(lambda _m, x: x, "{x}", "{x}", "{x}", 1, odd=True),
    "square": Form(lambda _m, x: x * x, "{x}**2", "{x}^2", "{x} ** 2", 2),
    "cube": Form(lambda _m, x: x * x * x, "{x}**3", "{x}^3", "{x} ** 3", 3, odd=True),
    "abs": Form(lambda m, x: m.fabs(x), "Abs({x})", "|{x}|", "ca.fabs({x})", 1),
    "signed_square": Form(
        lambda m, x: x * m.fabs(x), "{x}*Abs({x})", "{x} |{x}|", "{x} * ca.fabs({x})", 2, odd=True
    ),
    "sign": Form(
        lambda m, x, width: m.tanh(x / width),
        "tanh({x}/{width})",
        r"\tanh({x} / {width})",
        "ca.tanh({x} / {width})",
        None,
        ("width",),
        odd=True,
    ),
    "sin": Form(
        lambda m, x, k: m.sin(k * x),
        "sin({k}*{x})",
        r"\sin({k}\,{x})",
        "ca.sin({k} * {x})",
        None,
        ("k",),
        pure=True,
        odd=True,
    ),
    "cos": Form(
        lambda m, x, k: m.cos(k * x),
        "cos({k}*{x})",
        r"\cos({k}\,{x})",
        "ca.cos({k} * {x})",
        None,
        ("k",),
        pure=True,
    ),
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
        odd=True,
    ),
}
"""Functions that terms are products of."""

MEMORIES: Final = ("", "lag", "washout")
"""A quantity as it is, behind a first-order lag, or what the lag takes from it: lag less the quantity."""


@dataclass(frozen=True)
class Factor:
    """A function of one quantity.

    Parameters
    ----------
    form : str
        One of `FORMS`.
    quantity : str
        One of `QUANTITIES`.
    numbers : tuple of (str, float)
        Numbers of the function, and ``s``, the time constant of a memory.
    memory : str
        One of `MEMORIES`.

    Raises
    ------
    ValueError
        When a sine is asked of something that is no angle.
    """

    form: str
    quantity: str
    numbers: tuple[tuple[str, float], ...] = ()
    memory: str = ""

    def __post_init__(self) -> None:
        if FORMS[self.form].pure and not QUANTITIES[self.quantity].unit.is_number:
            raise ValueError(f"{self.form} of {self.quantity} [{QUANTITIES[self.quantity].unit}]")

    @property
    def unit(self) -> Unit:
        """Its unit."""
        power = FORMS[self.form].power
        return NONE if power is None else QUANTITIES[self.quantity].unit ** power

    @property
    def each(self) -> bool:
        """Whether it is each rotor's own."""
        return QUANTITIES[self.quantity].each

    def value(self, module: Any, x: _Value, numbers: Mapping[str, Any] | None = None) -> _Value:
        """Evaluate for values `x` of the quantity, memory included, with the functions of a `module` (numpy
        or casadi) and, where given, other `numbers`.
        """
        given = {**dict(self.numbers), **(numbers or {})}
        form = FORMS[self.form]
        return form.value(module, x, *(given[name] for name in form.numbers))

    def number_unit(self, name: str) -> Unit:
        """Unit of the number `name`."""
        if name == "s":
            return Unit.parse("s")
        return NONE if name == "k" else QUANTITIES[self.quantity].unit

    def written(self, notation: str, symbols: Mapping[str, str], x: str | None = None) -> str:
        """Write it in a notation, ``sympy``, ``latex`` or ``python``, with texts for its numbers.

        Parameters
        ----------
        notation : str
            Column of `FORMS` and `QUANTITIES`.
        symbols : Mapping[str, str]
            Text of each number of the function.
        x : str, optional
            What stands for the quantity with its memory, where the notation has no function for it.
        """
        quantity = QUANTITIES[self.quantity]
        if x is None:
            x = {"sympy": self.quantity, "latex": quantity.latex, "python": quantity.python}[notation]
            if self.memory and notation == "sympy":
                x = f"{self.memory}({x}, {symbols['s']})"
            elif self.memory and notation == "latex":
                lag = rf"{x}_{{{symbols['s']}}}"
                x = lag if self.memory == "lag" else rf"({lag} - {x})"
        return str(getattr(FORMS[self.form], notation)).format(x=x, **symbols)


@dataclass(frozen=True)
class Term:
    """A product of factors; without any it is 1."""

    factors: tuple[Factor, ...]

    @property
    def unit(self) -> Unit:
        """Its unit."""
        unit = NONE
        for factor in self.factors:
            unit = unit * factor.unit
        return unit

    @property
    def quantities(self) -> tuple[str, ...]:
        """What it depends on."""
        return tuple(dict.fromkeys(factor.quantity for factor in self.factors))

    @property
    def key(self) -> str:
        """The term with its numbers, as text."""
        return "*".join(
            factor.written("sympy", {name: f"{value:.4g}" for name, value in factor.numbers})
            for factor in self.factors
        )
