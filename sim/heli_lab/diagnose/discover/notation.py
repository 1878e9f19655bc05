"""Notations of an equation: SymPy, LaTeX, and an effect file in Python for the simulator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from heli_sim.model.parts import AXES
from heli_sim.rig.quantity import Prior

from heli_lab.diagnose.discover.equation import (
    CHANNELS,
    Equation,
    EquationEffect,
    EquationTerm,
    memory_name,
    rotor_signs,
)
from heli_lab.diagnose.discover.terms import SYMBOLS, Factor

_CHANNEL_LATEX: Final = {
    **{f"torque.{a}": rf"\tau_{s}" for a, s in zip(AXES, (r"\theta", r"\phi", r"\psi"), strict=True)},
    **{f"measurement.{a}": rf"\Delta {s}" for a, s in zip(AXES, (r"\theta", r"\phi", r"\psi"), strict=True)},
    "thrust.both": r"\Delta F",
    "thrust.difference": r"\Delta F_f = -\Delta F_b",
    "thrust.front": r"\Delta F_f",
    "thrust.back": r"\Delta F_b",
    "voltage.both": r"\Delta V",
}
_ACTS_ON: Final = {"thrust": "thrust", "voltage": "input"}


def expression(equation: Equation, channel: str, numbers: Mapping[str, float] | None = None) -> str:
    """Write the terms of an `equation` on a `channel` for SymPy, with names of parameters, or with their
    values if `numbers` gives these by name.
    """
    return _sum(equation, channel, "sympy", {n: _digits(v) for n, v in numbers.items()} if numbers else None)


def latex(equation: Equation, numbers: Mapping[str, float] | None = None) -> str:
    """Write an `equation` in LaTeX, one part per channel, with symbols of parameters, or with their values if
    `numbers` gives these by name.
    """
    if numbers is not None:
        texts = {name: _latex_number(value) for name, value in numbers.items()}
    else:
        texts = {name: _latex_name(name) for name in _names(equation)}
    parts = [
        f"{_CHANNEL_LATEX[channel]} = {_sum(equation, channel, 'latex', texts)}"
        for channel in equation.channels
    ]
    return r",\quad ".join(parts)


def _sum(equation: Equation, channel: str, notation: str, texts: Mapping[str, str] | None) -> str:
    """The terms of an equation on one `channel` as a sum, in a `notation`; `texts` are the texts of its
    parameters, by default their names.
    """
    texts = texts or {name: name for name in _names(equation)}
    times = {"sympy": "*", "latex": r"\,"}[notation]
    parts = []
    for i, term in enumerate(equation.terms):
        if term.channel != channel:
            continue
        factors = [
            factor.written(
                notation, {inner_name: texts[name] for inner_name, name in equation.numbers_of(i, j).items()}
            )
            for j, factor in enumerate(term.term.factors)
        ]
        parts.append(times.join((texts[equation.coefficient(i)], *factors)))
    return " + ".join(parts).replace("+ -", "- ")


def _names(equation: Equation) -> list[str]:
    return [*equation.coefficients, *(name for _, _, _, name, _, _ in equation.inner())]


def _digits(value: float) -> str:
    return f"{value:.5g}"


def _latex_number(value: float) -> str:
    text = f"{value:.3g}"
    if "e" in text:
        mantissa, _, power = text.partition("e")
        return rf"{mantissa} \cdot 10^{{{int(power)}}}"
    return text


def _latex_name(name: str) -> str:
    head = name.partition("_")[0]
    letters = head.rstrip("0123456789abc") or head[0]
    symbol = {"lag": "T", "place": "x", "width": "w", "slack": "s"}.get(letters, letters)
    return f"{symbol}_{{{head[len(letters) :]}}}"


def sentence(equation: Equation, numbers: Mapping[str, float]) -> str:
    """Write an `equation` with units, such as ``torque.pitch = 0.05*elevation N m``; `numbers` are the
    values of its parameters by name.
    """
    return " and ".join(
        f"{channel} = {expression(equation, channel, numbers)} {CHANNELS[channel][0]}"
        for channel in equation.channels
    )


def effect_file(effect: EquationEffect, numbers: Mapping[str, tuple[float, float, str]], head: str) -> str:
    """Write an equation as an effect file for `heli-host fly`.

    Parameters
    ----------
    effect : EquationEffect
        The refitted equation with the priors of its parameters.
    numbers : Mapping[str, (float, float, str)]
        Value, standard error and unit of each parameter, by name without prefix.
    head : str
        Docstring of the file: where the equation comes from.
    """
    equation = effect.equation
    values = {name: value for name, (value, _, _) in numbers.items()}
    formula = sentence(equation, values)
    body = [*_methods(equation)]
    states = "".join(
        f'        Quantity("{state.name.removeprefix(effect.prefix + "_")}", "{state.unit}", '
        '"a copy behind a first-order lag"),\n'
        for state in effect.states
    )
    stage = effect.stage.name
    acts_on = _ACTS_ON.get(equation.channels[0].partition(".")[0], equation.channels[0])
    parameters = "".join(
        _parameter(
            name, *numbers[name], effect.priors.get(f"{effect.prefix}_{name}"), name in equation.coefficients
        )
        for name in _names(equation)
    )
    quantity = ", Quantity" if states else ""
    docstring = "\n".join(line.replace("\\", "").replace('"""', "'") for line in head.splitlines())
    return f'''"""{docstring}

{formula}
"""

import casadi as ca
from heli_sim.model import Effect, Stage
from heli_sim.model.effects import EffectSpec, Parameter
from heli_sim.rig import Prior{quantity}
from typing_extensions import override


class ProposedTerm(Effect):
    """{formula}"""
{"".join(body)}

PROPOSED_TERM = EffectSpec(
    id="{effect.name}",
    effect=ProposedTerm,
    sentence="{_sentence(equation)}",
    equation=r"{latex(equation)}",
    acts_on="{acts_on}",
    stage=Stage.{stage},
    linearisable=True,
    numbers=(
{parameters}    ),
{f"    states=({chr(10)}{states}    ),{chr(10)}" if states else ""})
'''


