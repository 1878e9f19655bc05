"""A class of submissions is marked: each is answered, and a hostile one costs its own mark only."""

import csv
import hashlib
import io
import json
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from heli_host.board.law_program import LawProgram
from heli_host.data.flight import Flight
from heli_host.data.log.comparison import MAX_FLIGHTS, split_into_figures, write_comparisons
from heli_host.data.log.reader import read_flight
from heli_host.declaration import PARAMS
from heli_host.errors import FlightAborted, HeliError
from heli_host.fly.plan import load_plan
from heli_host.ui.cli import run
from heli_host.ui.cli.flight import FlightOptions
from heli_lab.apps.classroom.grade import (
    HEADS,
    FlightScore,
    LawGrade,
    grade,
    grade_lines,
    with_plan_setpoints,
)
from heli_lab.apps.classroom.marking import (
    FLOORS,
    POINTS,
    WEIGHTS,
    Mark,
    Marking,
    MIN_MOTION_deg,
    mark_of,
    points_of,
)
from heli_lab.apps.classroom.submission import MARKED, new_rig_log, read_submission, returned_files
from heli_lab.control.fence import FileLimits
from heli_lab.control.law_flight import LawTrial, trial_plan
from heli_lab.control.program_json import law_of_program
from heli_lab.law import Command, Law, control_law
from heli_lab.verbs.classroom import _write_marks

from tests.cli.terminal import Terminal
from tests.law.hostile import PITCH_STOP_deg, STOP_deg
from tests.running.long import LONG

OUTSIDE: Final = "outside"
"""Folder next to the class; nothing in it may change."""

GOOD_LAW: Final = """\
from heli_lab.law import *

@control_law(states={{"t_s": 0.0}})
def law(now, state, parameter):
    error_rad = now.elevation_setpoint_rad - now.elevation_rad
    lift_V = 1.4 + 3.44 * now.elevation_rad + {kp} * error_rad - {kd} * now.elevation_rad_s
    pitch_rad = {kt} * (now.travel_setpoint_rad - now.travel_rad) - 1.5 * now.travel_rad_s
    tilt_V = 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s
    front_V, back_V = motor_volts(lift_V, tilt_V)
    late = state.t_s > 3.0
    return Command({front_V}, {back_V}, {{"t_s": state.t_s + 1e-3}}{more})

LAW = law
"""


def law_text(kp: float = 16.0, kd: float = 12.0, kt: float = 1.0, **bad: str) -> str:
    """A law that follows its setpoints, or after 3 s applies other voltages."""
    words = {"front_V": "front_V", "back_V": "back_V", "more": "", **bad}
    return GOOD_LAW.format(kp=kp, kd=kd, kt=kt, **words)


def _late(volts: str) -> str:
    return f"if_else(late, {volts}, front_V)"


HOSTILE: Final[dict[str, dict[str, str]]] = {
    "endless_loop": {"law.py": "while True: pass\n"},
    "ignores_its_limit": {
        "law.py": "import signal\nsignal.signal(signal.SIGXCPU, signal.SIG_IGN)\nwhile True: pass\n"
    },
    "sleeps": {"law.py": "import time\ntime.sleep(1e6)\n"},
    "one_gigabyte": {"law.py": "data = bytearray(1 << 30)\n"},
    "writes_files": {"law.py": "open('../../outside/kept.txt', 'w').write('other')\n"},
    "changes_marks": {"law.py": "import os\nos.rename('../../outside/kept.txt', 'mine.txt')\n"},
    "opens_sockets": {"law.py": "import socket\nsocket.create_connection(('127.0.0.1', 9))\n"},
    "ends_python": {"law.py": "import os\nos._exit(0)\n"},
    "forks": {"law.py": "import os\nwhile True: os.fork()\n"},
    "kills_its_parent": {"law.py": "import os\nos.kill(os.getppid(), 9)\n"},
    "starts_processes": {"law.py": "import subprocess\nsubprocess.run(['touch', '../../outside/new.txt'])\n"},
    "forges_its_answer": {
        "law.py": 'import os\nfor pipe in range(3, 60):\n    try: os.write(pipe, b\'{"program": "[]"}\')\n'
        "    except OSError: pass\nos._exit(0)\n"
    },
    "recurses": {"law.py": "def deeper(n): return deeper(n + 1)\ndeeper(0)\n"},
    "not_a_number": {"law.py": law_text(front_V=_late("sqrt(-1.0 - state.t_s)"))},
    "full_lift": {"law.py": law_text(front_V=_late("20.0"), back_V="if_else(late, 20.0, back_V)")},
    "full_tilt": {"law.py": law_text(front_V=_late("20.0"), back_V="if_else(late, -20.0, back_V)")},
    "not_a_number_of_a_parameter": {"gains.toml": "[parameters]\nelevation_kp = nan\n"},
    "raises_a_limit": {"gains.toml": "[parameters]\nmotor_max_V = 12.0\n"},
    "plan_without_end": {"plan.toml": 'title = "long"\n[[segment]]\nkind = "hold"\nduration_s = 1e9\n'},
    "nested_plan": {"plan.toml": "a = " + "[" * 100_000 + "\n"},
}
"""Files of hostile submissions by name; each gets no points."""


