"""A simulated hand calibrates rigs with wrong wires; unclear movements are refused; all ends at 0 V."""

import json
from collections.abc import Callable
from dataclasses import replace
from math import nan
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.data.log.reader import read_log
from heli_host.declaration import AXES, State
from heli_host.errors import FlightAborted, HeliError, LinkError
from heli_lab.errors import CalibrationError
from heli_lab.setup.calibrate.calibration import BenchCalibration, calibrate, set_parameters
from heli_lab.setup.calibrate.encoders import calibrate_encoders
from heli_lab.setup.calibrate.motors import Pulse, PulseLimits, ThrustLine, response_design, thrust_of
from heli_lab.setup.calibrate.operator import HandAction, SimulatedOperator, TerminalOperator
from heli_sim.rig import load_rig, write_rig
from heli_sim.sil.faults import FaultPlan, Span
from heli_sim.sil.world import SilWorld

from tests.cli.terminal import Terminal, refusal
from tests.rig.miswired import (
    ALL,
    DEAD_ZONE_V,
    FEW,
    GAIN_SHARE,
    HIDDEN,
    Wires,
    bench,
    calibrated,
    errors_of,
    stops_while_driven,
    true_rig,
    wires_found,
)

pytestmark = pytest.mark.medium

PAPER = "makki2024"
RIG = load_rig(PAPER)
RISING = {
    PAPER: PulseLimits(0.88, max_V=1.3, max_angle_deg=20.0),
    "quanser-course": PulseLimits(0.5, max_V=1.0, max_angle_deg=20.0),
}
WRONG = Wires((-1, -1, -1), (-1, -1))


@pytest.mark.parametrize("wires", ALL[7::19], ids=str)
def test_wrong_signs_and_exchanged_plugs_are_all_found(tmp_path: Path, wires: Wires) -> None:
    assert wires_found(calibrated(tmp_path, PAPER, wires, FEW)) == wires


@pytest.mark.parametrize("name", HIDDEN)
def test_thrust_and_dead_zone_are_within_their_tolerances(tmp_path: Path, name: str) -> None:
    result = calibrated(tmp_path, name, Wires(motors=(-1, 1)), RISING[name])
    gain_share, dead_zone_V = errors_of(result, name)
    assert abs(gain_share) < GAIN_SHARE
    assert abs(dead_zone_V) < DEAD_ZONE_V
    # The rig file's tolerance holds the error, and is not a mere repetition of the old one.
    gain = result.rig["thrust_gain"]
    assert (
        abs(gain.value - HIDDEN[name]["thrust_gain"])
        < gain.tolerance
        != load_rig(name)["thrust_gain"].tolerance
    )


@pytest.mark.parametrize("difference_kg", [0.002, -0.005])
def test_rotors_that_differ_by_some_grams_are_calibrated(tmp_path: Path, difference_kg: float) -> None:
    """Such a short arm drifts away from level, and never comes to rest there."""
    rig = load_rig("makki2024")
    unequal = rig.replace(M_f=rig["M_f"].value + difference_kg / 2, M_b=rig["M_b"].value - difference_kg / 2)
    write_rig(unequal, tmp_path / "unequal.toml")
    with bench(tmp_path / "unequal.toml") as (heli, _, operator):
        result = calibrate(heli, operator, unequal)
    for motor in result.motors:
        assert isinstance(motor.thrust, ThrustLine)
        assert motor.thrust.gain_N_per_V == pytest.approx(rig["thrust_gain"].value, rel=0.05)
        assert motor.thrust.dead_zone_V == pytest.approx(rig["dead_zone"].value, abs=0.05)


def test_a_rig_with_all_signs_wrong_flies_after_its_calibration(tmp_path: Path) -> None:
    with bench(true_rig(tmp_path, PAPER, WRONG), WRONG) as (heli, _, operator):
        result = calibrate(heli, operator, RIG, FEW)
        set_parameters(heli, operator, result.parameters)
        assert heli.params["motor_back_sign"] == -1.0
        heli.take_off(elevation_deg=-10.0)
        heli.setpoint(travel_deg=15.0)
        heli.wait(6.0)
        assert heli.latest.travel_deg == pytest.approx(15.0, abs=5.0)
        heli.land()


@pytest.fixture(scope="module")
def exchanged(tmp_path_factory: pytest.TempPathFactory) -> BenchCalibration:
    """Calibration of a rig whose motors are exchanged, with few pulses."""
    return calibrated(tmp_path_factory.mktemp("exchanged"), PAPER, Wires(swapped=True), FEW)


def test_the_level_arm_gives_the_rest_angle(exchanged: BenchCalibration) -> None:
    rest_deg = exchanged.parameters["elevation_rest_deg"]
    assert rest_deg == pytest.approx(HIDDEN[PAPER]["elevation_min"], abs=0.1)
    assert exchanged.rig["elevation_min"].value == rest_deg


def test_exchanged_motors_set_no_signs_and_say_what_to_do(exchanged: BenchCalibration) -> None:
    assert "motor_front_sign" not in exchanged.parameters
    assert exchanged.notes[0].startswith("the motors are exchanged: swap the plugs of the two motors")


