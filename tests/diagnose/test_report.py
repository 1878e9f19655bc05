"""Figures are the same in either process, and none is lost when the drawing process dies."""

import base64
import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_lab.explain.contributions import TIME, MissingTerm
from heli_lab.explain.result import extended_rig
from heli_lab.explain.wording import evidence_in_words, nats_in_words
from heli_lab.fit.flight_model import RigParameters
from heli_lab.fit.problem import Fit, Problem
from heli_lab.fit.records import Record
from heli_lab.report.diagnosis.figures import figure_of_missing_terms
from heli_lab.report.diagnosis.page import explained_by, legend, missing_section, symbols_of
from heli_lab.report.diagnosis.text import CauseEntry
from heli_lab.report.page import drawing
from heli_lab.report.page.drawing import Drawing, png_of
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig
from matplotlib.figure import Figure


def figure(number: int, points: int = 2) -> Figure:
    """Draw a small figure that differs by its number."""
    drawn = Figure(figsize=(2, 1))
    drawn.subplots().plot([number] * points, label="$x^2$")
    return drawn


@pytest.mark.medium
def test_a_second_process_draws_the_same_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = [png_of(figure(number)) for number in range(3)]
    with Drawing(use_process=True) as drawing_process:
        added = [drawing_process.add(figure(number), tmp_path / f"{number}.png") for number in range(3)]
        # None of them is drawn here.
        monkeypatch.setattr(drawing, "png_of", lambda _: pytest.fail("drawn here"))
        while drawing_process.waiting:
            time.sleep(0.01)
        addresses = [str(picture) for picture in added]
    assert [(tmp_path / f"{number}.png").read_bytes() for number in range(3)] == expected
    assert [base64.b64decode(address.partition(",")[2]) for address in addresses] == expected


@pytest.mark.parametrize(("vector_format", "head"), [("svg", b"<?xml"), ("pdf", b"%PDF")])
def test_a_figure_is_also_written_in_the_vector_format(
    tmp_path: Path, vector_format: str, head: bytes
) -> None:
    with Drawing(vector_format=vector_format) as drawn:
        drawn.add(figure(1), tmp_path / "1.png")
        drawn.finish()
    assert (tmp_path / "1.png").read_bytes() == png_of(figure(1))
    assert (tmp_path / f"1.{vector_format}").read_bytes().startswith(head)


@pytest.mark.skipif(sys.platform == "win32", reason="ended by a signal")
def test_pictures_of_a_killed_process_are_drawn_in_this_process(tmp_path: Path) -> None:
    with Drawing(use_process=True) as drawing_process:
        first = drawing_process.add(figure(1), tmp_path / "1.png")
        while drawing_process.process is None:
            time.sleep(0.01)
        os.kill(drawing_process.process.pid, signal.SIGKILL)
        # More than a pipe holds.
        second = drawing_process.add(figure(2, 100_000), tmp_path / "2.png")
        assert str(second)
        assert str(first)
    assert (tmp_path / "1.png").read_bytes() == png_of(figure(1))
    assert (tmp_path / "2.png").read_bytes() == png_of(figure(2, 100_000))


def test_no_figure_is_taken_while_another_thread_looks_for_one(tmp_path: Path) -> None:
    drawn = Drawing()
    drawn.add(figure(3), tmp_path / "3.png")
    with drawn._more:  # as the thread of the second process does
        finishing = threading.Thread(target=drawn.finish)
        finishing.start()
        finishing.join(timeout=0.05)
        assert drawn.waiting == 1
    finishing.join()
    assert (tmp_path / "3.png").read_bytes() == png_of(figure(3))


def test_without_a_process_all_pictures_are_drawn_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a process was started"))
    assert base64.b64decode(str(Drawing().add(figure(4), tmp_path / "4.png")).partition(",")[2]) == png_of(
        figure(4)
    )


def test_all_pictures_are_drawn_if_the_process_does_not_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no python"))
    with Drawing(use_process=True) as drawing_process:
        assert str(drawing_process.add(figure(5), tmp_path / "5.png"))


def test_drawing_process_ends_after_an_exception() -> None:
    with pytest.raises(KeyError), Drawing(use_process=True) as drawing_process:
        while drawing_process.process is None:
            time.sleep(0.01)
        raise KeyError
    assert drawing_process.process is not None
    assert drawing_process.process.poll() is not None


