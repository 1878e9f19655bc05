"""Effects on the command line: flown where the board is simulated, refused in one line otherwise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.reader import read_flight
from heli_sim.model.effects import catalogue, effect_numbers
from heli_sim.rig import Rig, load_rig, write_rig

from tests.cli.terminal import Terminal

pytestmark = pytest.mark.medium

SIL = ("--sil", "--speed", "max")


@pytest.mark.slow
def test_an_effect_changes_the_flight_and_the_seed_its_chance(terminal: Terminal, tmp_path: Path) -> None:
    gusts = ("--effect", "random_torque.travel=0.02")
    flights = {
        "plain": (),
        "lag": ("--effect", "rotor_lag=0.1"),
        "gusts": gusts,
        "again": gusts,
        "other": (*gusts, "--seed", "2"),
    }
    angles = {}
    for name, options in flights.items():
        log = tmp_path / f"{name}.mcap"
        assert terminal("fly", "hover", *SIL, *options, "--log", log).code == 0
        angles[name] = read_flight(log).angles_rad
    rows = min(len(samples) for samples in angles.values())
    np.testing.assert_array_equal(angles["gusts"], angles["again"])
    for first, second in (("plain", "lag"), ("plain", "gusts"), ("gusts", "other")):
        assert np.abs(angles[first][:rows] - angles[second][:rows]).max() > np.radians(0.2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--sil", "--effect", "rotor_lg=0.1"), "unknown effect 'rotor_lg'; did you mean rotor_lag?"),
        (("--sil", "--effect", "rotor_lag=9"), "rotor_lag_s = 9 s is out of range; give 0 to 0.6"),
        (("--sil", "--effect-file", "nowhere.py"), "cannot be read; give a Python file"),
        (("--sil", "--model", "papr"), "unknown model 'papr'; did you mean paper"),
        (("--effect", "rotor_lag"), "for a simulated board only; add --sil"),
    ],
)
def test_what_cannot_be_flown_is_refused_in_one_line(
    terminal: Terminal, options: tuple[str, ...], message: str
) -> None:
    result = terminal("fly", "hover", *options)
    assert result.code != 0
    assert message in result.err
    assert len(result.err.strip().splitlines()) == 1


def test_a_rigs_effects_are_shown_and_checked(terminal: Terminal, tmp_path: Path) -> None:
    path = tmp_path / "extended.toml"
    rig, kind = load_rig("makki2024"), catalogue()["rotor_lag"]
    numbers = effect_numbers(kind, {"rotor_lag_s": 0.118}, {"rotor_lag_s": 0.004}, "flight a")
    write_rig(Rig("extended", "with lag", rig.numbers, {"rotor_lag": numbers}, "multibody"), path)
    assert terminal("rig", "check", path).code == 0
    assert "rotor_lag.s" in terminal("rig", "show", path).out
    path.write_text(path.read_text().replace("rotor_lag", "rotor_lg"))
    result = terminal("rig", "check", path)
    assert result.code != 0
    assert "unknown effect 'rotor_lg'; did you mean rotor_lag?" in result.err
