"""A flight is completed only if what the plan asks for was flown, by the law that was to fly it."""

from __future__ import annotations

from pathlib import Path

import heli_host
import pytest
from heli_host.board.law_flight import engage
from heli_host.data.log.figure import draw
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import summarise
from heli_host.fly.pilot import LAW_TAKEN_OVER
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_lab.control.law import from_gain
from heli_sim.model.linear import rig_findings
from heli_sim.rig import Rig, load_rig, write_rig

pytestmark = pytest.mark.medium

FREE = 'axes = ["elevation", "pitch"]\n[start]\nsettle_s = 2\n'
HOLD = '[start]\nsettle_s = 2\n[[segment]]\nkind = "hold"\nduration_s = 6\n'


def outcome_of(text: str, address: str = "sil://?seed=1") -> str:
    with heli_host.connect(address) as heli:
        return fly(heli, Plan.parse(text, "plan.toml")).outcome


def step(travel_deg: float, duration_s: float) -> str:
    return f'[[segment]]\nkind = "step"\ntravel_deg = {travel_deg}\nduration_s = {duration_s}\n'


@pytest.mark.parametrize(
    "segments",
    [step(150, 2), step(40, 2), step(150, 2) + step(0, 12)],
    ids=["the setpoint is on its way", "the arm is on its way", "the next step goes back"],
)
def test_a_step_that_is_not_reached_is_not_tracked(segments: str) -> None:
    outcome = outcome_of("[start]\nsettle_s = 2\n" + segments)
    assert outcome.startswith("not_tracked: travel was at ")
    assert "give the segment more time" in outcome


def test_a_step_with_enough_time_is_completed() -> None:
    assert outcome_of("[start]\nsettle_s = 2\n" + step(60, 12) + step(0, 12)) == "completed"


def test_a_law_that_the_board_takes_over_is_the_outcome_and_in_the_figure(tmp_path: Path) -> None:
    falls = from_gain([[0.0] * 6] * 2, hover_V=3.5)
    with heli_host.connect("sil://?seed=1") as heli:
        log = tmp_path / "flight.mcap"
        summary = fly(
            heli,
            Plan.parse(HOLD, "plan.toml"),
            log_path=log,
            on_taken_off=lambda: engage(heli, falls.program),
        )
    assert summary.outcome.startswith(f"{LAW_TAKEN_OVER}: elevation_")
    assert not summary.completed
    read = read_log(log)
    assert read.metadata["result"]["outcome"] == summary.outcome
    figure = draw(read.flight(), summarise(read))
    texts = [text.get_text() for panel in figure.axes for text in panel.texts]
    assert texts.count("law taken over") == 1


def test_the_landing_of_a_law_is_no_takeover(tmp_path: Path) -> None:
    log = tmp_path / "flight.mcap"
    with heli_host.connect("sil://?seed=1") as heli:
        holds = from_gain([[12.0, 0, 0, 5.0, 0, 0], [0, 6.0, 1.5, 0, 2.0, 2.5]], hover_V=1.41)
        summary = fly(
            heli,
            Plan.parse(HOLD, "plan.toml"),
            log_path=log,
            on_taken_off=lambda: engage(heli, holds.program),
        )
    assert summary.outcome == "completed"
    read = read_log(log)
    assert any(event["name"] == LAW_TAKEN_OVER for event in read.events)
    figure = draw(read.flight(), summarise(read))
    assert not any(text.get_text() == "law taken over" for panel in figure.axes for text in panel.texts)


def test_the_figure_says_which_part_of_the_flight_its_errors_count(tmp_path: Path) -> None:
    with heli_host.connect("sil://?seed=1") as heli:
        fly(heli, Plan.parse(HOLD, "plan.toml"), log_path=tmp_path / "flight.mcap")
    read = read_log(tmp_path / "flight.mcap")
    titles = [panel.get_title(loc="left") for panel in draw(read.flight(), summarise(read)).axes]
    assert sum(title.endswith("at most, without take-off and landing") for title in titles) == 3


@pytest.mark.parametrize(("pitch_deg", "duration_s"), [(5, 8), (-5, 8), (10, 4)])
def test_an_arm_that_turns_is_stopped_before_it_lands(pitch_deg: float, duration_s: float) -> None:
    turn = f'[[segment]]\nkind = "step"\npitch_deg = {pitch_deg}\nduration_s = {duration_s}\n'
    assert outcome_of(FREE + turn) == "completed"


def heavier_counterweight(more_kg: float) -> Rig:
    rig = load_rig("makki2024")
    return rig.replace(M_w=rig["M_w"].value + more_kg)


@pytest.mark.parametrize(("more_kg", "can_land"), [(0.0, True), (0.015, True), (0.045, False)])
def test_a_rig_that_floats_high_without_voltage_cannot_land(
    tmp_path: Path, more_kg: float, can_land: bool
) -> None:
    rig = heavier_counterweight(more_kg)
    findings = rig_findings(rig)
    assert findings.can_fly is can_land
    assert any("floats without voltage at " in phrase for phrase in findings.phrases)
    write_rig(rig, tmp_path / "rig.toml")
    outcome = outcome_of(HOLD, f"sil://?rig={tmp_path / 'rig.toml'}&seed=1")
    assert (outcome == "completed") is can_land, outcome
    if not can_land:
        assert "although the motors gave no thrust: it floats" in outcome
        assert "hover_V" not in outcome
