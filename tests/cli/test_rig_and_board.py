"""Verbs that fly compare rig and board: they refuse a wrong scale, and warn of the rest."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.reader import read_log
from heli_sim.rig import load_rig, write_rig
from heli_sim.sil.process import SilProcess

from tests.cli.terminal import PATIENCE_S, Terminal, process

pytestmark = pytest.mark.medium
LAW = Path(__file__).parents[2] / "docs/laws/lqi.py"
FLY = ("fly", "short.toml", "--sil", "--speed", "max", "--rig", "mine.toml", "--log", "a.mcap")
PLAN = """
title = "Short"
[start]
elevation_deg = -10
rate_deg_s = 15
settle_s = 0.5
[[segment]]
kind = "hold"
duration_s = 1
"""


def write_mine(folder: Path, **values: float) -> None:
    write_rig(
        load_rig("makki2024").replace(**{"encoder_counts_travel": 2048.0, **values}), folder / "mine.toml"
    )
    (folder / "short.toml").write_text(PLAN)


def test_fly_sets_a_simulated_board_from_the_rig_and_says_so(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path, supply=9.0)
    result = terminal(*FLY)
    assert result.code == 0, result.err
    assert "parameters set from rig makki2024: travel_counts_per_rev 2048 count, supply_V 9 V" in result.out
    log = read_log(tmp_path / "a.mcap")
    assert (log.parameters["travel_counts_per_rev"], log.parameters["supply_V"]) == (2048.0, 9.0)


def test_fly_refuses_parameters_with_another_scale(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path)
    (tmp_path / "p.toml").write_text("[parameters]\ntravel_counts_per_rev = 4096\n")
    result = terminal(*FLY, "--params", "p.toml")
    assert result.code == 2
    assert "travel_counts_per_rev is 4096 count, but the rig has 2048 count" in result.err
    assert not (tmp_path / "a.mcap").exists()


def test_fly_warns_of_another_supply_and_flies(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path, encoder_counts_travel=4096.0)
    (tmp_path / "p.toml").write_text("[parameters]\nsupply_V = 13\n")
    result = terminal(*FLY, "--params", "p.toml")
    assert result.code == 0, result.err
    assert "warning: supply_V is 13 V, but the rig has 12 V" in result.out


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    ["fly short.toml", "setpoint --take-off --travel-deg 5", f"law fly {LAW}"],
    ids=["fly", "setpoint", "law fly"],
)
def test_on_a_port_a_wrong_scale_is_refused_with_the_command(
    terminal: Terminal, tmp_path: Path, words: str
) -> None:
    write_mine(tmp_path, elevation_min=-23.0)
    with SilProcess() as sil:
        result = terminal(*words.split(), "--port", sil.url, "--rig", "mine.toml")
    assert result.code == 2
    assert "travel_counts_per_rev is 4096 count, but the rig has 2048 count" in result.err
    assert "heli-host params set travel_counts_per_rev 2048 --save" in result.err


def test_a_page_refuses_a_wrong_scale_before_it_is_served(tmp_path: Path) -> None:
    write_mine(tmp_path)
    with (
        SilProcess() as sil,
        process(tmp_path, "dashboard", "--port", sil.url, "--rig", "mine.toml") as page,
    ):
        # Without the refusal it serves until Ctrl-C.
        _, err = page.communicate(timeout=PATIENCE_S)
    assert page.returncode == 2
    assert "travel_counts_per_rev is 4096 count, but the rig has 2048 count" in err


def test_on_a_port_a_name_that_no_rig_has_is_a_label(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path)
    with SilProcess() as sil:
        result = terminal(*f"fly short.toml --port {sil.url} --rig lab-7 --log a.mcap".split())
        missing = terminal(*f"fly short.toml --port {sil.url} --rig lab-7.toml --log b.mcap".split())
    assert result.code == 0, result.err
    assert "rig lab-7 is a label, not a rig file" in result.out
    assert missing.code == 2 and "cannot read rig file lab-7.toml" in missing.err


@pytest.mark.slow
def test_law_fly_flies_the_rig_that_is_named(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path)
    result = terminal(*f"law fly {LAW} --sil --speed max --rig mine.toml --duration 3 --log a.mcap".split())
    assert result.code == 0, result.err
    assert "parameters set from rig makki2024: travel_counts_per_rev 2048 count" in result.out
    log = read_log(tmp_path / "a.mcap")
    assert log.parameters["travel_counts_per_rev"] == 2048.0
    assert np.isfinite(log.flight().travel_rad).all()
