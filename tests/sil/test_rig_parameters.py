"""A simulated board starts with the counts, rest angle, supply and limits of its rig."""

from __future__ import annotations

from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.board.rig_check import BoardProperty, rig_differences, rig_parameters
from heli_host.errors import RigMismatch
from heli_sim.due import firmware
from heli_sim.errors import OptionError, RigError
from heli_sim.rig import load_rig, write_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import parse_options

BOARDS = ["native", pytest.param("due", marks=pytest.mark.emulated)]
COARSE = {
    "encoder_counts_elevation": 2000.0,
    "encoder_counts_pitch": 2000.0,
    "encoder_counts_travel": 3000.0,
}
"""An encoder of 500 lines on elevation and pitch, and one of 750 on travel."""


def rig_file(folder: Path, **values: float) -> Path:
    path = folder / "mine.toml"
    write_rig(load_rig("makki2024").replace(**values), path)
    return path


def address_of_board(board: str, rig: Path, **more: str) -> str:
    if board == "due" and not firmware.candidates():
        pytest.skip("no firmware is built")
    return "sil://?" + "&".join(
        f"{key}={value}" for key, value in {"rig": rig, "board": board, **more}.items()
    )


def true_deg(heli: Heli) -> list[float]:
    transport = heli.session.transport
    assert isinstance(transport, InProcessTransport)
    return [float(angle) for angle in np.rad2deg(transport.world.state[:3])]


@pytest.mark.medium
@pytest.mark.parametrize("board", BOARDS)
def test_a_simulated_board_starts_with_what_its_rig_determines(board: str, tmp_path: Path) -> None:
    rig = rig_file(tmp_path, **COARSE, elevation_min=-20.0, supply=9.0, elevation_max=20.0, pitch_max=36.0)
    with heli_host.connect(address_of_board(board, rig)) as heli:
        assert heli.info.params_source == "stored"
        wanted = {
            "elevation_counts_per_rev": 2000.0,
            "pitch_counts_per_rev": 2000.0,
            "travel_counts_per_rev": 3000.0,
            "elevation_rest_deg": -20.0,
            "supply_V": 9.0,
            "motor_max_V": 9.0,
            "elevation_max_deg": 19.0,
            "pitch_max_deg": 31.0,
            "pitch_setpoint_max_deg": 26.0,
            "travel_max_deg": 175.0,
        }
        assert {name: heli.params[name] for name in wanted} == wanted
        heli.arm()


def test_the_default_rig_leaves_the_declared_parameters_alone() -> None:
    with heli_host.connect("sil://") as heli:
        assert heli.info.params_source == "defaults"


@pytest.mark.medium
@pytest.mark.parametrize("board", BOARDS)
def test_a_setpoint_is_reached_in_truth_whatever_the_encoders_count(board: str, tmp_path: Path) -> None:
    with heli_host.connect(address_of_board(board, rig_file(tmp_path, **COARSE))) as heli:
        heli.take_off()
        heli.setpoint(elevation_deg=5.0, travel_deg=8.0)
        heli.wait(9.0)
        elevation_deg, _, travel_deg = true_deg(heli)
        sample = heli.latest
    # A count is 0.18 deg: at half the counts of before, the true angles were twice those of the log.
    assert abs(elevation_deg - sample.elevation_deg) < 0.4 and abs(elevation_deg - 5.0) < 1.0
    assert abs(travel_deg - sample.travel_deg) < 0.4 and abs(travel_deg - 8.0) < 1.5


@pytest.mark.parametrize(
    ("name", "value"),
    [("travel_counts_per_rev", 2000.0), ("travel_counts_per_rev", -4096.0), ("motor_front_sign", -1.0)],
)
def test_a_simulated_board_with_a_wrong_scale_or_sign_does_not_arm(name: str, value: float) -> None:
    with heli_host.connect("sil://") as heli:
        heli.params[name] = value
        with pytest.raises(RigMismatch, match=f"{name} is {value:g}.*leave {name} out"):
            heli.arm()
        assert heli.state is heli_host.State.IDLE


def test_parameters_in_a_flash_file_hold_and_are_compared(tmp_path: Path) -> None:
    flash, rig = tmp_path / "flash.bin", rig_file(tmp_path, **COARSE)
    with heli_host.connect(f"sil://?flash={flash}") as heli:
        heli.params.save()
    with heli_host.connect(f"sil://?flash={flash}&rig={rig}") as heli:
        assert heli.params["travel_counts_per_rev"] == 4096.0
        with pytest.raises(RigMismatch, match="travel_counts_per_rev is 4096 count, but the rig has 3000"):
            heli.take_off()


def test_a_rig_that_no_board_can_be_set_to_is_refused(tmp_path: Path) -> None:
    rig = rig_file(tmp_path, encoder_counts_elevation=70_000.0)
    with pytest.raises(RigError, match="needs elevation_counts_per_rev = 70000, and the board takes"):
        heli_host.connect(f"sil://?rig={rig}")


def test_on_hardware_a_sign_is_wiring_and_each_part_is_named() -> None:
    stated = rig_parameters("makki2024").values
    board = {
        **stated,
        "pitch_counts_per_rev": -4096.0,
        "travel_counts_per_rev": -2000.0,
        "elevation_rest_deg": -27.5,
        "supply_V": 9.0,
        "elevation_max_deg": 40.0,
    }
    parts = {
        difference.parameter: difference.part
        for difference in rig_differences(stated, board, simulated=False)
    }
    assert parts == {
        "travel_counts_per_rev": BoardProperty.SCALE,
        "elevation_rest_deg": BoardProperty.REST,
        "supply_V": BoardProperty.SUPPLY,
        "elevation_max_deg": BoardProperty.LIMIT,
    }
    simulated = rig_differences(stated, board, simulated=True)
    assert simulated[0].parameter == "pitch_counts_per_rev" and simulated[0].part is BoardProperty.DIRECTION


@pytest.mark.medium
def test_an_encoder_with_another_scale_counts_otherwise_and_nothing_says_so() -> None:
    with heli_host.connect("sil://?encoder_scale=travel:0.5,elevation:1.01") as heli:
        assert heli.params["travel_counts_per_rev"] == 4096.0
        heli.take_off()
        heli.setpoint(travel_deg=4.0)
        heli.wait(6.0)
        elevation_deg, _, travel_deg = true_deg(heli)
        sample = heli.latest
    assert abs(travel_deg - sample.travel_deg / 0.5) < 0.3 and travel_deg > 5.0
    assert abs((elevation_deg + 25.0) * 1.01 - (sample.elevation_deg + 25.0)) < 0.15


@pytest.mark.parametrize("text", ["roll:0.5", "travel:0", "travel:nan", "travel:x", "travel"])
def test_a_scale_that_means_nothing_is_refused(text: str) -> None:
    with pytest.raises(OptionError):
        parse_options({"encoder_scale": text})