def test_too_few_pulses_keep_the_thrust_of_the_rig_file(exchanged: BenchCalibration) -> None:
    assert exchanged.rig["thrust_gain"] == RIG["thrust_gain"]
    assert any("2 pulses moved pitch, and a line needs 3" in note for note in exchanged.notes)


def test_scattered_pulses_keep_the_thrust_of_the_rig_file() -> None:
    swing = response_design(5.0, 0.5, 0.05)[:, 0]
    scattered = [
        Pulse(volts, swing * size) for volts, size in zip((1.2, 1.3, 1.4, 1.5), (3, 1, 4, 2.9), strict=True)
    ]
    reason = thrust_of(scattered, 1, RIG)
    assert isinstance(reason, str)
    assert reason.startswith("the pulses scatter")


def test_a_slow_rotor_has_the_same_thrust() -> None:
    inertia_over_lever = 0.0546 / 0.275
    for lag_s in (0.0, 0.15):
        swing = response_design(5.8, 0.55, lag_s)[:, 0]
        pulses = [
            Pulse(volts, swing * (volts - 1.0) * 0.6 / inertia_over_lever) for volts in (1.1, 1.2, 1.3, 1.4)
        ]
        line = thrust_of(pulses, 1, RIG)
        assert not isinstance(line, str)
        assert line.gain_N_per_V == pytest.approx(0.6, rel=0.01)
        assert line.dead_zone_V == pytest.approx(1.0, abs=0.002)


class Clumsy(SimulatedOperator):
    """Does other movements than those that the instruction wants."""

    moves: dict[HandAction, tuple[float, float, float]]

    def act(self, action: HandAction) -> None:
        if action in self.moves:
            self._move_to(self.moves[action])
        else:
            super().act(action)


@pytest.mark.parametrize(
    ("moved_rad", "reason"),
    [
        ((-0.436, 0.0, 0.0), "no encoder counted 5 degrees for elevation"),
        ((0.0, 0.3, 0.0), "elevation and pitch moved together"),
        ((-0.436, 0.0, 0.3), "the travel encoder counted when elevation moved"),
    ],
)
def test_a_movement_that_is_not_clear_is_refused(moved_rad: tuple[float, float, float], reason: str) -> None:
    with bench(Path(PAPER)) as (heli, world, _):
        lines: list[str] = []
        operator = Clumsy(heli, world, lines.append)
        operator.moves = {HandAction.LIFT: moved_rad}
        with pytest.raises(CalibrationError, match=reason):
            calibrate_encoders(heli, operator)
        assert sum("then try again" in line for line in lines) == 2
        assert heli.state is State.IDLE


def test_an_arm_on_its_table_gets_no_pulse() -> None:
    with bench(Path(PAPER)) as (heli, world, _):
        operator = Clumsy(heli, world, lambda _: None)
        operator.moves = {HandAction.TIE: (np.radians(-25.0), 0.0, 0.0)}
        with pytest.raises(CalibrationError, match="the arm is still on its table"):
            calibrate(heli, operator, RIG, FEW)
        assert heli.samples().front_V.max() == 0.0


def test_an_output_without_supply_is_named_after_both_signs() -> None:
    with bench(Path(f"{PAPER}&supply_out=0")) as (heli, _, operator):
        with pytest.raises(CalibrationError, match=r"the front output lifts no rotor up to 1\.25 V"):
            calibrate(heli, operator, RIG, FEW)
        assert heli.params["motor_front_sign"] == 1.0


def interrupt(_heli: Heli, _world: SilWorld) -> None:
    raise KeyboardInterrupt


def press_stop(_heli: Heli, world: SilWorld) -> None:
    world.board.sim.set_stop(True)


def unplug(_heli: Heli, world: SilWorld) -> None:
    world.options = replace(world.options, faults=FaultPlan(unplugs=(Span(world.time_s, 100.0),)))


def let_the_arm_go(_heli: Heli, world: SilWorld) -> None:
    world.native.hand_rad = [nan, nan, nan]
    state = world.state
    state[3] = -1.5
    world.state = state


ENDINGS: list[tuple[Callable[[Heli, SilWorld], None], type[BaseException], str]] = [
    (interrupt, KeyboardInterrupt, "^$"),
    (press_stop, FlightAborted, "the board switched the motors off: hardware_stop"),
    (unplug, LinkError, "unplugged|pulled out|not come back"),
    (let_the_arm_go, FlightAborted, "elevation moved by"),
]


