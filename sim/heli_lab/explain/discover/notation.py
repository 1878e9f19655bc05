"""Notations of an equation: SymPy, LaTeX, and an effect file in Python for the simulator."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from heli_sim.model.parts import AXES
from heli_sim.rig.quantity import Prior

from heli_lab.explain.discover.equation import (
    CHANNELS,
    Equation,
    EquationEffect,
    EquationTerm,
    lag_state_name,
    rotor_signs,
)
from heli_lab.explain.discover.terms import SYMBOLS, Factor

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
    """Write the terms of an `equation` on a `channel` for SymPy.

    Parameters have their names, or their values if `numbers` gives these by name.
    """
    texts = {name: f"{value:.5g}" for name, value in numbers.items()} if numbers else None
    return _channel_sum(equation, channel, "sympy", texts)


def latex(equation: Equation, numbers: Mapping[str, float] | None = None) -> str:
    """Write an `equation` in LaTeX, one part per channel.

    Parameters have symbols, or their values if `numbers` gives these by name.
    """
    if numbers is not None:
        texts = {name: _number_latex(value) for name, value in numbers.items()}
    else:
        texts = {name: _parameter_latex(name) for name in _parameter_names(equation)}
    parts = [
        f"{_CHANNEL_LATEX[channel]} = {_channel_sum(equation, channel, 'latex', texts)}"
        for channel in equation.channels
    ]
    return r",\quad ".join(parts)


def _channel_sum(equation: Equation, channel: str, notation: str, texts: Mapping[str, str] | None) -> str:
    """Write the sum of the terms on a channel in a notation, ``sympy`` or ``latex``.

    `texts` has a text for each parameter, by name; by default that name.
    """
    texts = texts or {name: name for name in _parameter_names(equation)}
    times_sign = {"sympy": "*", "latex": r"\,"}[notation]
    products = []
    for i, term in enumerate(equation.terms):
        if term.channel != channel:
            continue
        factors = []
        for j, factor in enumerate(term.term.factors):
            symbols = {inner: texts[name] for inner, name in equation.inner_names(i, j).items()}
            factors.append(factor.formatted(notation, symbols))
        products.append(times_sign.join((texts[equation.coefficient(i)], *factors)))
    return " + ".join(products).replace("+ -", "- ")


def _parameter_names(equation: Equation) -> list[str]:
    """Return the names of all coefficients, then those of all inner parameters."""
    return [*equation.coefficients, *(inner.name for inner in equation.inner_parameters())]


def _number_latex(value: float) -> str:
    """Write a value in LaTeX with three significant digits."""
    text = f"{value:.3g}"
    if "e" in text:
        mantissa, _, power = text.partition("e")
        return rf"{mantissa} \cdot 10^{{{int(power)}}}"
    return text


def _parameter_latex(name: str) -> str:
    """Return the symbol of a parameter in LaTeX, such as ``T_{1b}`` for ``lag1b_s``."""
    head = name.partition("_")[0]
    letters = head.rstrip("0123456789abc") or head[0]
    symbol = {"lag": "T", "place": "x", "width": "w", "slack": "s"}.get(letters, letters)
    return f"{symbol}_{{{head[len(letters) :]}}}"


def sentence(equation: Equation, numbers: Mapping[str, float]) -> str:
    """Write an `equation` with units, such as ``torque.pitch = 0.05*elevation N m``.

    `numbers` has the values of its parameters by name.
    """
    return " and ".join(
        f"{channel} = {expression(equation, channel, numbers)} {CHANNELS[channel][0]}"
        for channel in equation.channels
    )


def effect_file(effect: EquationEffect, numbers: Mapping[str, tuple[float, float, str]], head: str) -> str:
    """Write an equation as an effect file for `heli-host fly`."""
    equation = effect.equation
    values = {name: value for name, (value, _, _) in numbers.items()}
    formula = sentence(equation, values)
    methods = list(_methods_code(equation))
    states = "".join(
        f'        Quantity("{state.name.removeprefix(effect.prefix + "_")}", "{state.unit}", '
        '"a copy behind a first-order lag"),\n'
        for state in effect.states
    )
    stage = effect.stage.name
    acts_on = _ACTS_ON.get(equation.channels[0].partition(".")[0], equation.channels[0])
    parameters = "".join(
        _parameter_code(
            name,
            *numbers[name],
            effect.priors.get(f"{effect.prefix}_{name}"),
            is_coefficient=name in equation.coefficients,
        )
        for name in _parameter_names(equation)
    )
    quantity_import = ", Quantity" if states else ""
    docstring = "\n".join(line.replace("\\", "").replace('"""', "'") for line in head.splitlines())
    return f'''"""{docstring}

{formula}
"""

import casadi as ca
from heli_sim.model import Effect, Stage
from heli_sim.model.effects import EffectSpec, Parameter
from heli_sim.rig import Prior{quantity_import}
from typing_extensions import override


class ProposedTerm(Effect):
    """{formula}"""
{"".join(methods)}

PROPOSED_TERM = EffectSpec(
    id="{effect.name}",
    effect=ProposedTerm,
    sentence="{_sentence_template(equation)}",
    equation=r"{latex(equation)}",
    acts_on="{acts_on}",
    stage=Stage.{stage},
    linearisable=True,
    numbers=(
{parameters}    ),
{f"    states=({chr(10)}{states}    ),{chr(10)}" if states else ""})
'''


