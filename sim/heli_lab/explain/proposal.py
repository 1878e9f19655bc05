"""A proposed equation: notations, parameters and confidence, and where in the flights it matters."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES
from heli_sim.rig.schema import Prior

from heli_lab.explain.candidates import channel_kind
from heli_lab.explain.contributions import accelerations
from heli_lab.explain.regression import Discovery
from heli_lab.explain.screening import Screening
from heli_lab.explain.term_scores import TermSignals
from heli_lab.explain.terms import (
    CHANNELS,
    SYMBOLS,
    Equation,
    EquationEffect,
    EquationTerm,
    Factor,
    lag_state_name,
    rotor_signs,
)
from heli_lab.explain.thresholds import (
    CONFIDENCE_NATS,
    EQUATION_MAX_UNCONFIRMED,
    EQUATION_SUPPORT_SHARE,
    HELD_OUT_NATS,
    MAX_CONFIDENCE,
)
from heli_lab.fit.innovations import smoothed_disturbances

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
    """Write the terms of an `equation` on a `channel` for SymPy."""
    # Parameters have their names, or their values if `numbers` gives these by name.
    texts = {name: f"{value:.5g}" for name, value in numbers.items()} if numbers else None
    return _channel_sum(equation, channel, "sympy", texts)


def latex(equation: Equation, numbers: Mapping[str, float] | None = None) -> str:
    """Write an `equation` in LaTeX, one part per channel."""
    # Parameters have symbols, or their values if `numbers` gives these by name.
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
    """Write the sum of the terms on a channel in a notation, ``sympy`` or ``latex``."""
    # `texts` has a text for each parameter, by name; by default that name.
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
        products.append(times_sign.join((texts[equation.coefficient_name(i)], *factors)))
    return " + ".join(products).replace("+ -", "- ")


def _parameter_names(equation: Equation) -> list[str]:
    """Return the names of all coefficients, then those of all inner parameters."""
    return [*equation.coefficient_names, *(inner.name for inner in equation.inner_parameters())]


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
    """Write an `equation` with units, such as ``torque.pitch = 0.05*elevation N m``."""
    # `numbers` has the values of its parameters by name.
    return " and ".join(
        f"{channel} = {expression(equation, channel, numbers)} {CHANNELS[channel].unit}"
        for channel in equation.channels
    )


def effect_file(effect: EquationEffect, numbers: Mapping[str, tuple[float, float, str]], head: str) -> str:
    """Write an equation as an effect file for `heli-host fly`."""
    # `numbers`: Value, standard error and unit of each parameter.
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
    first_channel = equation.channels[0]
    acts_on = _ACTS_ON.get(channel_kind(first_channel), first_channel)
    parameters = "".join(
        _parameter_code(
            name,
            *numbers[name],
            effect.priors.get(f"{effect.prefix}_{name}"),
            is_coefficient=name in equation.coefficient_names,
        )
        for name in _parameter_names(equation)
    )
    quantity_import = ", Quantity" if states else ""
    # A backslash would escape what follows it, and three quotes would end the docstring.
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
    """Return the Python code that declares a parameter of the effect with its estimate and prior."""
    # A coefficient is a size of the effect: its prior has the mean 0 and no bounds.
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
    """Yield the Python code of the methods of the effect, by the kinds of its channels."""
    kinds = set(map(channel_kind, equation.channels))

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
    factors = [f'self.value(at, "{equation.coefficient_name(i)}")']
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
    """Return the Python code of the lag state of factor `j` of term `i`."""
    name = lag_state_name(i, j)
    if not factor.per_rotor:
        return f'self.value(at, "{name}")'
    return f'ca.vertcat(self.value(at, "{name}_front"), self.value(at, "{name}_back"))'


@dataclass(frozen=True)
class SupportedRange:
    """Part of the fitted flights in which an equation matters on one channel."""

    channel: str  # Channel on which it acts
    rms: float
    """rms, largest: Root mean square and largest value of its terms less their mean, in the channel's unit.
    """
    largest: float
    ranges: Mapping[str, tuple[float, float]]
    """Range of each quantity of the equation in which the terms are at least half of their largest value: 5 %
    and 95 % quantiles over time, SI units."""
    share: float  # Share of the flight time in which the terms are that large, 0 to 1


@dataclass(frozen=True)
class TermTrace:
    """Torque of an equation along a flight, and the torque that the model without it lacks."""

    label: str  # label, axis: Name of the flight, and axis about which the equation acts most
    axis: str
    t_s: Floats  # (n,): Times since the first sample of the flight
    term_Nm: Floats
    """term_Nm, missing_Nm, std_Nm: (n,): Torque of the equation; smoothed torque that the model without it
    lacks, and its standard error; both torques less their means."""
    missing_Nm: Floats
    std_Nm: Floats
    on: str  # on, unit: First quantity that the equation depends on, and its unit
    unit: str
    value: Floats  # (n,): Values of the quantity


@dataclass(frozen=True)
class ProposedTerm:
    """An equation proposed for what no effect of the catalogue explains."""

    discovery: Discovery  # The equation, its evidence and its rivals
    supported: tuple[SupportedRange, ...]  # Where in the fitted flights it matters, by channel
    trace: TermTrace
    """The equation along the first held-out flight, or along the first fitted flight if none is held out."""

    @property
    def equation(self) -> Equation:
        """The terms."""
        return self.discovery.equation

    @property
    def numbers(self) -> dict[str, float]:
        """Values of the parameters, by name without prefix."""
        return {name: parameter.value for name, parameter in self.discovery.values.items()}

    @property
    def confidence(self) -> float:
        """Probability, 0 to 1, that the form of the equation is right."""
        # It grows with the lead over the closest rival, which may be the model without an equation, and with
        # the log-likelihood ratio on the held-out flights.
        discovery = self.discovery
        lead_over_no_equation = discovery.train_nats - discovery.penalty
        leads = [rival.log_likelihood_ratio for rival in discovery.rivals]
        margin = max(min([lead_over_no_equation, *leads]), 0.0)
        # Without a lead, the equation and its closest rival are equally likely.
        probability = 1.0 - 0.5 * math.exp(-margin / CONFIDENCE_NATS)
        if discovery.held_out_nats is None:
            return min(EQUATION_MAX_UNCONFIRMED, probability)
        # Logistic function: 0 nats on flights that had no part in the choice mean even odds.
        probability /= 1.0 + math.exp(-discovery.held_out_nats / HELD_OUT_NATS)
        return float(min(MAX_CONFIDENCE, probability))

    def effect_file(self, head: str) -> str:
        """Write the equation as an effect file; `head` is its docstring."""
        return effect_file(self.discovery.effect, self.discovery.values, head)

    @property
    def sentence(self) -> str:
        """The equation with values and units, such as ``torque.pitch = 0.05*elevation N m``."""
        return sentence(self.equation, self.numbers)


def proposed_term(discovery: Discovery) -> ProposedTerm:
    """Propose the equation of a `discovery`: evaluate it along the flights."""
    return ProposedTerm(discovery, supported_ranges(discovery), term_trace(discovery))


def term_trace(discovery: Discovery) -> TermTrace:
    """Compare, along a flight, the torque of the equation of a `discovery` with the missing torque."""
    # The missing torque is the one that the model without the equation lacks. Both are about the axis on
    # which the equation acts most. The flight is the first held-out flight, or the first fitted flight
    # without one.
    without_equation, with_equation = discovery.elsewhere or (
        discovery.base.estimate,
        discovery.hypothesis.estimate,
    )
    step_s, change_rad_s2 = accelerations(with_equation, discovery.effect.name)
    signals = TermSignals(Screening(with_equation))
    torque_Nm = signals.linearised_flights[0].disturbance_for(change_rad_s2)
    axis = int(np.argmax(torque_Nm.std(axis=0)))
    # The smoother has one row per measurement of the filter, the equation one per step.
    missing = smoothed_disturbances(without_equation.filtered(), without_equation.disturbances)[0]
    t_s = missing.t_s
    term_Nm = np.interp(t_s, step_s, torque_Nm[:, axis])
    # The torque is also drawn over a quantity that the first term depends on.
    quantity = discovery.equation.terms[0].term.quantities[-1]
    return TermTrace(
        label=with_equation.references[0].record.label,
        axis=AXES[axis],
        t_s=t_s,
        term_Nm=term_Nm - term_Nm.mean(),
        missing_Nm=missing.values[:, axis] - missing.values[:, axis].mean(),
        std_Nm=missing.std[:, axis],
        on=quantity,
        unit=str(SYMBOLS[quantity].unit),
        value=np.interp(t_s, step_s, _rotor_mean(signals.quantity(index=0, name=quantity))),
    )


def supported_ranges(discovery: Discovery) -> tuple[SupportedRange, ...]:
    """Find where in the fitted flights the equation of a `discovery` matters, by channel."""
    signals = TermSignals(Screening(discovery.hypothesis.estimate))
    flights = range(len(signals.linearised_flights))
    result = []
    for channel in discovery.equation.channels:
        magnitude = np.concatenate(
            [np.abs(_channel_sum_along(discovery, signals, i, channel)).max(axis=1) for i in flights]
        )
        largest = float(np.quantile(magnitude, 0.99))
        is_active = magnitude >= EQUATION_SUPPORT_SHARE * largest
        channel_terms = [term.term for term in discovery.equation.terms if term.channel == channel]
        names = dict.fromkeys(name for term in channel_terms for name in term.quantities)
        ranges = {}
        for name in names:
            values = np.concatenate([_rotor_mean(signals.quantity(i, name)) for i in flights])
            low, high = np.quantile(values[is_active], [0.05, 0.95])
            ranges[name] = (float(low), float(high))
        rms = float(np.sqrt(np.mean(magnitude**2)))
        result.append(
            SupportedRange(channel, rms, largest=largest, ranges=ranges, share=float(is_active.mean()))
        )
    return tuple(result)


def _rotor_mean(values: Floats) -> Floats:
    """Return values of a quantity, shape (n,); if each rotor has its own, (n, 2), their mean."""
    return values if values.ndim == 1 else np.asarray(values.mean(axis=1))


def _channel_sum_along(discovery: Discovery, signals: TermSignals, index: int, channel: str) -> Floats:
    """Return the sum of the terms on a channel along a flight, less its mean."""
    # The shape is (n, 1), or (n, 2) if each rotor has its own values.
    total: Floats = np.zeros((1, 1))
    values = discovery.values
    for i, term in enumerate(discovery.equation.terms):
        if term.channel == channel:
            signal = signals.values(index, discovery.with_estimated_parameters(i))
            total = total + values[discovery.equation.coefficient_name(i)].value * signal
    return np.asarray(total - total.mean(axis=0), float)
