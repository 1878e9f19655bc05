"""Faults: the table of the documents, a share of the sweep, and healthy flights that show no fault."""

import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.parameters import load_gains
from heli_host.declaration import PARAMS, Axes, Fault, State
from heli_host.errors import HeliError
from heli_host.fly.connection import connect
from heli_host.fly.plan import Plan, load_plan
from heli_host.fly.runner import fly
from heli_host.fly.tracking import NOT_TRACKED
from heli_sim.rig import write_rig

from tests.firmware.built import built_elf
from tests.fly import plug_sweep
from tests.fly.fault_sweep import HEAD as SWEEP_HEAD
from tests.fly.fault_sweep import LEFT_DEG, swept
from tests.fly.fault_sweep import Case as SweptCase
from tests.fly.fault_sweep import flown as fly_with_fault
from tests.fly.fault_table import CASES, ELSEWHERE, HEAD, Case, Outcome, flown, row
from tests.fly.plug_sweep import random_rig
from tests.fly.travel_checks import hover
from tests.running.long import LONG, samples, select_cases

pytest.importorskip("heli_sim._native", reason="skipped: the simulation is not built")

flown_with_fault = cache(fly_with_fault)
DOCUMENT = Path("docs/reference/failures.md")
TESTS = Path(__file__).parent
NATIVE = select_cases([case for case in CASES if not case.due_only], every=3)
# Flown on the emulated Due in `make test`: what only it has, and a loss of power. Another test here flies it
# without the travel encoder, and what the host does is the same with any board.
EMULATED = [case for case in CASES if case.due_only or LONG or case.what == "the board loses its power"]
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def document() -> list[str]:
    """Rows of the table."""
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    begin = lines.index(HEAD) + 2
    end = next(k for k in range(begin, len(lines)) if not lines[k].startswith("|"))
    return lines[begin:end]


def assert_agrees_with_document(case: Case, outcome: Outcome) -> None:
    """The document's row has the same words, and numbers within a tenth of a second or 2 %."""
    [document_row] = [line for line in document() if line.startswith(f"| {case.what} |")]
    flown_row = row(case, outcome)
    assert NUMBER.sub("#", document_row) == NUMBER.sub("#", flown_row)
    for written, measured in zip(NUMBER.findall(document_row), NUMBER.findall(flown_row), strict=True):
        near_s = 0.1 if float(measured) > 1.0 else 0.02
        assert float(written) == pytest.approx(float(measured), rel=0.02, abs=near_s), flown_row


def assert_handled(case: Case, outcome: Outcome) -> None:
    assert outcome.acted_s <= case.within_s
    assert case.says in outcome.says
    assert outcome.volts_V == [0.0, 0.0]
    # Latched: nothing turns again before it is cleared.
    assert not case.says.startswith("fault") or outcome.state == State.FAULT


def test_every_row_of_the_table_is_shown_by_a_flight_or_a_test() -> None:
    first_cells = [line.split(" | ")[0].removeprefix("| ") for line in document()]
    assert first_cells == [case.what for case in CASES] + list(ELSEWHERE)
    tests = "".join(path.read_text(encoding="utf-8") for path in TESTS.glob("test_*.py"))
    for name in ELSEWHERE.values():
        assert f"def {name}(" in tests


@pytest.mark.slow
@pytest.mark.parametrize("case", NATIVE, ids=lambda case: str(case.what))
def test_a_fault_is_handled_as_the_table_says(case: Case) -> None:
    outcome = flown(case)
    assert_handled(case, outcome)
    assert_agrees_with_document(case, outcome)


@pytest.mark.emulated
@pytest.mark.parametrize("case", EMULATED, ids=lambda case: str(case.what))
def test_a_fault_is_handled_by_the_emulated_due_as_the_table_says(case: Case) -> None:
    outcome = flown(case, "due", str(built_elf()))
    assert_handled(case, outcome)
    assert_agrees_with_document(case, outcome)


def test_without_a_cable_the_board_does_what_it_does_without_a_host() -> None:
    off_s = {line.split(" | ")[0]: line.partition("motors off after ")[2] for line in document()}
    off_text = off_s["| the host is killed (`kill -9`)"].partition(" |")[0]
    for case in CASES:
        if case.as_if is not None:
            assert off_s[f"| {case.what}"].partition(" |")[0] == off_text


