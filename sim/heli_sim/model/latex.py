r"""Equations of a model as LaTeX, from the same CasADi expressions that are simulated.

The LaTeX is limited to what matplotlib's mathtext can draw. A subexpression that occurs more than once gets a
name, a_1, a_2 and so on, with an equation before its first use. Factors of a product are separated by ``\,``,
so that a name of several letters is not read as a product.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca

from heli_sim.errors import PlantError
from heli_sim.model.base import Model, Operands
from heli_sim.model.effect import AXES, friction_torque_Nm
from heli_sim.model.multibody import MultibodyModel

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
"""Smallest number of operations in a repeated subexpression that gets a name."""


@dataclass(frozen=True)
class Equation:
    """One equation, `left` = `right`, in LaTeX without dollar signs."""

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
    """Return a model's equations of motion, each symbol defined before its first use."""
    # F_f and F_b are the thrusts, f viscous frictions, and D constant torques. A multibody model is written
    # with its mass matrix M, potential energy U and generalised forces Q; the first equation shows how
    # Coriolis and centrifugal forces follow from M. Dry friction is written with the acceleration that the
    # axis would have without it, which has the index 0, and with the inertia J of the axis.
    at = _symbolic_operands(model)
    F = ca.vertcat(ca.SX.sym("F_{f}"), ca.SX.sym("F_{b}"))
    result = _thrust_equation(at)
    rates = ca.vertcat(*(at.state[f"{axis}_rate_rad_s"] for axis in AXES))
    torque = friction_torque_Nm(rates, at.parameter) + ca.vertcat(
        *(at.parameter[f"torque_{axis}"] for axis in AXES)
    )
    writer = _Writer()
    if isinstance(model, MultibodyModel):
        result += _multibody_equations(model, at, F, torque, rates, writer)
    else:
        result += _acceleration_equations(model.acceleration(at, F, torque), writer)
    acceleration_without_friction = ca.vertcat(*(ca.SX.sym(rf"\ddot{{{angle}}}_{{0}}") for angle in _ANGLES))
    inertia = ca.vertcat(*(ca.SX.sym(f"J_{{{angle}}}") for angle in _ANGLES))
    flying = replace(at, thrust_N=F)
    for effect in model.effects:
        added = effect.torque_Nm(flying) + effect.friction_Nm(flying, acceleration_without_friction, inertia)
        result += _effect_terms(effect.name, added, effect.thrust_N(at, F), F, writer)
        if effect.states:
            left_sides = [rf"\dot{{{symbol(state.name)}}}" for state in effect.states]
            result += writer.equations_of(left_sides, effect.state_rates(flying))
    return result


def _symbolic_operands(model: Model) -> Operands:
    """Return states, voltages and parameters of a model as symbols with their names in LaTeX."""
    names = {q.name: ca.SX.sym(symbol(q.name)) for q in (*model.states, *model.parameters)}
    volts = ca.vertcat(ca.SX.sym("V_{f}"), ca.SX.sym("V_{b}"))
    return Operands(
        {state.name: names[state.name] for state in model.states},
        volts,
        {parameter.name: names[parameter.name] for parameter in model.parameters},
        ca.SX.sym("t"),
    )


def _thrust_equation(at: Operands) -> list[Equation]:
    """Return the thrust of rotor i above its dead zone."""
    p = at.parameter
    volts = ca.SX.sym("V_{i}")
    straight = p["thrust_gain"] * ca.fmax(volts - p["dead_zone"], 0.0)
    return _Writer().equations_of(["F_{i}"], straight)


