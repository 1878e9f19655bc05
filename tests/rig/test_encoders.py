"""Encoders in a rig file: counts and direction of each, the form of older files, and a board with them."""

from functools import cache
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.board.parameters import parameters_text, read_parameter_set
from heli_host.board.rig_check import BoardProperty, check_rig, rig_differences, rig_parameters
from heli_host.declaration import AXES
from heli_host.errors import RigMismatch
from heli_lab.control.tune import find_gains
from heli_lab.control.tune.trial import try_gains
from heli_lab.diagnose import diagnose
from heli_lab.fit.identification import identify
from heli_lab.fit.records import prepare
from heli_lab.verbs.tune import rounded_parameters
from heli_sim.errors import RigError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig, rig_text, write_rig
from heli_sim.rig.board import rig_of_board
from heli_sim.rig.rig import counts_per_turn, direction_is_known, directions
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.transport import SilProcess

from tests.cli.terminal import Terminal
from tests.identify.made import flown, thinned

ODD = {"encoder_counts_pitch": 1000.0, "encoder_direction_elevation": -1.0, "encoder_direction_pitch": 1.0}
"""An encoder of 250 lines on pitch, and one on elevation that counts down; nobody looked at travel."""
TRUTH = {"thrust_gain": 0.62, "friction_travel": 0.05}


def odd_rig(**values: float) -> Rig:
    return load_rig("makki2024").replace(**ODD, **values)


def with_entries(folder: Path, entries: str) -> Path:
    """The paper's rig with other entries for its encoders."""
    text = rig_text(load_rig("makki2024"))
    path = folder / "mine.toml"
    path.write_text(text[: text.index("[encoder_counts_elevation]")] + entries)
    return path


def entry(name: str, value: float, unit: str = "count", tolerance: float = 0.0) -> str:
    return f'[{name}]\nvalue = {value}\nunit = "{unit}"\ntolerance = {tolerance}\nsource = "its data sheet"\n'


@pytest.mark.parametrize(
    ("entries", "counts"),
    [
        (entry("encoder_counts", 2000.0), (2000.0, 2000.0, 2000.0)),
        (entry("encoder_counts", 4096.0) + entry("encoder_travel_ratio", 2.0, "1"), (4096.0, 4096.0, 8192.0)),
        (entry("encoder_counts", 4096.0) + entry("encoder_counts_pitch", 1000.0), (4096.0, 1000.0, 4096.0)),
    ],
    ids=["one number", "one number and a ratio", "one number and an exception"],
)
def test_a_file_with_one_number_for_all_encoders_is_read(
    tmp_path: Path, entries: str, counts: tuple[float, ...]
) -> None:
    rig = load_rig(with_entries(tmp_path, entries))
    assert tuple(counts_per_turn(rig)) == counts
    assert tuple(directions(rig)) == (1.0, 1.0, 1.0)
    assert not any(direction_is_known(rig))
    write_rig(rig, tmp_path / "again.toml")
    assert load_rig(tmp_path / "again.toml") == rig


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        (entry("encoder_counts_pitch", 1000.0), "lacks encoder_counts_elevation, encoder_counts_travel"),
        (entry("encoder_counts", 0.0), "encoder_counts_elevation must not be 0"),
        (entry("encoder_counts", -4096.0), "encoder_counts_elevation = -4096.0 must not be negative"),
        (entry("encoder_counts", 4096.0) + entry("encoder_travel_ratio", 2.0), "give it in '1'"),
        (entry("encoder_travel_ratio", 2.0, "1"), "has no parameter 'encoder_travel_ratio'"),
        (
            entry("encoder_counts", 4096.0) + entry("encoder_direction_pitch", 0.5, "1"),
            "encoder_direction_pitch = 0.5 is not a direction; give 1, -1, or 0",
        ),
        (
            entry("encoder_counts", 4096.0) + entry("encoder_direction_pitch", 1.0, "1", 0.1),
            "encoder_direction_pitch has the tolerance 0.1; a direction is exact",
        ),
    ],
)
def test_encoders_that_cannot_be_are_refused(tmp_path: Path, entries: str, says: str) -> None:
    with pytest.raises(RigError, match=says):
        load_rig(with_entries(tmp_path, entries))