SWEEP_DOCUMENT = Path("docs/validation/faults.md")
TRAVEL = (
    SweptCase("paper", "drift", "travel", 10.5),
    SweptCase("paper", "sine", "travel", 64.5),
    SweptCase("course", "sine", "travel", 20.3),
)
# Where an arm without its encoder touched its upper stop, or took longest to be noticed. The last one is 33
# degrees off when it is named: no tilt asks while pitch is nearly still.
OTHERS = (
    SweptCase("paper", "sine", "elevation", 57.0),
    SweptCase("paper", "sine", "pitch", 45.75),
    SweptCase("identified", "step", "travel", 10.0),
)


@pytest.mark.slow
@pytest.mark.parametrize("case", TRAVEL, ids=lambda case: f"{case.rig}-{case.plan}")
def test_a_dead_travel_encoder_is_named_before_travel_is_far_off(case: SweptCase) -> None:
    outcome = flown_with_fault(case)
    assert outcome.tracking_fault == "travel_motionless"
    assert outcome.away_deg < LEFT_DEG
    assert not outcome.stop


@pytest.mark.slow
@pytest.mark.parametrize("case", OTHERS, ids=lambda case: str(case.kind))
def test_an_axis_without_its_encoder_is_stopped_before_its_stop(case: SweptCase) -> None:
    outcome = flown_with_fault(case)
    assert outcome.tracking_fault == f"{case.kind}_motionless"
    assert not outcome.stop


@pytest.mark.emulated
def test_the_emulated_due_names_a_dead_travel_encoder_as_soon_as_the_native_board() -> None:
    native, due = flown_with_fault(TRAVEL[0]), flown_with_fault(TRAVEL[0], "due", str(built_elf()))
    assert due.tracking_fault == "travel_motionless"
    assert due.acted_s == pytest.approx(native.acted_s, abs=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case",
    [SweptCase("play and friction", "identify"), SweptCase("friction", "drift")][: samples(2, 1)],
    ids=lambda case: str(case.rig),
)
def test_dry_friction_and_play_are_not_taken_for_a_dead_encoder(case: SweptCase) -> None:
    assert flown_with_fault(case).outcome == "completed"


def numbers_of_document() -> dict[str, list[float]]:
    """Numbers of the table's rows, by what fails."""
    lines = SWEEP_DOCUMENT.read_text(encoding="utf-8").splitlines()
    begin = lines.index(SWEEP_HEAD) + 2
    rows = lines[begin : next(k for k in range(begin, len(lines)) if not lines[k].startswith("|"))]
    return {row.split(" ")[2]: [float(x) for x in re.findall(r"[\d.]+", row)] for row in rows}


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["elevation", "pitch", "travel"])
def test_a_flight_of_the_sweep_is_within_the_worst_of_the_document(kind: str) -> None:
    count, _, within_s, off_deg, *_ = numbers_of_document()[kind]
    for case in [*swept(kind, int(count))][: samples(int(count), 3)][0 if LONG else 2 :]:
        outcome = flown_with_fault(case)
        if outcome.reported:
            assert outcome.acted_s <= within_s + 0.05
            assert outcome.away_deg <= off_deg + 0.5


@pytest.mark.medium
def test_only_checks_of_its_encoder_move_a_healthy_arm_and_by_less_than_four_degrees() -> None:
    checked, unchecked = hover("", seed=1), hover("", seed=1, silence_s=0.0)
    assert checked.checks > 0
    assert unchecked.checks == 0
    assert unchecked.largest_deg < 0.5 < checked.largest_deg < 4.0


@pytest.mark.slow
def test_no_flight_with_a_loose_plug_is_completed_at_a_wrong_angle() -> None:
    for case in plug_sweep.loose(4, seed=5):
        flight = plug_sweep.flown(case)
        elevation_and_pitch_deg = flight.wrong_deg[:2]
        assert not flight.completed or max(map(abs, elevation_and_pitch_deg)) <= plug_sweep.WRONG_DEG


@pytest.mark.slow
def test_without_the_elevation_encoder_the_arm_is_lowered_not_dropped() -> None:
    [case] = plug_sweep.dead("elevation", 1, seed=5)
    flight = plug_sweep.flown(case)
    assert flight.name == "elevation_motionless"
    assert flight.drop_deg <= plug_sweep.DROP_DEG