def _multibody_equations(
    model: MultibodyModel, at: Operands, F: ca.SX, torque: ca.SX, rates: ca.SX, writer: _Writer
) -> list[Equation]:
    """Return the equations of the multibody model: Lagrange's equation, then the inertias, the potential
    energy and the generalised forces that it contains.
    """
    inertia = model.inertia_kg_m2(at)
    potential = ca.substitute(model.energy_J(at), rates, ca.SX.zeros(3))
    forces = model.thrust_torque_Nm(at, F) + torque
    entries = [(row, column) for row in range(3) for column in range(row, 3)]
    left_sides = [f"M_{{{_ANGLES[row]}{_ANGLES[column]}}}" for row, column in entries]
    left_sides += ["U", *(f"Q_{{{angle}}}" for angle in _ANGLES)]
    right_sides = ca.vertcat(*(inertia[row, column] for row, column in entries), potential, forces)
    rule = Equation(
        r"M\,\ddot{q} + \dot{M}\,\dot{q} - \frac{1}{2}\,\frac{\partial}{\partial q}"
        r"\left(\dot{q}^{T}\,M\,\dot{q}\right) + \frac{\partial U}{\partial q}",
        r"Q,\quad q = \left(\theta, \phi, \psi\right)",
    )
    return [rule, *writer.equations_of(left_sides, right_sides)]


def _acceleration_equations(acceleration: ca.SX, writer: _Writer) -> list[Equation]:
    """Write torque over inertia as inertia times acceleration; leave anything else unchanged."""
    parts = [acceleration[row] for row in range(3)]
    if not all(part.is_op(ca.OP_DIV) for part in parts):
        return writer.equations_of(_ACCELERATIONS, acceleration)
    inertias = [f"J_{{{angle}}}" for angle in _ANGLES]
    left_sides = [rf"{J}\,{rate}" for J, rate in zip(inertias, _ACCELERATIONS, strict=True)]
    return [
        *writer.equations_of(inertias, ca.vertcat(*(part.dep(1) for part in parts))),
        *writer.equations_of(left_sides, ca.vertcat(*(part.dep(0) for part in parts))),
    ]


def _effect_terms(name: str, torque: ca.SX, thrust: ca.SX, F: ca.SX, writer: _Writer) -> list[Equation]:
    """Return the torques that an effect adds, and the thrusts that it changes, as equations."""
    superscript = symbol(name)
    result = []
    for row, angle in enumerate(_ANGLES):
        if not torque[row].is_zero():
            result += writer.equations_of([rf"\Delta Q_{{{angle}}}^{{{superscript}}}"], torque[row])
    for row, rotor in enumerate("fb"):
        if not ca.is_equal(thrust[row], F[row]):
            result += writer.equations_of([rf"F_{{{rotor}}}^{{{superscript}}}"], thrust[row])
    return result


# Binding strength of an expression: an operand that binds less strongly than its operation needs parentheses.
_SUM, _SIGNED, _PRODUCT, _POWER, _ATOM = range(5)
_BoundText = tuple[str, int]
"""LaTeX of an expression, and its binding strength."""
_FUNCTIONS: Final[Mapping[int, str]] = {
    ca.OP_SIN: r"\sin",
    ca.OP_COS: r"\cos",
    ca.OP_TAN: r"\tan",
    ca.OP_ATAN: r"\arctan",
    ca.OP_TANH: r"\tanh",
    ca.OP_EXP: r"\exp",
    ca.OP_LOG: r"\ln",
}


_FUNCTION_NAMES: Final = tuple(_FUNCTIONS.values())
_HALF: Final = 0.5