def make_class(folder: Path, count: int, names: Sequence[str], duration_s: float) -> None:
    """Write a class of submissions, and the folder next to it."""
    # ``folder`` is made; of ``count`` submissions, those with ``names`` are hostile, spread over the class.
    # The others are laws, parameter files and plans in turn.
    spacing = count // max(len(names), 1)
    random = np.random.default_rng(1)
    for number in range(count):
        hostile_number = number // spacing
        if number % spacing == 0 and hostile_number < len(names):
            name = names[hostile_number]
            files = HOSTILE[name]
        else:
            name, files = "student", _honest(number, random, duration_s)
        place = folder / f"{number:03}_{name}"
        place.mkdir(parents=True)
        for file, text in files.items():
            (place / file).write_text(text)
    outside = folder.parent / OUTSIDE
    outside.mkdir()
    (outside / "kept.txt").write_text("kept")
    # One more way out: the folder for the answer leads elsewhere.
    first = next(path for path in sorted(folder.iterdir()) if path.name.endswith("student"))
    (first / "marked").symlink_to(outside, target_is_directory=True)


def _honest(number: int, random: np.random.Generator, duration_s: float) -> dict[str, str]:
    factor = random.uniform(0.8, 1.2, 3)
    if number % 3 == 0:
        return {"law.py": law_text(*(float(x) for x in factor * (16.0, 12.0, 1.0)))}
    if number % 3 == 1:
        return {"gains.toml": f"[parameters]\ntravel_kp = {0.5 * factor[0]:.4f}\n"}
    return {"plan.toml": trial_plan(duration_s + 0.1 * (number % 5)).text}


def unsafe_ticks(log: Path) -> int:
    """Ticks of a log in which a motor is outside its limits, runs while off, or the arm is at a stop."""
    flight = read_flight(log, allow_gaps=True)
    limits = {spec.name: spec.default for spec in PARAMS}
    assert flight.state is not None
    off = np.isin(flight.state, [n for n, name in flight.state_names.items() if name in ("idle", "fault")])
    volts = flight.voltages_V
    bad = ~np.isfinite(volts).all(axis=1)
    bad |= (volts > limits["motor_max_V"] + 0.01).any(axis=1)
    bad |= (volts < limits["motor_min_V"] - 0.01).any(axis=1)
    bad |= off & (volts != 0.0).any(axis=1)
    bad |= np.rad2deg(flight.elevation_rad) > STOP_deg
    bad |= np.abs(np.rad2deg(flight.pitch_rad)) > PITCH_STOP_deg
    return int(bad.sum())


@dataclass(frozen=True)
class Marked:
    """Result of a run of `heli-host class` left."""

    # ``exit_code`` and ``text`` of the command, its ``marks`` by name, ``ticks`` and ``unsafe`` ticks in all
    # logs, ``digest`` of all files that it should not change.

    exit_code: int
    text: str
    marks: dict[str, dict[str, Any]]
    ticks: int
    unsafe: int
    digest: str


Run = Callable[[Sequence[str]], tuple[int, str]]
"""Runs a command line; its exit code and what it printed."""


def mark_class(folder: Path, *options: str, run: Run) -> Marked:
    """Run `heli-host class` over a folder, and look at what it left."""
    result = folder.parent / "class.json"
    code, text = run(["class", str(folder), "--json", str(result), *options])
    marks = json.loads(result.read_text())["marks"] if code == 0 else []
    logs = sorted(folder.glob("*/marked/*.mcap"))
    return Marked(
        code,
        text,
        marks={mark["submission"]: mark for mark in marks},
        ticks=sum(len(read_flight(log, allow_gaps=True)) for log in logs),
        unsafe=sum(unsafe_ticks(log) for log in logs),
        digest=digest(folder),
    )


