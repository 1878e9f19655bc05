"""The command: what it prints, and the rig that it leaves."""

from __future__ import annotations

import json
from pathlib import Path

from heli_sim.rig import load_rig

from tests.cli.terminal import Terminal, terminal
from tests.pool.test_population import RIG, diagnosis

__all__ = ["terminal"]


def test_machines_are_pooled_and_a_prior_is_left(terminal: Terminal, tmp_path: Path) -> None:
    gain = 1.1 * RIG["thrust_gain"].value
    paths = [tmp_path / f"lab{n}.json" for n in range(3)]
    for path, lag_s in zip(paths, (0.08, 0.09, 0.1), strict=True):
        path.write_text(json.dumps(diagnosis(gain, lag_s)))
    out, numbers = tmp_path / "pooled.toml", tmp_path / "pooled.json"
    result = terminal("pool", *paths, "--save-rig", out, "--json", numbers)
    assert result.code == 0, result.err
    assert "3 rigs of type makki2024, model multibody" in result.out
    assert "rotor_lag: on 3 of 3 rigs that could show it; 29 to 100 % of all rigs of this type" in result.out
    assert load_rig(out)["thrust_gain"].value > 1.05 * RIG["thrust_gain"].value
    content = json.loads(numbers.read_text())
    assert content["numbers"]["rotor_lag_s"]["machines"] == 3
    assert content["causes"]["rotor_lag"]["share"] == 1.0


def test_what_is_no_diagnosis_is_one_line(terminal: Terminal, tmp_path: Path) -> None:
    result = terminal("pool", tmp_path / "none.json")
    assert result.code == 2
    assert result.err.count("\n") == 1 and "none.json" in result.err
