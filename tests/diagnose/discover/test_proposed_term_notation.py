"""Terms of a proposed law are the same in all their notations, and their units fit together."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from heli_lab.explain.proposal import effect_file, expression
from heli_lab.explain.term_scores import count_by_complexity, groups
from heli_lab.explain.terms import (
    FORMS,
    NAME,
    SYMBOLS,
    Equation,
    EquationTerm,
    Factor,
    Term,
    Unit,
    equation_effect,
    rotor_signs,
)
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import RotorLag, catalogue
from heli_sim.rig import load_rig
from hypothesis import given
from hypothesis import strategies as st

SPANS = dict.fromkeys(SYMBOLS, (-1.0, 1.2))
ALL_GROUPS = groups(SPANS)
FIRST_OF_FORM = {
    factor.form: group
    for group in reversed(ALL_GROUPS)
    for term in group.terms
    for factor in term.term.factors
}
# A sample of the grammar: every 97th group, one with each function, and those with a lag.
SAMPLE = (
    *ALL_GROUPS[::97],
    *FIRST_OF_FORM.values(),
    *(group for group in ALL_GROUPS if any(f.lag_filter for term in group.terms for f in term.term.factors)),
)[:76]


def state_of(size: int, seed: int) -> list[float]:
    """Return random states."""
    return list(np.random.default_rng(seed).uniform(-0.6, 0.6, size))


def test_no_product_is_tried_twice() -> None:
    products = [(term.channel, frozenset(term.term.factors)) for group in ALL_GROUPS for term in group.terms]
    assert [product for product, count in Counter(products).items() if count > 1] == []


@given(st.tuples(*(st.integers(-3, 3) for _ in range(5))))
def test_a_unit_is_read_back_as_it_was_written(exponents: tuple[int, ...]) -> None:
    unit = Unit(exponents)
    assert Unit.parse(str(unit)) == unit


@pytest.mark.parametrize(
    ("channel", "factors", "unit"),
    [
        ("torque.pitch", (Factor("linear", "elevation"),), "N m/rad"),
        ("torque.travel", (Factor("signed_square", "travel_rate"),), "N m s2/rad2"),
        ("torque.elevation", (Factor("sin", "travel", (("k", 2.0),)),), "N m"),
        ("thrust.both", (Factor("linear", "own_thrust"), Factor("linear", "travel_rate")), "s/rad"),
        ("thrust.front", (Factor("linear", "own_thrust"),), "1"),
        ("measurement.pitch", (Factor("square", "travel"),), "1/rad"),
    ],
)
def test_unit_of_coefficient_times_term_is_the_unit_of_the_channel(
    channel: str, factors: tuple[Factor, ...], unit: str
) -> None:
    assert str(EquationTerm(channel, Term(factors)).coefficient_unit) == unit


@pytest.mark.parametrize("quantity", ["travel_rate", "thrust", "own_voltage", "time"])
def test_sine_of_a_quantity_that_is_not_an_angle_is_refused(quantity: str) -> None:
    with pytest.raises(ValueError, match="sin of"):
        Factor("sin", quantity, (("k", 1.0),))


def test_every_function_is_tried() -> None:
    assert FIRST_OF_FORM.keys() == FORMS.keys()


def test_grammar_has_thousands_of_distinct_terms_on_all_channels() -> None:
    keys = [group.key for group in ALL_GROUPS]
    assert len(keys) == len(set(keys)) > 2000
    assert {group.terms[0].channel.partition(".")[0] for group in ALL_GROUPS} == {
        "torque",
        "thrust",
        "voltage",
        "measurement",
    }
    counts = count_by_complexity(ALL_GROUPS)
    assert list(counts.values()) == sorted(counts.values())
    assert max(counts.values()) == len(ALL_GROUPS)
    assert all(len(group.terms) <= 2 and len(group.terms[0].term.factors) <= 3 for group in ALL_GROUPS)


@pytest.mark.medium
def test_sympy_text_of_a_term_has_the_values_along_a_flight() -> None:
    import sympy

    numbers = np.random.default_rng(1).uniform(0.2, 1.0, len(SYMBOLS))
    values = dict(zip(SYMBOLS, numbers, strict=True))
    for group in SAMPLE:
        equation = Equation(group.terms)
        parameters = dict.fromkeys(equation.coefficients, 0.7) | {
            inner.name: inner.value for inner in equation.inner_parameters()
        }
        channel = equation.channels[0]
        names = {name: sympy.Symbol(name) for name in (*values, *parameters)}
        # All quantities are constant: their lagged values are equal to them.
        local = {**names, "lag": lambda x, _s: x, "washout": lambda _x, _s: sympy.Integer(0)}
        read = sympy.sympify(expression(equation, channel), locals=local).subs({**values, **parameters})
        expected = 0.0
        for term in equation.terms:
            value = 0.7
            for factor in term.term.factors:
                filtered = 0.0 if factor.lag_filter == "washout" else values[factor.quantity]
                value *= float(factor.value(np, filtered))
            expected += value
        assert float(read) == pytest.approx(expected, rel=1e-9, abs=1e-12), group.key


@pytest.mark.medium
@pytest.mark.parametrize("number", range(0, len(SAMPLE), 6))
def test_written_effect_file_has_the_fitted_equation(number: int, tmp_path: Path) -> None:
    # An equation of two groups on different channels, together with a lag of the rotors.
    first, second = SAMPLE[number], SAMPLE[-1 - number]
    equation = Equation(tuple(dict.fromkeys((*first.terms, *second.terms))))
    effect = equation_effect(equation, dict.fromkeys(equation.coefficients, 1.0))
    values = {**effect.values}
    for i, name in enumerate(equation.coefficients):
        values[f"{NAME}_{name}"] = 0.1 + 0.03 * i
    numbers = {
        q.name.removeprefix(f"{NAME}_"): (values[q.name], 0.01 if q.name in effect.priors else 0.0, q.unit)
        for q in effect.parameters
    }
    path = tmp_path / "proposed.py"
    path.write_text(effect_file(effect, numbers, "From a test."), encoding="utf-8")
    kind = catalogue((path,))[NAME]
    lag = catalogue()["rotor_lag"]
    results = []
    for variant in (effect, kind.make(kind.typical)):
        model = MultibodyModel((variant, lag.make(lag.typical)))
        rig = load_rig("makki2024")
        p = [values.get(q.name, rig[q.name].value if q.name in rig else 0.1) for q in model.parameters]
        x, u = ca.SX(state_of(len(model.states), 3)), ca.SX([2.1, 2.4])
        functions = (model.dynamics, model.measurement)
        outputs = [ca.evalf(function(x, u, ca.SX(p), ca.SX(1.5))) for function in functions]
        results.append(np.concatenate([np.asarray(output).ravel() for output in outputs]))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-6, atol=1e-9)
    assert issubclass(type(lag.make()), RotorLag)


@pytest.mark.parametrize(
    ("channel", "signs"), [("thrust.both", (1, 1)), ("thrust.difference", (1, -1)), ("voltage.back", (0, 1))]
)
def test_rotor_channel_acts_on_the_rotors_in_its_name(channel: str, signs: tuple[int, int]) -> None:
    assert rotor_signs(channel) == signs