def _sentence(equation: Equation) -> str:
    """Sentence of the effect, with its parameters in braces as `EffectSpec` expects them."""
    parts = []
    for channel in equation.channels:
        texts = {name: f"[{{{name}}}]" for name in _names(equation)}
        parts.append(f"{channel} = {_sum(equation, channel, 'sympy', texts)}")
    return " and ".join(parts)


def _parameter(name: str, value: float, std: float, unit: str, prior: Prior | None, size: bool) -> str:
    """Source text of a parameter in an effect file."""
    source = f"{value:.4g} ± {std:.2g} {unit}" if std else "set"
    known = ""
    if prior is not None:
        bounds = "" if size else f", {prior.low:.6g}, {prior.high:.6g}"
        known = f"\n            prior=Prior({0.0 if size else value:.6g}, {prior.std:.6g}{bounds}),"
    return f'''        Parameter(
            "{name}",
            "{unit}",
            "found: {source}",
            typical={value:.8g},{known}
            size={size},
        ),
'''


def _methods(equation: Equation) -> Iterator[str]:
    """Yield the source text of the methods of an effect file, one per kind of channel, and the rates of its
    lags.
    """
    kinds = {channel.partition(".")[0] for channel in equation.channels}
    if "torque" in kinds:
        lines = [
            _plus(equation, f"torque.{axis}") if f"torque.{axis}" in equation.channels else "0"
            for axis in AXES
        ]
        yield _method("torque_Nm", "", equation, "torque", f"ca.vertcat({', '.join(lines)})")
    for kind, name, before in (("thrust", "thrust_N", "thrust_N"), ("voltage", "voltage_V", "volts_V")):
        if kind in kinds:
            parts = [
                f"ca.DM({list(rotor_signs(channel))}) * ({_plus(equation, channel)})"
                for channel in equation.channels
                if channel.startswith(kind)
            ]
            yield _method(name, before, equation, kind, " + ".join((before, *parts)))
    if "measurement" in kinds:
        lines = [
            _plus(equation, f"measurement.{axis}") if f"measurement.{axis}" in equation.channels else "0"
            for axis in AXES
        ]
        value = f"angles_rad + ca.vertcat({', '.join(lines)})"
        yield _method("measured_rad", "angles_rad", equation, "measurement", value)
    rates = [
        f"({SYMBOLS[factor.quantity].python} - {_memory(i, j, factor)})"
        f' / self.own(at, "{equation.numbers_of(i, j)["s"]}")'
        for i, term in enumerate(equation.terms)
        for j, factor in enumerate(term.term.factors)
        if factor.memory
    ]
    if rates:
        value = f"ca.vertcat({', '.join(rates)})"
        yield f"\n    @override\n    def state_rates(self, at):\n        return {value}\n"


def _method(name: str, argument: str, equation: Equation, kind: str, value: str) -> str:
    """Source text of one method, which returns `value`: an expression of the terms on a `kind` of channel."""
    lines = []
    for i, term in enumerate(equation.terms):
        if term.channel.startswith(kind):
            lines.append(f"        term_{i + 1} = {_python(equation, i, term)}\n")
    arguments = f", {argument}" if argument else ""
    return f"\n    @override\n    def {name}(self, at{arguments}):\n{''.join(lines)}        return {value}\n"


def _plus(equation: Equation, channel: str) -> str:
    return " + ".join(f"term_{i + 1}" for i, term in enumerate(equation.terms) if term.channel == channel)


def _python(equation: Equation, i: int, term: EquationTerm) -> str:
    """Python expression of term number `i` of an equation."""
    parts = [f'self.own(at, "{equation.coefficient(i)}")']
    for j, factor in enumerate(term.term.factors):
        texts = {
            inner_name: f'self.own(at, "{name}")' for inner_name, name in equation.numbers_of(i, j).items()
        }
        x = None
        if factor.memory:
            x = _memory(i, j, factor)
            if factor.memory == "washout":
                x = f"({x} - {SYMBOLS[factor.quantity].python})"
        parts.append(factor.written("python", texts, x))
    return " * ".join(parts)


def _memory(i: int, j: int, factor: Factor) -> str:
    name = memory_name(i, j)
    if not factor.each:
        return f'self.own(at, "{name}")'
    return f'ca.vertcat(self.own(at, "{name}_front"), self.own(at, "{name}_back"))'