class _Writer:
    """Converts expressions to LaTeX, and remembers the names of their repeated subexpressions."""

    def __init__(self) -> None:
        self._names: dict[int, str] = {}
        # The hash of a deleted expression may be reused, so all expressions are kept.
        self._kept_alive: list[ca.SX] = []
        self._repeated: set[int] = set()

    def equations_of(self, left_sides: Sequence[str], right_sides: ca.SX) -> list[Equation]:
        """Return one equation per element of `right_sides`, each after those of its named subexpressions."""
        parts = [ca.SX(right_sides[row]) for row in range(right_sides.numel())]
        self._kept_alive += parts
        self._repeated |= _repeated_parts(parts)
        result: list[Equation] = []
        for left_side, part in zip(left_sides, parts, strict=True):
            self._name_parts(part, result)
            result.append(Equation(left_side, self._latex_and_binding(part)[0]))
        return result

    def _name_parts(self, expression: ca.SX, result: list[Equation]) -> None:
        """Name the repeated subexpressions of an expression, and append their equations to `result`."""
        for child in _operands_of(expression):
            key = child.element_hash()
            if key in self._names:
                continue
            self._name_parts(child, result)
            if key in self._repeated:
                right_side = self._latex_and_binding(child)[0]
                self._names[key] = self._new_name(child)
                result.append(Equation(self._names[key], right_side))

    def _new_name(self, expression: ca.SX) -> str:
        """Return the next free name: zeta_1, zeta_2 for angles, otherwise a_1, a_2."""
        letter = r"\zeta" if expression.op() == ca.OP_ATAN else "a"
        used_count = sum(name.startswith(letter) for name in self._names.values())
        return f"{letter}_{{{used_count + 1}}}"

    def _latex_and_binding(self, expression: ca.SX) -> _BoundText:
        """Return an expression in LaTeX, and its binding strength."""
        if expression.element_hash() in self._names:
            return self._names[expression.element_hash()], _ATOM
        if expression.is_constant():
            number = float(expression)
            text = r"\frac{1}{2}" if abs(number) == _HALF else f"{abs(number):.12g}"
            return (f"-{text}", _SIGNED) if number < 0.0 else (text, _ATOM)
        if expression.is_symbolic():
            return expression.name(), _ATOM
        write = _OPERATIONS.get(expression.op())
        if write is None:
            raise PlantError(
                f"an effect uses the operation '{expression}', which has no LaTeX", "leave the effect out"
            )
        return write(self, expression)

    def operand_text(self, expression: ca.SX, min_binding: int) -> str:
        """Return an operand in LaTeX, in parentheses if it binds less strongly than required."""
        text, binding = self._latex_and_binding(expression)
        return text if binding >= min_binding else rf"\left({text}\right)"

    def sum(self, expression: ca.SX) -> _BoundText:
        """Return a sum or difference in LaTeX."""
        first, (second, binding) = (self._operand(expression, 0), self._latex_and_binding(expression.dep(1)))
        negated = expression.op() == ca.OP_SUB
        if binding == _SIGNED or (not negated and second.startswith("-")):
            negated, second = not negated, second[1:]
        elif negated and binding == _SUM:
            second = rf"\left({second}\right)"
        return f"{first} {'-' if negated else '+'} {second}", _SUM

    def product(self, expression: ca.SX) -> _BoundText:
        """Return a product in LaTeX: numbers first, then symbols, sums in parentheses, and functions."""
        negative, factors = False, []
        for factor in self._factors_of_product(expression):
            text, binding = self._latex_and_binding(factor)
            if binding == _SIGNED:
                negative, text, binding = not negative, text[1:], _PRODUCT
            if factor.is_constant():
                order = 0
            elif binding <= _SUM:
                order, text = 2, rf"\left({text}\right)"
            else:
                # A function comes last, because a factor after it would look like a part of its argument.
                order = 3 if text.startswith(_FUNCTION_NAMES) else 1
            factors.append((order, text))
        joined = r"\,".join(text for _, text in sorted(factors, key=lambda pair: pair[0]))
        return (f"-{joined}", _SIGNED) if negative else (joined, _PRODUCT)

    def _factors_of_product(self, expression: ca.SX) -> list[ca.SX]:
        """Return the factors of a product of products, in their order."""
        if (
            expression.element_hash() in self._names
            or expression.op() != ca.OP_MUL
            or expression.is_constant()
            or expression.is_symbolic()
        ):
            return [expression]
        return [*self._factors_of_product(expression.dep(0)), *self._factors_of_product(expression.dep(1))]

    def fraction(self, expression: ca.SX) -> _BoundText:
        return (rf"\frac{{{self._operand(expression, 0)}}}{{{self._operand(expression, 1)}}}", _ATOM)

    def negated(self, expression: ca.SX) -> _BoundText:
        return f"-{self.operand_text(expression.dep(0), _PRODUCT)}", _SIGNED

    def doubled(self, expression: ca.SX) -> _BoundText:
        """Return twice an expression; a minus sign comes before the 2."""
        text, binding = self._latex_and_binding(expression.dep(0))
        if binding == _SIGNED:
            return rf"-2\,{text[1:]}", _SIGNED
        return rf"2\,{self.operand_text(expression.dep(0), _PRODUCT)}", _PRODUCT

    def inverse(self, expression: ca.SX) -> _BoundText:
        return rf"\frac{{1}}{{{self._operand(expression, 0)}}}", _ATOM

    def square(self, expression: ca.SX) -> _BoundText:
        """Return a square; that of a function is written as sin^2(x)."""
        inner = expression.dep(0)
        if inner.op() in _FUNCTIONS and inner.element_hash() not in self._names:
            return f"{_FUNCTIONS[inner.op()]}^{{2}}{self._argument_latex(inner)}", _POWER
        return f"{self.operand_text(inner, _ATOM)}^{{2}}", _POWER

    def power(self, expression: ca.SX) -> _BoundText:
        return (f"{self.operand_text(expression.dep(0), _ATOM)}^{{{self._operand(expression, 1)}}}", _POWER)

    def square_root(self, expression: ca.SX) -> _BoundText:
        return rf"\sqrt{{{self._operand(expression, 0)}}}", _ATOM

    def absolute(self, expression: ca.SX) -> _BoundText:
        return rf"\left|{self._operand(expression, 0)}\right|", _ATOM

    def function(self, expression: ca.SX) -> _BoundText:
        return f"{_FUNCTIONS[expression.op()]}{self._argument_latex(expression)}", _POWER

    def extremum(self, expression: ca.SX) -> _BoundText:
        """Return a maximum or minimum of two operands."""
        name = r"\max" if expression.op() == ca.OP_FMAX else r"\min"
        return (rf"{name}\left({self._operand(expression, 0)}, {self._operand(expression, 1)}\right)", _ATOM)

    def _operand(self, expression: ca.SX, number: int) -> str:
        """Return an operand of the last operation in LaTeX, without parentheses around it."""
        return self._latex_and_binding(expression.dep(number))[0]

    def _argument_latex(self, expression: ca.SX) -> str:
        """Return the argument of a function in LaTeX, without parentheses if it is a symbol."""
        inner = expression.dep(0)
        text, binding = self._latex_and_binding(inner)
        return f" {text}" if binding == _ATOM and inner.is_symbolic() else rf"\left({text}\right)"