def _sentence_template(equation: Equation) -> str:
    """Return the sentence of the effect with its parameters in braces, as `EffectSpec` expects them."""
    texts = {name: f"[{{{name}}}]" for name in _parameter_names(equation)}
    return " and ".join(
        f"{channel} = {_channel_sum(equation, channel, 'sympy', texts)}" for channel in equation.channels
    )


def _parameter_code(
    name: str, value: float, std: float, unit: str, prior: Prior | None, *, is_coefficient: bool
) -> str:
    """Return the Python code that declares a parameter of the effect with its estimate and prior.

    A coefficient is a size of the effect: its prior has the mean 0 and no bounds.
    """
    estimate_text = f"{value:.4g} ± {std:.2g} {unit}" if std else "set"
    prior_code = ""
    if prior is not None:
        mean = 0.0 if is_coefficient else value
        bounds = "" if is_coefficient else f", {prior.low:.6g}, {prior.high:.6g}"
        prior_code = f"\n            prior=Prior({mean:.6g}, {prior.std:.6g}{bounds}),"
    return f'''        Parameter(
            "{name}",
            "{unit}",
            "found: {estimate_text}",
            typical={value:.8g},{prior_code}
            size={is_coefficient},
        ),
'''


def _methods_code(equation: Equation) -> Iterator[str]:
    """Yield the Python code of the methods of the effect, by the kinds of its channels.

    A channel is a kind and an axis or a rotor, such as ``torque.pitch``; each kind is a method of `Effect`.
    """
    kinds = {channel.partition(".")[0] for channel in equation.channels}

    def by_axis(kind: str) -> str:
        """Return the code of a column with the terms about each axis."""
        channels = [f"{kind}.{axis}" for axis in AXES]
        sums = [_sum_code(equation, name) if name in equation.channels else "0" for name in channels]
        return f"ca.vertcat({', '.join(sums)})"

    if "torque" in kinds:
        yield _method_code("torque_Nm", "", equation, "torque", by_axis("torque"))
    for kind, method, argument in (("thrust", "thrust_N", "thrust_N"), ("voltage", "voltage_V", "volts_V")):
        if kind in kinds:
            increments = [
                f"ca.DM({list(rotor_signs(channel))}) * ({_sum_code(equation, channel)})"
                for channel in equation.channels
                if channel.startswith(kind)
            ]
            yield _method_code(method, argument, equation, kind, " + ".join((argument, *increments)))
    if "measurement" in kinds:
        value = f"angles_rad + {by_axis('measurement')}"
        yield _method_code("measured_rad", "angles_rad", equation, "measurement", value)
    # A lagged factor has a state that follows its quantity with the time constant "s".
    rates = [
        f"({SYMBOLS[factor.quantity].python} - {_lag_state_code(i, j, factor)})"
        f' / self.value(at, "{equation.inner_names(i, j)["s"]}")'
        for i, j, factor in equation.lagged_factors
    ]
    if rates:
        value = f"ca.vertcat({', '.join(rates)})"
        yield f"\n    @override\n    def state_rates(self, at):\n        return {value}\n"


def _method_code(name: str, argument: str, equation: Equation, kind: str, value: str) -> str:
    """Return the Python code of a method that computes the terms of a kind of channel and returns `value`."""
    lines = [
        f"        term_{i + 1} = {_term_code(equation, i, term)}\n"
        for i, term in enumerate(equation.terms)
        if term.channel.startswith(kind)
    ]
    argument_code = f", {argument}" if argument else ""
    return (
        f"\n    @override\n    def {name}(self, at{argument_code}):\n{''.join(lines)}        return {value}\n"
    )


def _sum_code(equation: Equation, channel: str) -> str:
    """Return the Python code of the sum of the terms on a channel."""
    return " + ".join(f"term_{i + 1}" for i, term in enumerate(equation.terms) if term.channel == channel)


def _term_code(equation: Equation, i: int, term: EquationTerm) -> str:
    """Return the Python code of term `i`: the product of its coefficient and factors."""
    factors = [f'self.value(at, "{equation.coefficient(i)}")']
    for j, factor in enumerate(term.term.factors):
        texts = {
            inner_name: f'self.value(at, "{name}")' for inner_name, name in equation.inner_names(i, j).items()
        }
        x = None
        if factor.lag_filter:
            x = _lag_state_code(i, j, factor)
            if factor.lag_filter == "washout":
                x = f"({x} - {SYMBOLS[factor.quantity].python})"
        factors.append(factor.formatted("python", texts, x))
    return " * ".join(factors)


def _lag_state_code(i: int, j: int, factor: Factor) -> str:
    """Return the Python code of the lag state of factor `j` of term `i`.

    The code has two states, one per rotor, if the quantity has two values.
    """
    name = lag_state_name(i, j)
    if not factor.per_rotor:
        return f'self.value(at, "{name}")'
    return f'ca.vertcat(self.value(at, "{name}_front"), self.value(at, "{name}_back"))'