def test_a_picture_that_cannot_be_written_is_an_error_and_no_empty_picture(tmp_path: Path) -> None:
    with Drawing(use_process=True) as drawing_process:
        picture = drawing_process.add(figure(6), tmp_path / "no folder" / "6.png")
        while drawing_process.waiting:
            time.sleep(0.01)
        with pytest.raises(FileNotFoundError):
            _ = str(picture)


@pytest.mark.parametrize(
    ("nats", "words"),
    [
        (-0.2, "hardly any evidence (log-likelihood ratio below 1 nat)"),
        (0.9, "hardly any evidence (log-likelihood ratio below 1 nat)"),
        (2.9, "some evidence (log-likelihood ratio 3 nats)"),
        (4.9, "strong evidence (log-likelihood ratio 5 nats)"),
        (5.0, "very strong evidence (log-likelihood ratio 5 nats)"),
        (345.0, "very strong evidence (log-likelihood ratio 345 nats)"),
        (2385228.0, "very strong evidence (log-likelihood ratio above 1000 nats)"),
    ],
)
def test_evidence_has_words_and_a_number(nats: float, words: str) -> None:
    assert evidence_in_words(nats) == words


def term(on: str = "pitch", id_: str = "rotor_lag") -> MissingTerm:
    """Make the missing term of two flights of 40 s; the cause acts most in the second, from 10 to 15 s."""
    t_s = np.tile(np.arange(0.0, 40.0, 0.04), 2)
    acts = (np.arange(len(t_s)) >= 1000) & (t_s >= 10.0) & (t_s < 15.0)
    contribution = np.where(acts, np.sin(t_s), 0.01 * np.sin(t_s))
    zeros = np.zeros_like(t_s)
    return MissingTerm(
        id_,
        what="torque",
        unit="mN m",
        axis="pitch",
        on=on,
        on_unit="s",
        quantity=t_s,
        missing=contribution,
        std=zeros + 0.1,
        remaining=zeros,
        contribution=contribution,
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
    cause = CauseEntry(
        "rotor_lag", parameters={}, confidence=confidence, sentence="the rotors lag", equation="", evidence={}
    )
    assert cause.statement(certain) == text


@pytest.mark.parametrize(
    ("nats", "text"), [(0.15, "below 1 nat"), (66.3, "66 nats"), (3233804.0, "above 1000 nats")]
)
def test_a_ratio_has_its_unit_and_no_digits_that_say_nothing(nats: float, text: str) -> None:
    assert nats_in_words(nats) == text


pytestmark = pytest.mark.medium


def test_extended_rig_of_several_flights_has_the_means_of_their_zeros_and_torques() -> None:
    rig, model = load_rig("makki2024"), MultibodyModel()
    records = [cast(Record, SimpleNamespace(label=label)) for label in "ab"]
    vector = RigParameters(model, rig, records)
    per_flight = {
        "offset_pitch[a]": 0.5,
        "offset_pitch[b]": 0.3,
        "torque_pitch[a]": 0.01,
        "torque_pitch[b]": 0.03,
    }
    problem = SimpleNamespace(
        rig=rig, model=model, records=records, free=vector.free, names=vector.names, parameter_vector=vector
    )
    fit = Fit(
        problem=cast(Problem, problem),
        theta=vector.started_from(per_flight),
        covariance=1e-8 * np.eye(len(vector.free)),
        information=1e8 * np.eye(len(vector.free)),
        states=(),
        variance=(),
        weights=(),
        cost=0.0,
        at_bound=(),
        evaluations=0,
        elapsed_s=0.0,
        converged=True,
    )
    numbers = extended_rig("extended", fit, {}, {}, term=None).numbers
    assert numbers["offset_pitch"].value == pytest.approx(0.4)
    assert numbers["torque_pitch"].value == pytest.approx(0.02)
    # The next flight has other zeros: the scatter of two, and never less than the rig file states.
    assert numbers["offset_pitch"].tolerance == pytest.approx(2.0 * np.std([0.5, 0.3], ddof=1))
    assert numbers["offset_elevation"].tolerance == rig["offset_elevation"].tolerance