@pytest.mark.parametrize(("do", "error", "text"), ENDINGS, ids=[do.__name__ for do, _, _ in ENDINGS])
def test_every_ending_leaves_the_motors_at_0_V(
    do: Callable[[Heli, SilWorld], None], error: type[BaseException], text: str
) -> None:
    limits = replace(FEW, max_angle_deg=8.0)
    with bench(Path(PAPER)) as (heli, world, _):
        before = dict(heli.params)
        lines: list[str] = []
        operator = SimulatedOperator(heli, world, lines.append)
        check = stops_while_driven(world, lambda: do(heli, world))
        with pytest.raises(error, match=text):
            calibrate(heli, operator, RIG, limits, check=check)
        world.advance(600)
        assert world.native.volts_V == [0.0, 0.0]
        if do in (interrupt, let_the_arm_go):
            assert heli.state is State.IDLE
            assert dict(heli.params) == before
        else:
            # The board did not take its former limits back: the user learns it.
            assert any(line.startswith("warning: ") for line in lines), lines


def test_pitch_beyond_its_limit_is_cut_by_the_board_itself() -> None:
    strong = PulseLimits(start_V=3.0, max_V=3.5, max_angle_deg=6.0)
    with bench(Path(PAPER)) as (heli, world, operator):
        with pytest.raises(FlightAborted, match="the board switched the motors off: pitch_limit"):
            calibrate(heli, operator, RIG, strong)
        assert world.native.volts_V == [0.0, 0.0]
        assert np.degrees(np.abs(heli.samples().pitch_rad).max()) < 20.5


class Script:
    """Answers as lines of a pipe; an instruction is done by a simulated hand before its Enter."""

    def __init__(self, hand: SimulatedOperator) -> None:
        self._hand = hand
        self._shown = ""
        self.stop_at = ""

    def show(self, text: str) -> None:
        self._shown = text

    def isatty(self) -> bool:
        return False

    def readline(self) -> str:
        for action in HandAction:
            if self._shown.startswith(action.text):
                self._hand.act(action)
                return "\n"
        if self.stop_at and self.stop_at in self._shown:
            return "stop\n"
        if "which rotor" in self._shown:
            return self._hand.choose("", ("front", "back", "neither"))[0] + "\n"
        return "all\n"


@pytest.mark.parametrize("stop_at", ["", "pulse: back output"])
def test_a_script_answers_as_a_person_at_the_terminal(stop_at: str) -> None:
    with bench(Path(PAPER)) as (heli, world, hand):
        script = Script(hand)
        script.stop_at = stop_at
        operator = TerminalOperator(script, script.show)  # type: ignore[arg-type]
        result: BenchCalibration | HeliError
        try:
            result = calibrate(heli, operator, RIG, FEW)
        except HeliError as error:
            result = error
        assert world.native.volts_V == [0.0, 0.0]
    if stop_at:
        assert str(result).startswith("the operator stopped the calibration")
    else:
        assert isinstance(result, BenchCalibration)
        assert not result.motors_exchanged


def test_without_motors_no_voltage_is_given(tmp_path: Path) -> None:
    wires = Wires(encoders=(1, -1, -1))
    with bench(true_rig(tmp_path, PAPER, wires), wires) as (heli, _, operator):
        result = calibrate(heli, operator, RIG, motors=False)
        assert heli.samples().state.max() == State.IDLE
    assert result.encoders.direction == {"elevation": 1, "pitch": -1, "travel": -1}
    assert set(result.parameters) == {*(f"{axis}_counts_per_rev" for axis in AXES), "elevation_rest_deg"}
    assert result.rig["dead_zone"] == RIG["dead_zone"]


def test_the_verb_writes_rig_parameters_log_and_result(terminal: Terminal) -> None:
    wires = ("--sil", "--miswired", "pitch,swapped", "--max-V", "1.25")
    result = terminal("calibrate", *wires, "--save-params", "p.toml", "--json", "r.json", "--log", "c.mcap")
    assert result.code == 1, result
    assert "note: the motors are exchanged" in result.out
    assert load_rig("makki2024-calibrated.toml")["encoder_direction_pitch"].value == -1.0
    assert "pitch_counts_per_rev = -4096" in Path("p.toml").read_text(encoding="utf-8")
    content = json.loads(Path("r.json").read_text(encoding="utf-8"))
    assert content["motors_exchanged"]
    assert content["saved"]
    front_V = read_log(Path("c.mcap")).flight().front_V
    assert max(front_V) == pytest.approx(1.2, abs=0.01)
    again = refusal(terminal("calibrate", *wires), code=2)
    assert "makki2024-calibrated.toml exists already; give another --save-rig" in again


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (
            ("--sil", "--max-V", "9"),
            "pulses from 0.5 to 9 V are not possible; give a --max-V above 0.5 and up to 6",
        ),
        (("--sil", "--miswired", "roll"), "unknown --miswired 'roll'; choose elevation, pitch"),
        (("--port", "/dev/none"), "no rig is named, and thrust needs its inertia; add --rig FILE"),
        (("--port", "/dev/none", "--miswired", "pitch"), "--miswired is for a simulated board only"),
    ],
)
def test_a_wrong_request_is_one_line(terminal: Terminal, arguments: tuple[str, ...], text: str) -> None:
    result = terminal("calibrate", *arguments)
    assert text in refusal(result, code=result.code)
    assert result.code in (2, 4)
    assert not list(Path().glob("*.toml"))