def test_a_new_rig_has_the_stated_encoders_and_no_direction_of_another_rig(
    terminal: Terminal, tmp_path: Path
) -> None:
    write_rig(odd_rig(), tmp_path / "other.toml")
    sets = ("encoder_counts=2000", "encoder_counts_pitch=1000", "encoder_direction_travel=-1")
    words = [word for stated in sets for word in ("--set", stated)]
    result = terminal("rig", "new", "mine.toml", "--like", "other.toml", *words)
    assert result.code == 0, result
    rig = load_rig("mine.toml")
    assert tuple(counts_per_turn(rig)) == (2000.0, 1000.0, 2000.0)
    assert direction_is_known(rig) == (False, False, True)
    assert tuple(directions(rig)) == (1.0, 1.0, -1.0)


def test_on_hardware_only_a_stated_direction_is_compared(tmp_path: Path) -> None:
    write_rig(odd_rig(), tmp_path / "mine.toml")
    rig = rig_parameters(str(tmp_path / "mine.toml"))
    board = {
        "elevation_counts_per_rev": 4096.0,
        "pitch_counts_per_rev": 4096.0,
        "travel_counts_per_rev": -4096.0,
    }
    differences = rig_differences(rig.values, board, simulated=False, directed=rig.directed)
    assert [(difference.parameter, difference.part) for difference in differences] == [
        ("elevation_counts_per_rev", BoardProperty.DIRECTION),
        ("pitch_counts_per_rev", BoardProperty.SCALE),
    ]
    with pytest.raises(RigMismatch) as refused:
        check_rig(rig.values, board, simulated=False, directed=rig.directed)
    assert "params set elevation_counts_per_rev -4096 --save" in str(refused.value)
    assert "params set pitch_counts_per_rev 1000 --save" in str(refused.value)


def test_rig_check_compares_counts_and_signs_with_a_board(terminal: Terminal, tmp_path: Path) -> None:
    write_rig(odd_rig(), tmp_path / "mine.toml")
    right = {
        "elevation_counts_per_rev": -4096.0,
        "pitch_counts_per_rev": 1000.0,
        "travel_counts_per_rev": -4096.0,
    }
    (tmp_path / "right.toml").write_text(parameters_text(right, "a board"))
    (tmp_path / "wrong.toml").write_text(
        parameters_text(
            right | {"elevation_counts_per_rev": 4096.0, "pitch_counts_per_rev": 4096.0}, "a board"
        )
    )
    fits = terminal("rig", "check", "mine.toml", "--params", "right.toml")
    assert fits.code == 0, fits
    assert "mine.toml: the board's parameters fit" in fits.out
    assert "states no encoder direction of travel: signs not compared" in fits.out
    result = terminal("rig", "check", "mine.toml", "--params", "wrong.toml")
    assert result.code == 1
    assert "elevation_counts_per_rev is 4096 count, but the rig has -4096 count" in result.out
    assert "pitch_counts_per_rev is 4096 count, but the rig has 1000 count" in result.out


@pytest.mark.medium
def test_a_rig_with_a_coarse_and_a_reversed_encoder_flies_where_its_log_says(tmp_path: Path) -> None:
    write_rig(odd_rig(), tmp_path / "mine.toml")
    with heli_host.connect(f"sil://?rig={tmp_path / 'mine.toml'}") as heli:
        assert heli.params["elevation_counts_per_rev"] == -4096.0
        assert heli.params["pitch_counts_per_rev"] == 1000.0
        heli.take_off()
        heli.setpoint(elevation_deg=5.0, travel_deg=8.0)
        heli.wait(9.0)
        transport, sample = heli.session.transport, heli.latest
        assert isinstance(transport, InProcessTransport)
        true_deg = np.rad2deg(transport.world.state[:3])
    logged_deg = np.array([sample.elevation_deg, sample.pitch_deg, sample.travel_deg])
    assert np.all(np.abs(true_deg - logged_deg) < (0.1, 0.37, 0.1))
    assert abs(true_deg[0] - 5.0) < 0.5


@cache
def odd_flights() -> tuple[heli_host.Flight, heli_host.Flight]:
    """One to fit and one held out, of a rig whose thrust lags, at 500 Hz, as their logs have them."""
    model = MultibodyModel(parse_effects(["rotor_lag=0.08"]))
    first, second = (
        thinned(flown(odd_rig(**TRUTH), seed, s, model), 2) for seed, s in ((11, 18.0), (12, 14.0))
    )
    return first, second


