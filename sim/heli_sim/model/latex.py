r"""Equations of a model as LaTeX, from the symbols that are simulated.

Only what matplotlib's mathtext knows is used. Parts that come up more than once get names of their own, a_1,
a_2 and so on, each in a line before the one that first needs it. Products are written with ``\,`` between
their factors, so that no name can be taken for two.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca

from heli_sim.errors import PlantError
from heli_sim.model.base import Model, Operands
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.parts import AXES, friction_torque_Nm

_ANGLES: Final = (r"\theta", r"\phi", r"\psi")
_RATES: Final = (r"\dot{\theta}", r"\dot{\phi}", r"\dot{\psi}")
_ACCELERATIONS: Final = (r"\ddot{\theta}", r"\ddot{\phi}", r"\ddot{\psi}")
_NAMES: Final[Mapping[str, str]] = {
    **{f"{axis}_rad": name for axis, name in zip(AXES, _ANGLES, strict=True)},
    **{f"{axis}_rate_rad_s": name for axis, name in zip(AXES, _RATES, strict=True)},
    **{f"friction_{axis}": f"f_{{{name}}}" for axis, name in zip(AXES, _ANGLES, strict=True)},
    **{f"torque_{axis}": f"D_{{{name}}}" for axis, name in zip(AXES, _ANGLES, strict=True)},
    **{f"M_{part}": f"M_{{{part}}}" for part in "fbwhl"},
    **{f"L_{part}": f"L_{{{part}}}" for part in "abhx"},
    "L_phi": r"L_{\phi}",
    "L_theta": r"L_{\theta}",
    "g": "g",
    "thrust_gain": "k",
    "dead_zone": "V_{0}",
    "reverse_thrust": "r",
    "air_density": r"\rho",
    "drag_area_arm": "A_{1}",
    "drag_area_body": "A_{2}",
}
_MIN_OPERATIONS: Final = 2
"""A part that comes up again is named from this many operations on."""


@dataclass(frozen=True)
class Equation:
    """One line, `left` = `right`, in LaTeX without dollar signs."""

    left: str
    right: str

    @property
    def text(self) -> str:
        """The whole line."""
        return f"{self.left} = {self.right}"


def symbol(name: str) -> str:
    """Return the LaTeX symbol of a state, a parameter or an input of a `Model`, by its `name`: the paper's
    letter if there is one, otherwise the name in upright letters.
    """
    if name in _NAMES:
        return _NAMES[name]
    if name.startswith("P_"):
        return f"P_{{{name[2:]}}}"
    return r"\mathrm{" + name.replace("_", r"\_") + "}"


def equations(model: Model) -> list[Equation]:
    """Write a model's equations of motion, in an order in which every name is known before it is used. F_f
    and F_b are the thrusts, f friction, D constant torques. A multibody model is written with its mass matrix
    M, potential energy U and generalised forces Q; Coriolis and centrifugal forces c follow from M by the
    rule in its first line. Dry friction goes by the acceleration without it, with the index 0, and the
    inertia J of the axis.

    Parameters
    ----------
    model : Model
        The model; its effects follow its own equations.

    Raises
    ------
    PlantError
        When an effect uses an operation that has no LaTeX here.
    """
    at = _situation(model)
    F = ca.vertcat(ca.SX.sym("F_{f}"), ca.SX.sym("F_{b}"))
    out = _thrust(at)
    rates = ca.vertcat(*(at.state[f"{axis}_rate_rad_s"] for axis in AXES))
    torque = friction_torque_Nm(rates, at.parameter) + ca.vertcat(
        *(at.parameter[f"torque_{axis}"] for axis in AXES)
    )
    writer = _Writer()
    if isinstance(model, MultibodyModel):
        out += _multibody(model, at, F, torque, rates, writer)
    else:
        out += _accelerations(model.acceleration(at, F, torque), writer)
    free = ca.vertcat(*(ca.SX.sym(rf"\ddot{{{angle}}}_{{0}}") for angle in _ANGLES))
    inertia = ca.vertcat(*(ca.SX.sym(f"J_{{{angle}}}") for angle in _ANGLES))
    for effect in model.effects:
        added = effect.torque_Nm(at) + effect.friction_Nm(at, free, inertia)
        out += _effect(effect.name, added, effect.thrust_N(at, F), F, writer)
        if effect.states:
            lefts = [rf"\dot{{{symbol(state.name)}}}" for state in effect.states]
            out += writer.lines(lefts, effect.state_rates(replace(at, thrust_N=F)))
    return out


def _situation(model: Model) -> Operands:
    """Return states, voltages and parameters of a model as symbols with their names in LaTeX."""
    names = {q.name: ca.SX.sym(symbol(q.name)) for q in (*model.states, *model.parameters)}
    volts = ca.vertcat(ca.SX.sym("V_{f}"), ca.SX.sym("V_{b}"))
    return Operands(
        {state.name: names[state.name] for state in model.states},
        volts,
        {parameter.name: names[parameter.name] for parameter in model.parameters},
        ca.SX.sym("t"),
    )


def _thrust(at: Operands) -> list[Equation]:
    p = at.parameter
    volts = ca.SX.sym("V_{i}")
    straight = p["thrust_gain"] * ca.fmax(volts - p["dead_zone"], 0.0)
    return _Writer().lines(["F_{i}"], straight)


def _multibody(
    model: MultibodyModel, at: Operands, F: ca.SX, torque: ca.SX, rates: ca.SX, writer: _Writer
) -> list[Equation]:
    """Return the equations of the multibody model: Lagrange's equation, then the inertias, the potential
    energy and the generalised forces that it contains.
    """
    inertia = model.inertia_kg_m2(at)
    potential = ca.substitute(model.energy_J(at), rates, ca.SX.zeros(3))
    forces = model.thrust_torque_Nm(at, F) + torque
    places = [(row, column) for row in range(3) for column in range(row, 3)]
    lefts = [f"M_{{{_ANGLES[row]}{_ANGLES[column]}}}" for row, column in places]
    lefts += ["U", *(f"Q_{{{angle}}}" for angle in _ANGLES)]
    rights = ca.vertcat(*(inertia[row, column] for row, column in places), potential, forces)
    rule = Equation(
        r"M\,\ddot{q} + \dot{M}\,\dot{q} - \frac{1}{2}\,\frac{\partial}{\partial q}"
        r"\left(\dot{q}^{T}\,M\,\dot{q}\right) + \frac{\partial U}{\partial q}",
        r"Q,\quad q = \left(\theta, \phi, \psi\right)",
    )
    return [rule, *writer.lines(lefts, rights)]


def _accelerations(acceleration: ca.SX, writer: _Writer) -> list[Equation]:
    """Write torque over inertia as inertia times acceleration; leave anything else unchanged."""
    parts = [acceleration[row] for row in range(3)]
    if not all(part.is_op(ca.OP_DIV) for part in parts):
        return writer.lines(_ACCELERATIONS, acceleration)
    inertias = [f"J_{{{angle}}}" for angle in _ANGLES]
    lefts = [rf"{J}\,{rate}" for J, rate in zip(inertias, _ACCELERATIONS, strict=True)]
    return [
        *writer.lines(inertias, ca.vertcat(*(part.dep(1) for part in parts))),
        *writer.lines(lefts, ca.vertcat(*(part.dep(0) for part in parts))),
    ]


def _effect(name: str, torque: ca.SX, thrust: ca.SX, F: ca.SX, writer: _Writer) -> list[Equation]:
    """Return what an effect adds to the torques, and how it changes the thrusts."""
    upright = symbol(name)
    out = []
    for row, angle in enumerate(_ANGLES):
        if not torque[row].is_zero():
            out += writer.lines([rf"\Delta Q_{{{angle}}}^{{{upright}}}"], torque[row])
    for row, rotor in enumerate("fb"):
        if not ca.is_equal(thrust[row], F[row]):
            out += writer.lines([rf"F_{{{rotor}}}^{{{upright}}}"], thrust[row])
    return out


# How tightly an operation binds what it joins.
_SUM, _SIGNED, _PRODUCT, _POWER, _ATOM = range(5)
_FUNCTIONS: Final[Mapping[int, str]] = {
    ca.OP_SIN: r"\sin",
    ca.OP_COS: r"\cos",
    ca.OP_TAN: r"\tan",
    ca.OP_ATAN: r"\arctan",
    ca.OP_TANH: r"\tanh",
    ca.OP_EXP: r"\exp",
    ca.OP_LOG: r"\ln",
}


_LAST: Final = tuple(_FUNCTIONS.values())
_HALF: Final = 0.5


class _Writer:
    """Converts expressions to LaTeX, and keeps the names that it has given."""

    def __init__(self) -> None:
        self._named: dict[int, str] = {}
        self._cached: list[ca.SX] = []  # an expression that is let go of may lend its hash to another
        self._again: set[int] = set()

    def lines(self, lefts: Sequence[str], rights: ca.SX) -> list[Equation]:
        """Write each expression, and before it the subexpressions that it uses first."""
        parts = [ca.SX(rights[row]) for row in range(rights.numel())]
        self._cached += parts
        self._again |= _shared(parts)
        out: list[Equation] = []
        for left, part in zip(lefts, parts, strict=True):
            self._name_parts(part, out)
            out.append(Equation(left, self._text(part)[0]))
        return out

    def _name_parts(self, of: ca.SX, out: list[Equation]) -> None:
        """Give a name to each part of an expression that occurs again, with an equation for it in `out`."""
        for child in _below(of):
            key = child.element_hash()
            if key in self._named:
                continue
            self._name_parts(child, out)
            if key in self._again:
                right = self._text(child)[0]
                self._named[key] = self._new_name(child)
                out.append(Equation(self._named[key], right))

    def _new_name(self, of: ca.SX) -> str:
        letter = r"\zeta" if of.op() == ca.OP_ATAN else "a"
        taken = sum(name.startswith(letter) for name in self._named.values())
        return f"{letter}_{{{taken + 1}}}"

    def _text(self, of: ca.SX) -> tuple[str, int]:
        """Return an expression in LaTeX, and how strongly it binds, for the parentheses around it."""
        if of.element_hash() in self._named:
            return self._named[of.element_hash()], _ATOM
        if of.is_constant():
            number = float(of)
            text = r"\frac{1}{2}" if abs(number) == _HALF else f"{abs(number):.12g}"
            return (f"-{text}", _SIGNED) if number < 0.0 else (text, _ATOM)
        if of.is_symbolic():
            return of.name(), _ATOM
        write = _OPERATIONS.get(of.op())
        if write is None:
            raise PlantError(
                f"an effect uses the operation '{of}', which has no LaTeX", "leave the effect out"
            )
        return write(self, of)

    def within(self, of: ca.SX, least: int) -> str:
        """Write an operand, in brackets if it binds less strongly than required."""
        text, binds = self._text(of)
        return text if binds >= least else rf"\left({text}\right)"

    def sum(self, of: ca.SX) -> tuple[str, int]:
        """Return a sum or difference in LaTeX."""
        first, (second, binds) = self._text(of.dep(0))[0], self._text(of.dep(1))
        minus = of.op() == ca.OP_SUB
        if binds == _SIGNED or (not minus and second.startswith("-")):
            minus, second = not minus, second[1:]
        elif minus and binds == _SUM:
            second = rf"\left({second}\right)"
        return f"{first} {'-' if minus else '+'} {second}", _SUM

    def product(self, of: ca.SX) -> tuple[str, int]:
        """Return a product in LaTeX: numbers first, then symbols, sums in parentheses, and functions."""
        negative, factors = False, []
        for factor in self._factors(of):
            text, binds = self._text(factor)
            if binds == _SIGNED:
                negative, text, binds = not negative, text[1:], _PRODUCT
            if factor.is_constant():
                order = 0
            elif binds <= _SUM:
                order, text = 2, rf"\left({text}\right)"
            else:
                # A function comes last: what follows it would read as part of its argument.
                order = 3 if text.startswith(_LAST) else 1
            factors.append((order, text))
        joined = r"\,".join(text for _, text in sorted(factors, key=lambda pair: pair[0]))
        return (f"-{joined}", _SIGNED) if negative else (joined, _PRODUCT)

    def _factors(self, of: ca.SX) -> list[ca.SX]:
        if of.element_hash() in self._named or of.op() != ca.OP_MUL or of.is_constant() or of.is_symbolic():
            return [of]
        return [*self._factors(of.dep(0)), *self._factors(of.dep(1))]

    def fraction(self, of: ca.SX) -> tuple[str, int]:
        return rf"\frac{{{self._text(of.dep(0))[0]}}}{{{self._text(of.dep(1))[0]}}}", _ATOM

    def minus(self, of: ca.SX) -> tuple[str, int]:
        return f"-{self.within(of.dep(0), _PRODUCT)}", _SIGNED

    def twice(self, of: ca.SX) -> tuple[str, int]:
        text, binds = self._text(of.dep(0))
        if binds == _SIGNED:
            return rf"-2\,{text[1:]}", _SIGNED
        return rf"2\,{self.within(of.dep(0), _PRODUCT)}", _PRODUCT

    def inverse(self, of: ca.SX) -> tuple[str, int]:
        return rf"\frac{{1}}{{{self._text(of.dep(0))[0]}}}", _ATOM

    def square(self, of: ca.SX) -> tuple[str, int]:
        inner = of.dep(0)
        if inner.op() in _FUNCTIONS and inner.element_hash() not in self._named:
            return f"{_FUNCTIONS[inner.op()]}^{{2}}{self._argument(inner)}", _POWER
        return f"{self.within(inner, _ATOM)}^{{2}}", _POWER

    def power(self, of: ca.SX) -> tuple[str, int]:
        return f"{self.within(of.dep(0), _ATOM)}^{{{self._text(of.dep(1))[0]}}}", _POWER

    def root(self, of: ca.SX) -> tuple[str, int]:
        return rf"\sqrt{{{self._text(of.dep(0))[0]}}}", _ATOM

    def size(self, of: ca.SX) -> tuple[str, int]:
        return rf"\left|{self._text(of.dep(0))[0]}\right|", _ATOM

    def function(self, of: ca.SX) -> tuple[str, int]:
        return f"{_FUNCTIONS[of.op()]}{self._argument(of)}", _POWER

    def extreme(self, of: ca.SX) -> tuple[str, int]:
        name = r"\max" if of.op() == ca.OP_FMAX else r"\min"
        return rf"{name}\left({self._text(of.dep(0))[0]}, {self._text(of.dep(1))[0]}\right)", _ATOM

    def _argument(self, of: ca.SX) -> str:
        inner = of.dep(0)
        text, binds = self._text(inner)
        return f" {text}" if binds == _ATOM and inner.is_symbolic() else rf"\left({text}\right)"


_OPERATIONS: Final[Mapping[int, Callable[[_Writer, ca.SX], tuple[str, int]]]] = {
    **dict.fromkeys((ca.OP_ADD, ca.OP_SUB), _Writer.sum),
    ca.OP_MUL: _Writer.product,
    ca.OP_DIV: _Writer.fraction,
    ca.OP_NEG: _Writer.minus,
    ca.OP_TWICE: _Writer.twice,
    ca.OP_INV: _Writer.inverse,
    ca.OP_SQ: _Writer.square,
    **dict.fromkeys((ca.OP_POW, ca.OP_CONSTPOW), _Writer.power),
    ca.OP_SQRT: _Writer.root,
    ca.OP_FABS: _Writer.size,
    **dict.fromkeys(_FUNCTIONS, _Writer.function),
    **dict.fromkeys((ca.OP_FMAX, ca.OP_FMIN), _Writer.extreme),
}


def _below(of: ca.SX) -> Iterable[ca.SX]:
    return () if of.is_constant() or of.is_symbolic() else (of.dep(i) for i in range(of.n_dep()))


def _shared(roots: Iterable[ca.SX]) -> set[int]:
    """Hashes of subexpressions that occur more than once and are large enough for a name."""
    parents: dict[int, int] = {}
    size: dict[int, int] = {}
    signs: set[int] = set()  # a sign or a factor of 2 deserves no name

    def visit(of: ca.SX) -> int:
        """Count the operations of an expression, and how often each of its parts occurs."""
        key = of.element_hash()
        parents[key] = parents.get(key, 0) + 1
        if not of.is_constant() and not of.is_symbolic() and of.op() in (ca.OP_NEG, ca.OP_TWICE):
            signs.add(key)
        if key not in size:
            size[key] = 0 if of.is_constant() or of.is_symbolic() else 1 + sum(map(visit, _below(of)))
        return size[key]

    for root in roots:
        visit(root)
    return {key for key, count in parents.items() if count > 1 and size[key] >= _MIN_OPERATIONS} - signs