def digest(folder: Path) -> str:
    """Digest of the folder outside, and of every file of the submissions that is not an answer to them."""
    summed = hashlib.sha256()
    for path in sorted(_kept_files(folder)):
        summed.update(f"{path}\n".encode() + path.read_bytes())
    return summed.hexdigest()


def _kept_files(folder: Path) -> Iterator[Path]:
    yield from (path for path in (folder.parent / OUTSIDE).rglob("*") if path.is_file())
    for path in folder.rglob("*"):
        if path.is_file() and "marked" not in path.parts and path.name != "marks.csv":
            yield path


def problems(folder: Path, first: Marked, second: Marked, before: str) -> list[str]:
    """What is wrong with two runs over a class; empty if nothing is."""
    names = {path.name for path in folder.iterdir() if path.is_dir()}
    hostile = {name for name in names if not name.endswith("student")}
    checks: dict[str, Any] = {}
    for marking in (first, second):
        checks |= {
            f"exit code {marking.exit_code}: {marking.text[-500:]}": marking.exit_code == 0,
            "a traceback": "Traceback" not in marking.text,
            f"no answer: {sorted(names - marking.marks.keys())}": names == marking.marks.keys(),
            f"{marking.unsafe} unsafe ticks": marking.unsafe == 0,
            "a file of a submission or outside has changed": marking.digest == before,
        }
    for name, mark in sorted(first.marks.items()):
        checks[f"{name}: {mark['points']} points; {mark['reason']}"] = (
            mark["points"] == 0.0 and mark["reason"]
            if name in hostile
            else mark["points"] > 0.0 and not mark["reason"]
        )
        if name.startswith("full_"):
            checks[f"{name}: the takeover is not the reason"] = "own law took over: " in mark["reason"]
        checks[f"{name}: no mark.json"] = (folder / name / "marked" / "mark.json").is_file()
        # Only the first run flies on the rig.
        second_mark = {**second.marks.get(name, {}), "rig": mark["rig"]}
        checks[f"{name}: the second mark is another"] = mark == second_mark
    return [text for text, good in checks.items() if not good]


ROOT = Path(__file__).resolve().parents[2]
REFERENCE = FlightScore(3.0, overshoot_percent=10.0, elevation_rms_deg=0.05, travel_rms_deg=0.8, effort_V=0.1)
LIMITS = FileLimits(1.0)


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Any:
    """Run the command line here, without the time of drawing, and answer its questions in turn."""
    monkeypatch.setattr("matplotlib.figure.Figure.savefig", lambda _, path, **options: Path(path).touch())

    def type_in(words: Sequence[str], answer: str = "") -> tuple[int, str]:
        monkeypatch.setattr("sys.stdin", io.StringIO(f"{answer}\n"))
        code = run(list(words))
        output = capsys.readouterr()
        return code, output.out + output.err

    return type_in


@pytest.mark.slow
def test_each_submission_is_answered_and_marked_the_same_again(tmp_path: Path, in_process: Any) -> None:
    """The rig flies what a person confirms: the first time yes, the second time no."""
    folder = tmp_path / "submissions"
    make_class(folder, count=4, names=["forks", "not_a_number", "raises_a_limit"], duration_s=5.0)
    before = digest(folder)
    options = ("--duration", "5", "--port", "sil://?speed=max")
    first, second = (mark_class(folder, *options, run=partial(in_process, answer=answer)) for answer in "yn")
    assert not problems(folder, first, second, before)
    assert [run.text.count("on the rig?") for run in (first, second)] == [1, 1], "one good submission of four"
    (student,) = folder.glob("*student")
    assert [run.marks[student.name]["rig"] for run in (first, second)] == ["completed", "not flown"]
    names = {file.name for file in (student / MARKED).iterdir()}
    assert names == {"mark.json", "flight.mcap", "figure.png", "rig.mcap", "rig.png"}
    lines = (folder / "marks.csv").read_text().splitlines()
    head = "submission,points,of,rms_points,settling_points,overshoot_points,effort_points,"
    assert len(lines) == 5
    assert lines[0] == head + "rms_deg,settling_s,overshoot_percent,effort_V,reason,rig"
    (row,) = [row for row in csv.DictReader(lines) if row["submission"] == student.name]
    parts = [float(row[name]) for name in POINTS.values() if row[name]]
    assert parts and sum(parts) == pytest.approx(float(row["points"]), abs=0.1)
    # A column with a unit has the values of the flights, as they are in the mark.
    mark = json.loads((student / MARKED / "mark.json").read_text())
    efforts_V = [score["effort_V"] for score in mark["flights"]]
    assert float(row["effort_V"]) == pytest.approx(sum(efforts_V) / len(efforts_V), rel=0.01)