@pytest.mark.slow
def test_such_a_rig_is_identified_with_its_counts() -> None:
    flight, _ = odd_flights()
    # The rig file that an analysis starts from may have other encoders: the log's count.
    assert prepare(flight, load_rig("makki2024")).count_rad == pytest.approx(
        2.0 * np.pi / np.array([4096.0, 1000.0, 4096.0])
    )
    lag = MultibodyModel(parse_effects(["rotor_lag"]))
    result = identify(lag, odd_rig(), [flight])
    for name, value in {**TRUTH, "rotor_lag_s": 0.08}.items():
        assert result.fit.params[name] == pytest.approx(value, abs=3.0 * result.fit.std[name]), name
    # Residuals are in counts: a wrong count is far from 1.
    assert result.json()["normalised_residual"]["train"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_such_a_rig_is_tuned_and_its_gains_keep_the_signs() -> None:
    design = find_gains(odd_rig())
    parameters = rounded_parameters(design.parameters)
    assert parameters["elevation_counts_per_rev"] == -4096.0
    assert parameters["pitch_counts_per_rev"] == 1000.0
    # Nobody stated travel's direction, so the board's sign stays.
    assert "travel_counts_per_rev" not in parameters
    trial = try_gains(Plant(MultibodyModel(), odd_rig()), parameters, "odd")
    assert trial.metrics.outcome == "completed"
    assert trial.metrics.overshoot_percent <= 12.0
    assert trial.metrics.travel_rms_deg <= 1.0
    assert trial.metrics.elevation_rms_deg <= 0.1


@pytest.mark.diagnosis
def test_the_cause_is_found_on_such_a_rig() -> None:
    fit, held_out = odd_flights()
    diagnosis = diagnose(MultibodyModel(), odd_rig(), [fit], [held_out])
    (cause,) = diagnosis.verdict.causes
    assert cause.effect == "rotor_lag"
    assert cause.parameters["rotor_lag_s"].value == pytest.approx(0.08, abs=0.01)


def test_a_board_and_a_rig_file_convert_into_each_other(terminal: Terminal, tmp_path: Path) -> None:
    write_rig(odd_rig(encoder_direction_travel=1.0, supply=9.0, elevation_min=-20.0), tmp_path / "mine.toml")
    result = terminal("rig", "to-board", "mine.toml", "board.toml")
    assert result.code == 0, result
    assert terminal("rig", "check", "mine.toml", "--params", "board.toml").code == 0
    result = terminal("rig", "from-board", "board.toml", "again.toml")
    assert result.code == 0, result
    mine, again = load_rig("mine.toml"), load_rig("again.toml")
    assert {name: number.value for name, number in again.items()} == {
        name: number.value for name, number in mine.items()
    }
    assert all(direction_is_known(again))
    assert "exists already" in terminal("rig", "from-board", "board.toml", "again.toml").err


def test_what_a_board_does_not_state_is_not_known_of_its_rig() -> None:
    rig = rig_of_board({"pitch_counts_per_rev": -1000.0}, odd_rig(), "mine")
    assert tuple(counts_per_turn(rig)) == (4096.0, 1000.0, 4096.0)
    assert direction_is_known(rig) == (False, True, False)
    assert directions(rig)[1] == -1.0
    with pytest.raises(RigError, match="have none of elevation_counts_per_rev"):
        rig_of_board({"pitch_kp": 1.0}, odd_rig(), "mine")


@pytest.mark.medium
def test_a_board_keeps_the_signs_that_its_rig_does_not_state(terminal: Terminal, tmp_path: Path) -> None:
    write_rig(odd_rig(), tmp_path / "mine.toml")
    with SilProcess() as sil:
        terminal("params", "set", "travel_counts_per_rev", "-2000", "--port", sil.url)
        terminal("params", "dump", "before.toml", "--port", sil.url)
        assert terminal("rig", "to-board", "mine.toml", "to.toml", "--params", "before.toml").code == 0
        assert terminal("params", "restore", "to.toml", "--port", sil.url).code == 0
        terminal("params", "dump", "after.toml", "--port", sil.url)
    after = read_parameter_set(tmp_path / "after.toml").values
    assert [after[f"{axis}_counts_per_rev"] for axis in AXES] == [-4096.0, 1000.0, -4096.0]
    checked = terminal("rig", "check", "mine.toml", "--params", "after.toml")
    assert checked.code == 0, checked
    assert "mine.toml: the board's parameters fit" in checked.out
