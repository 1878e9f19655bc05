"""`law grade` flies all laws along the same plan, and judges them by the plan's setpoints."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.board.law_program import LawProgram
from heli_host.data.flight import Flight
from heli_host.data.log.comparison import MAX_FLIGHTS, split_into_figures, write_comparisons
from heli_host.errors import FlightAborted, HeliError
from heli_lab.apps.classroom.grade import (
    HEADS,
    LawGrade,
    grade,
    grade_lines,
    with_plan_setpoints,
)
from heli_lab.control.law_flight import LawTrial
from heli_lab.control.program_json import law_of_program
from heli_lab.law import Command, Law, control_law

from tests.cli.terminal import Terminal, terminal
from tests.law.class_of_thirty import law_text

__all__ = ["terminal"]

FAILED = 4


def flight(travel_deg: float = 0.0) -> Flight:
    """Two seconds at this travel; the setpoints are zero."""
    t_s = np.arange(2000, dtype=np.float64) * 1e-3
    zero = np.zeros(2000)
    travel_rad = np.full(2000, np.deg2rad(travel_deg))
    return Flight(
        t_s,
        zero + 1.5,
        zero + 1.5,
        zero,
        zero,
        travel_rad,
        elevation_setpoint_rad=zero,
        pitch_setpoint_rad=zero,
        travel_setpoint_rad=zero,
    )


def law_with_setpoints(**setpoints: Any) -> Law:
    @control_law()
    def law(now: Any, state: Any, parameter: Any) -> Command:
        wanted = {name: getattr(now, angle) for name, angle in setpoints.items()}
        front_V = 1.0 + now.pitch_rad + 0.5 * (now.travel_setpoint_rad - now.travel_rad)
        return Command(front_V, 1.5 * now.pitch_rad, **wanted)

    return law


def test_each_law_flies_each_rig_with_each_seed_in_the_same_order() -> None:
    flown: dict[str, list[tuple[str, int]]] = {"a": [], "b": []}
    for label, calls in flown.items():

        def fly(program: LawProgram | None, rig: str, seed: int, calls: Any = calls) -> LawTrial:
            calls.append((rig, seed))
            return LawTrial(flight())

        grade(label, law_with_setpoints().program, [("x", 1), ("x", 2), ("y", 1), ("y", 2)], fly)
    assert flown["a"] == flown["b"] == [("x", 1), ("x", 2), ("y", 1), ("y", 2)]


def test_a_law_that_logs_its_angle_as_its_setpoint_is_judged_by_the_board_s() -> None:
    program = law_with_setpoints(
        elevation_setpoint_rad="elevation_rad", travel_setpoint_rad="travel_rad"
    ).program
    fair = with_plan_setpoints(program)
    random = np.random.default_rng(2)
    inputs = random.uniform(-0.2, 0.2, 17).tolist()
    voltages, honest = (law_of_program(candidate).runner()(inputs) for candidate in (program, fair))
    assert list(voltages)[:2] == list(honest)[:2], "the voltages are the same"
    ours = with_plan_setpoints(law_with_setpoints().program)
    assert fair.outputs[2] == ours.outputs[2] and fair.outputs[4] == ours.outputs[4]
    assert program.outputs[4] != fair.outputs[4]


def test_a_takeover_and_a_refusal_fail_a_law_and_no_other() -> None:
    def fly(program: LawProgram | None, rig: str, seed: int) -> LawTrial:
        if seed == 2:
            raise FlightAborted("the arm fell")
        if seed == 3:
            raise HeliError("the board refuses the law", "simplify it")
        return LawTrial(flight(1.0), "voltage_jump" if seed == 4 else "")

    good = grade("good", law_with_setpoints().program, [("x", 1)], fly)
    bad = grade("bad", law_with_setpoints().program, [("x", seed) for seed in (1, 2, 3, 4)], fly)
    refused = LawGrade("refused", "no law")
    assert (good.passed, bad.passed, refused.passed) == (True, False, False)
    assert bad.takeovers == 3
    assert good.mean("travel_rms_deg") == pytest.approx(1.0)
    lines = grade_lines([good, bad, refused])
    assert all(head in lines[0] for head in HEADS)
    assert "3 of 4" in lines[2] and "refused" in lines[3]
    assert lines[4].startswith("bad: did not fly to the end: the arm fell")


def test_a_board_that_refuses_its_own_law_is_an_error_and_no_grade() -> None:
    def fly(program: LawProgram | None, rig: str, seed: int) -> LawTrial:
        raise HeliError("the rig is unknown", "give another")

    with pytest.raises(HeliError):
        grade("the board's own", None, [("x", 1)], fly)


def test_any_number_of_flights_is_drawn_and_the_first_is_in_each_figure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flights = {f"law {number}": flight() for number in range(2 * MAX_FLIGHTS + 1)}
    parts = split_into_figures(flights)
    assert all(len(part) <= MAX_FLIGHTS and next(iter(part)) == "law 0" for part in parts)
    drawn = [name for part in parts for name in list(part)[1:]]
    assert drawn == list(flights)[1:]
    monkeypatch.setattr("heli_host.data.log.comparison.write_comparison", lambda part, path: path.touch())
    files = write_comparisons(flights, tmp_path / "compare.png")
    assert [file.name for file in files] == ["compare.png", "compare-2.png", "compare-3.png"]
    assert all(file.exists() for file in files)


@pytest.mark.slow
def test_the_command_fails_if_a_law_was_taken_over_and_still_writes_all(terminal: Terminal) -> None:
    Path("good.py").write_text(law_text())
    Path("wild.py").write_text(law_text(front_V="if_else(late, 20.0, front_V)"))
    Path("empty.py").write_text("")
    result = terminal(
        "law", "grade", "good.py", "wild.py", "empty.py", "--seeds", 1, "--duration", 5, "--json", "g.json"
    )
    assert result.code == FAILED
    assert "2 of 3 laws did not fly to the end: wild, empty" in result.err
    grades = json.loads(Path("g.json").read_text())["grades"]
    assert [grade["law"] for grade in grades] == ["the board's own", "good", "wild", "empty"]
    assert grades[1]["takeovers"] == 0 and grades[2]["flights"][0]["ended"] == "voltage_jump"
    assert grades[1]["phase_margin_deg"] > 0.0
    assert "does not define LAW" in grades[3]["refused"]


def test_a_missing_file_is_named_before_the_first_flight(terminal: Terminal) -> None:
    refused = terminal("law", "grade", "mien.py")
    assert refused.code == 2 and not refused.out
    assert refused.err.startswith("error: mien.py is not a file; give a Python file")
