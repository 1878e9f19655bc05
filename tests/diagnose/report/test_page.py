"""The page of a diagnosis names the cause of each figure, and explains all symbols of its equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heli_lab.explain.contributions import TIME, MissingTerm
from heli_lab.explain.wording import nats_in_words
from heli_lab.report.diagnosis.figures import figure_of_missing_terms
from heli_lab.report.diagnosis.page import explained_by, legend, missing_section, symbols_of
from heli_lab.report.diagnosis.text import stated
from heli_sim.model.effects import catalogue


def term(on: str = "pitch", id_: str = "rotor_lag") -> MissingTerm:
    """Make the missing term of two flights of 40 s; the cause acts most in the second, from 10 to 15 s."""
    t_s = np.tile(np.arange(0.0, 40.0, 0.04), 2)
    acts = (np.arange(len(t_s)) >= 1000) & (t_s >= 10.0) & (t_s < 15.0)
    contribution = np.where(acts, np.sin(t_s), 0.01 * np.sin(t_s))
    zeros = np.zeros_like(t_s)
    return MissingTerm(
        id_, "torque", "mN m", "pitch", on, "s", t_s, contribution, zeros + 0.1, zeros, contribution
    )


def test_panels_carry_the_name_of_their_cause() -> None:
    (before, _, second, _) = figure_of_missing_terms([term(), term(id_="cable_spring.travel")]).axes
    assert before.get_title(loc="left").startswith("rotor_lag\n")
    assert second.get_title(loc="left").startswith("cable_spring.travel\n")


def test_a_curve_in_place_of_an_unknown_is_not_called_an_equation_of_a_cause() -> None:
    unknown = term(id_="spline:torque.pitch:travel")
    (before, after) = figure_of_missing_terms([unknown]).axes
    assert before.get_title(loc="left").startswith("curve in place of the unknown: torque about pitch")
    section = missing_section("unknown", [unknown], lambda *_: None)
    assert section is not None
    texts = [*before.get_legend_handles_labels()[1], after.get_title(loc="left"), section["caption"]]
    assert not any(" cause" in text or "equation" in text for text in texts)


def test_a_term_over_time_is_drawn_in_the_one_flight_where_it_acts_most() -> None:
    (before, _) = figure_of_missing_terms([term(TIME)]).axes
    drawn = next(line for line in before.get_lines() if line.get_label() == "equation of the cause")
    t_s, value = (np.asarray(values, float) for values in drawn.get_data())
    assert np.all(np.diff(t_s) > 0.0)
    assert t_s[0] <= 10.0
    assert t_s[-1] >= 14.9
    assert np.ptp(t_s) < 12.1
    assert np.max(np.abs(value)) > 0.9


def test_a_caption_says_when_disturbances_hide_a_term() -> None:
    noise = 3.0 * np.sign(np.sin(np.arange(2000.0)))
    hidden = replace(term(), missing=term().contribution + noise)
    for shown, hides in ((term(), False), (hidden, True)):
        section = missing_section("cause", [shown], lambda *_: None)
        assert section is not None
        assert ("disturbances hide it" in section["caption"]) == hides


def test_every_symbol_of_every_equation_is_explained() -> None:
    for spec in catalogue().values():
        meanings = [parameter.meaning for parameter in spec.numbers]
        symbols = symbols_of(spec.equation)
        assert symbols, spec.id
        by_parameters = [symbol for symbol in symbols if explained_by(symbol, meanings)]
        explained = legend(spec.id, spec.equation, meanings)
        assert len(explained) + len(by_parameters) == len(symbols), spec.id


def test_symbols_are_those_of_the_equation_without_its_functions() -> None:
    equation = r"\tau = H (\cos\phi\, \dot\psi), \quad \boldsymbol{n} \cdot 1\,\mathrm{V}, \quad V_i(t - T_d)"
    assert symbols_of(equation) == [r"\tau", "H", r"\phi", r"\psi", "n", "V_i", "t", "T_d"]


@pytest.mark.parametrize(
    ("confidence", "certain", "text"),
    [
        (0.99, True, "the rotors lag"),
        (0.5, True, "perhaps the rotors lag (confidence 0.50)"),
        (0.99, False, "perhaps the rotors lag (confidence 0.99)"),
    ],
)
def test_an_uncertain_cause_is_not_stated_as_a_fact(confidence: float, certain: bool, text: str) -> None:
    assert stated({"sentence": "the rotors lag", "confidence": confidence}, certain) == text


@pytest.mark.parametrize(
    ("nats", "text"), [(0.15, "below 1 nat"), (66.3, "66 nats"), (3233804.0, "above 1000 nats")]
)
def test_a_ratio_has_its_unit_and_no_digits_that_say_nothing(nats: float, text: str) -> None:
    assert nats_in_words(nats) == text