@pytest.mark.skipif(not LONG, reason="180 submissions, each marked twice: make long")
def test_a_class_with_every_hostile_submission_is_answered(tmp_path: Path, in_process: Any) -> None:
    folder = tmp_path / "submissions"
    make_class(folder, count=180, names=list(HOSTILE), duration_s=8.0)
    before = digest(folder)
    first, second = (
        mark_class(folder, "--duration", "8", "--load-timeout", "3", run=in_process) for _ in range(2)
    )
    assert not problems(folder, first, second, before)


def test_a_flight_on_the_rig_is_kept_when_a_submission_is_marked_again(tmp_path: Path) -> None:
    (tmp_path / MARKED).mkdir()
    for name in ("rig.mcap", "rig-2.mcap", "rig.png", "flight.mcap"):
        (tmp_path / MARKED / name).write_text(name)
    (tmp_path / MARKED / "rig-3.mcap").symlink_to("/dev/null")
    with returned_files(tmp_path) as files:
        (files / "mark.json").write_text("new")
    assert sorted(path.name for path in (tmp_path / MARKED).iterdir()) == [
        "mark.json",
        "rig-2.mcap",
        "rig.mcap",
        "rig.png",
    ]
    assert new_rig_log(tmp_path).name == "rig-3.mcap"


def test_what_is_not_a_gain_and_a_link_are_refused(tmp_path: Path) -> None:
    for name in ("motor_max_V = 12.0", "travel_slew_deg_s = 1.0", "elevation_max_deg = 20.0"):
        (tmp_path / "gains.toml").write_text(f"[parameters]\n{name}\n")
        with pytest.raises(HeliError, match="not a gain"):
            read_submission(tmp_path, LIMITS)
    (tmp_path / "gains.toml").write_text("elevation_kp = 0.2\n")
    with pytest.raises(HeliError, match=r"outside of \[parameters\]; write the line \[parameters\] above"):
        read_submission(tmp_path, LIMITS)
    (tmp_path / "gains.toml").unlink()
    (tmp_path / "law.py").symlink_to(__file__)
    with pytest.raises(HeliError, match="not a plain file"):
        read_submission(tmp_path, LIMITS)


@pytest.mark.parametrize("name", [name for name, files in HOSTILE.items() if "law.py" not in files])
def test_a_hostile_table_is_refused_with_its_fix(name: str, tmp_path: Path) -> None:
    for file, text in HOSTILE[name].items():
        (tmp_path / file).write_text(text)
    with pytest.raises(HeliError) as refused:
        read_submission(tmp_path, LIMITS)
    assert refused.value.remedy


def test_a_flight_as_good_as_the_reference_has_all_points() -> None:
    assert points_of(REFERENCE, REFERENCE) == 10.0
    better = FlightScore(
        1.0, overshoot_percent=0.0, elevation_rms_deg=0.01, travel_rms_deg=0.1, effort_V=0.05
    )
    assert points_of(better, REFERENCE) == 10.0
    assert points_of(replace(better, ended="voltage_jump"), REFERENCE) == 0.0


def test_motors_that_do_nothing_earn_nothing() -> None:
    lazy = FlightScore(
        math.inf, overshoot_percent=0.0, elevation_rms_deg=7.0, travel_rms_deg=7.0, effort_V=0.001
    )
    assert points_of(lazy, REFERENCE) == 0.0
    without = FlightScore(
        math.nan,
        overshoot_percent=math.nan,
        elevation_rms_deg=math.nan,
        travel_rms_deg=math.nan,
        effort_V=0.001,
    )
    assert points_of(without, REFERENCE) == 0.0