OFF = {
    spec.name: spec.max
    for spec in PARAMS
    if spec.name.endswith(("_following_max_deg", "_motion_V", "travel_motion_deg"))
}
"""Parameters with which no following error and no drive without motion trips."""
NEW = frozenset(fault for fault in Fault if fault.name.endswith(("_FOLLOWING", "_MOTIONLESS")))
EVERY_AXIS = Plan.parse(
    """
[start]
settle_s = 2
[[segment]]
kind = "sine"
elevation_amplitude_deg = 6
elevation_period_s = 7
travel_amplitude_deg = 15
travel_period_s = 14
duration_s = 14
[[segment]]
kind = "step"
travel_deg = 15
elevation_deg = 6
duration_s = 5
""",
    "every axis",
)


@pytest.mark.slow
def test_an_emergency_landing_is_left_by_stop_only_and_nothing_is_flown_on(tmp_path: Path) -> None:
    with connect("sil://?speed=max&encoder_out=travel:3") as heli:
        heli.arm()
        heli.control()
        heli.setpoint(elevation_deg=0.0)
        heli.wait(6.0)
        heli.setpoint(travel_deg=40.0)
        heli.wait_until(lambda sample: sample.state is State.EMERGENCY_LANDING, 20.0)
        with pytest.raises(HeliError, match="emergency_landing"):
            heli.control()
        heli.wait_until(lambda sample: sample.state is State.FAULT, 20.0)
        assert heli.latest.fault is Fault.TRAVEL_MOTIONLESS


def outcome(
    rig: Path | str, plan: Plan, prepare: dict[str, float], log: Path, gains: str | None = None
) -> str:
    log.unlink(missing_ok=True)
    with connect(f"sil://?rig={rig}&seed=3&speed=max") as heli:
        load_gains(heli.params, gains)
        for name, value in prepare.items():
            heli.params[name] = value
        return fly(heli, plan, log_path=log).outcome


def tripped(text: str) -> bool:
    return any(fault.name.lower() in text for fault in NEW)


# Each plan and each set of gains once in `make test`.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("plan", "gains"),
    [("step", None), ("identify", "paper"), ("step", "paper"), ("identify", None)][: samples(4, 2)],
)
def test_no_built_in_plan_trips_on_the_papers_rig(plan: str, gains: str | None, tmp_path: Path) -> None:
    text = outcome("makki2024", load_plan(plan), {}, tmp_path / "a.mcap", gains)
    assert not tripped(text)
    assert gains is not None or text == "completed"


@pytest.mark.slow
def test_no_healthy_flight_of_a_random_rig_trips(tmp_path: Path) -> None:
    chance = np.random.default_rng(12)
    healthy = 0
    for number in range(samples(200, 4)):
        rig = random_rig("makki2024", chance)
        if rig is None:
            continue
        path = tmp_path / "rig.toml"
        path.unlink(missing_ok=True)
        write_rig(rig, path)
        text = outcome(path, EVERY_AXIS, {}, tmp_path / "a.mcap")
        if tripped(text):
            without = outcome(path, EVERY_AXIS, OFF, tmp_path / "a.mcap")
            assert without != "completed", f"seed 12, rig {number}: {text}"
        healthy += text == "completed"
    assert healthy >= 0.8 * samples(200, 4)


@pytest.mark.slow
def test_a_hover_that_hangs_low_is_not_tracked(tmp_path: Path) -> None:
    weak = {"elevation_integral_max_V": 0.0, "hover_V": 0.8, "elevation_kp": 0.03}
    text = outcome("makki2024", load_plan("hover"), weak, tmp_path / "a.mcap")
    assert text.startswith(f"{NOT_TRACKED}: elevation was up to")
    wide = Plan.parse(load_plan("hover").text + "\n[tolerance]\nelevation_deg = 20\n", "wide")
    assert outcome("makki2024", wide, weak, tmp_path / "b.mcap") == "completed"


@pytest.mark.slow
def test_a_bench_in_open_loop_is_left_alone() -> None:
    with connect("sil://?speed=max&supply_out=0") as heli:
        heli.arm()
        heli.control(Axes(0), 5.0, 5.0)
        heli.wait(3.0)
        assert heli.state is State.OPEN_LOOP
