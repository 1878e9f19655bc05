"""What `heli-host law` says of a law agrees with its flights."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.response import responses
from heli_lab.apps.classroom.grade import FlightScore, LawGrade, score_of_trial
from heli_lab.control.law_flight import LawTrial
from heli_lab.control.linear_law import linearised
from heli_lab.control.tune.loops import linear_plant
from heli_lab.law import Command, control_law, from_gain
from heli_sim.rig import load_rig

from tests.cli.terminal import Terminal, terminal

__all__ = ["terminal"]

pytestmark = pytest.mark.medium

PLANT = linear_plant(load_rig("makki2024"))
GAINS = np.array([[12.0, 0, 0, 5.0, 0, 0], [0, 6.0, 1.5, 0, 2.0, 2.5]])
FILE = """
from heli_lab.law import from_gain

LAW = from_gain({gains}, hover_V={hover_V})
"""


def test_a_law_that_leaves_an_axis_free_is_not_stable() -> None:
    """Without feedback, travel has a pole at 0, and no margin limits anything."""
    linear = linearised(from_gain(0.0 * GAINS, hover_V=1.41), PLANT)
    assert not linear.stable
    assert np.isnan([*linear.gain_up, *linear.phase_deg]).all()


@pytest.mark.parametrize("signs", [(-1, 1), (1, -1)])
def test_a_law_with_a_wrong_sign_is_not_stable(signs: tuple[int, int]) -> None:
    linear = linearised(from_gain(np.array(signs)[:, None] * GAINS, hover_V=1.41), PLANT)
    assert not linear.stable
    assert np.isnan(linear.gain_up).all()


def test_a_law_that_is_stable_keeps_its_margins() -> None:
    linear = linearised(from_gain(GAINS, hover_V=1.41), PLANT)
    assert linear.stable
    assert min(linear.phase_deg) > 10.0
    assert linear.nonlinearity_V < 1e-6


def test_a_law_that_switches_is_not_linear() -> None:
    @control_law(rate_Hz=500)
    def switches(now: object, state: object, parameter: object) -> Command:
        pushed_V = (now.elevation_rad < -0.001) * 3.0  # type: ignore[attr-defined]
        return Command(1.7 + pushed_V, 1.7 + pushed_V)

    assert linearised(switches, PLANT).nonlinearity_V == pytest.approx(3.0)


def test_the_check_of_a_law_that_fails_ends_with_1_and_its_flight_with_4(
    terminal: Terminal, tmp_path: Path
) -> None:
    (tmp_path / "falls.py").write_text(FILE.format(gains=(0.0 * GAINS).tolist(), hover_V=3.5))
    checked = terminal("law", "check", tmp_path / "falls.py", "--rigs", 1, "--json", tmp_path / "check.json")
    assert checked.code == 1
    assert "NOT STABLE" in checked.out
    assert "margin" not in checked.out
    assert "the board's own law had to take over on 1 of 1 rigs" in checked.out
    assert json.loads((tmp_path / "check.json").read_text())["stable"] is False
    files = ("--log", tmp_path / "a.mcap", "--json", tmp_path / "fly.json")
    flown = terminal("law", "fly", tmp_path / "falls.py", "--duration", 4, "--sil", "--speed", "max", *files)
    assert flown.code == 4
    assert "law_taken_over: elevation_" in flown.err
    assert "nan" not in flown.out
    assert json.loads((tmp_path / "fly.json").read_text())["outcome"].startswith("law_taken_over")


def test_a_comparison_with_a_law_that_fails_says_so_in_its_labels(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "falls.py").write_text(FILE.format(gains=(0.0 * GAINS).tolist(), hover_V=3.5))
    where = ("--figure", tmp_path / "a.png", "--json", tmp_path / "a.json")
    compared = terminal(
        "law", "compare", tmp_path / "falls.py", "--duration", 4, "--sil", "--speed", "max", *where
    )
    assert compared.code == 4
    labels = [flight["flight"] for flight in json.loads((tmp_path / "a.json").read_text())["flights"]]
    assert sum("taken over" in label for label in labels) == 1


@pytest.mark.parametrize(
    ("settling_s", "text"),
    [((3.66,), "3.66"), ((3.0, 4.0), "3.50"), ((3.66, math.inf), "3.66 in 1 of 2"), ((math.inf,), "never")],
)
def test_the_settling_of_a_grade_is_that_of_the_flights_that_settled(
    settling_s: tuple[float, ...], text: str
) -> None:
    grade = LawGrade("lqr", scores=tuple(FlightScore(settling_s=time_s) for time_s in settling_s))
    assert grade.row()[1] == text


def test_a_grade_and_its_figure_measure_the_same(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "holds.py").write_text(FILE.format(gains=GAINS.tolist(), hover_V=1.41))
    log = tmp_path / "a.mcap"
    assert terminal("law", "fly", tmp_path / "holds.py", "--sil", "--speed", "max", "--log", log).code == 0
    trial = LawTrial.of_log(log)
    travel = responses(trial.flight)[2]
    settling_s = score_of_trial(trial).settling_s
    assert settling_s == (math.inf if math.isnan(travel.settling_s) else travel.settling_s)