def test_the_points_of_each_number_add_up_to_the_mark() -> None:
    slow = replace(REFERENCE, settling_s=6.0, effort_V=0.2)
    mark = mark_of("ann", [slow, REFERENCE], [REFERENCE, REFERENCE])
    assert sum(mark.parts.values()) == pytest.approx(mark.points, abs=0.06)
    assert {name for name in WEIGHTS if mark.parts[POINTS[name]] < WEIGHTS[name]} == {
        "settling_s",
        "effort_V",
    }
    without_step = replace(REFERENCE, settling_s=math.nan, overshoot_percent=math.nan)
    assert set(mark_of("bob", [slow], [without_step]).parts) == {"rms_points", "effort_points"}


def test_a_plan_that_only_holds_has_no_points(tmp_path: Path) -> None:
    marking = Marking(FlightOptions(sil=True), load_plan("step"), (1,), LIMITS)
    for number, segments in enumerate(
        (
            'kind = "hold"\nduration_s = 2',
            'kind = "sine"\nelevation_amplitude_deg = 0.5\nelevation_period_s = 4\nduration_s = 8',
        )
    ):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "plan.toml").write_text(f'title = "Still"\n[[segment]]\n{segments}\n')
        marked = marking.mark_submission(folder)
        assert marked.mark.points == 0.0
        assert marked.mark.reason.startswith("the plan only holds: its setpoints move by ")
        assert not marked.may_fly
    assert load_plan("hover").setpoint_range_deg == 0.0
    assert load_plan("step").setpoint_range_deg > 2.0


def test_the_page_states_every_number_that_limits_the_points() -> None:
    page = (ROOT / "docs" / "tutorials" / "teaching.md").read_text()
    for measure, weight in WEIGHTS.items():
        (row,) = [line for line in page.splitlines() if f"| `{measure}` |" in line]
        cells = [cell.strip() for cell in row.split("|")]
        assert float(cells[3]) == weight
        assert float(cells[4].split()[0]) == FLOORS[measure]
    assert f"less than {MIN_MOTION_deg:g} degrees is refused" in page


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--effect", "rotor_lga=0.1"), "did you mean rotor_lag?"),
        (("--port", "/dev/no-such-port"), "cannot open port /dev/no-such-port"),
    ],
)
def test_a_wrong_option_is_no_fault_of_a_submission(
    options: tuple[str, ...], message: str, tmp_path: Path, in_process: Any
) -> None:
    make_class(tmp_path / "class", count=1, names=[], duration_s=5.0)
    before = digest(tmp_path / "class")
    code, text = in_process(["class", str(tmp_path / "class"), "--duration", "5", *options])
    assert code != 0 and message in text and text.count("\n") == 1
    assert digest(tmp_path / "class") == before and not list(tmp_path.rglob("mark*.*"))


def test_points_fall_with_each_number() -> None:
    for name in ("settling_s", "overshoot_percent", "travel_rms_deg", "effort_V"):
        points = [
            points_of(replace(REFERENCE, **{name: factor * getattr(REFERENCE, name)}), REFERENCE)
            for factor in (1.0, 2.0, 4.0, 12.0)
        ]
        assert points == sorted(points, reverse=True) and len(set(points)) == 4, name


def test_a_mark_is_the_mean_of_the_flights_and_names_each_reason() -> None:
    mark = mark_of("ann", [REFERENCE, replace(REFERENCE, ended="voltage_jump")], [REFERENCE, REFERENCE])
    assert (mark.points, mark.reason) == (5.0, "voltage_jump")


def test_a_folder_named_like_a_formula_is_quoted_in_the_marks(tmp_path: Path, in_process: Any) -> None:
    (tmp_path / "class" / "=1+1").mkdir(parents=True)
    code, text = in_process(["class", str(tmp_path / "class"), "--duration", "5"])
    assert code == 0, text
    assert (tmp_path / "class" / "marks.csv").read_text().splitlines()[1].startswith("'=1+1,0.0,")


@pytest.mark.parametrize("sign", ["=", "+", "-", "@"])
def test_no_text_of_the_marks_is_a_formula(sign: str, tmp_path: Path) -> None:
    formula = f"{sign}cmd|' /C calc'!A0"
    _write_marks([Mark(formula, reason=formula, rig=formula)], tmp_path / "marks.csv")
    [row] = csv.DictReader((tmp_path / "marks.csv").read_text().splitlines())
    assert [row[name] for name in ("submission", "reason", "rig")] == 3 * [f"'{formula}"]


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