_OPERATIONS: Final[Mapping[int, Callable[[_Writer, ca.SX], _BoundText]]] = {
    **dict.fromkeys((ca.OP_ADD, ca.OP_SUB), _Writer.sum),
    ca.OP_MUL: _Writer.product,
    ca.OP_DIV: _Writer.fraction,
    ca.OP_NEG: _Writer.negated,
    ca.OP_TWICE: _Writer.doubled,
    ca.OP_INV: _Writer.inverse,
    ca.OP_SQ: _Writer.square,
    **dict.fromkeys((ca.OP_POW, ca.OP_CONSTPOW), _Writer.power),
    ca.OP_SQRT: _Writer.square_root,
    ca.OP_FABS: _Writer.absolute,
    **dict.fromkeys(_FUNCTIONS, _Writer.function),
    **dict.fromkeys((ca.OP_FMAX, ca.OP_FMIN), _Writer.extremum),
}


def _operands_of(expression: ca.SX) -> list[ca.SX]:
    """Return the operands of the last operation in an expression; none of a constant or a symbol."""
    if expression.is_constant() or expression.is_symbolic():
        return []
    return [expression.dep(i) for i in range(expression.n_dep())]


def _repeated_parts(roots: Iterable[ca.SX]) -> set[int]:
    """Return the hashes of subexpressions that occur more than once and are large enough for a name."""
    occurrences = Counter[int]()
    operation_counts: dict[int, int] = {}
    large: set[int] = set()

    def visit(expression: ca.SX) -> int:
        """Count each occurrence of an expression and of its parts, and return its number of operations."""
        key = expression.element_hash()
        occurrences[key] += 1
        if key not in operation_counts:
            operands = _operands_of(expression)
            operation_counts[key] = (1 if operands else 0) + sum(map(visit, operands))
            # The part behind a sign or a factor of 2 gets the name.
            if operation_counts[key] >= _MIN_OPERATIONS and expression.op() not in (ca.OP_NEG, ca.OP_TWICE):
                large.add(key)
        return operation_counts[key]

    for root in roots:
        visit(root)
    return {key for key in large if occurrences[key] > 1}
