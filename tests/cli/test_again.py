"""``fly --again``: a simulated flight is repeated from its log alone, or one line says what the log lacks."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_log
from heli_host.errors import LogError
from heli_host.fly.plan import Plan
from heli_host.ui.cli import flight
from heli_sim.rig import Rig, load_rig
from heli_sim.rig.rig import rig_text

from tests.cli.terminal import Terminal

pytestmark = pytest.mark.medium

PLAN = """
title = "Hover for a moment"
[start]
elevation_deg = -15
rate_deg_s = 15
settle_s = 0
[[segment]]
kind = "hold"
duration_s = 0.3
"""
EFFECT_FILE = """
import casadi as ca
from heli_sim.model import Effect, Stage
from heli_sim.model.effects import EffectSpec, Parameter
from heli_sim.rig import Prior

print("code has run")


class Push(Effect):
    def torque_Nm(self, at):
        return ca.vertcat(0, 0, self.value(at, "Nm"))


PUSH = EffectSpec(
    id="push_of_test_again",
    effect=Push,
    sentence="a push with {Nm}",
    equation="w",
    acts_on="torque.travel",
    stage=Stage.TORQUE,
    numbers=(Parameter("Nm", "N m", "torque w", typical=0.03, prior=Prior(0.0, 0.1, -1, 1), size=True),),
)
"""


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "short.toml"
    path.write_text(PLAN)
    return path


def assert_same(first: Path, second: Path) -> None:
    before, after = read_log(first), read_log(second)
    np.testing.assert_array_equal(before.ticks["tick"], after.ticks["tick"])
    np.testing.assert_array_equal(before.raw, after.raw)
    assert len(before.raw) > 1000


def test_a_flight_is_repeated_from_its_log_alone(terminal: Terminal, tmp_path: Path, plan: Path) -> None:
    rig_file, rig = tmp_path / "mine.toml", load_rig("makki2024")
    # A number that seven digits do not hold.
    arm = rig["L_a"]
    numbers = {**rig.numbers, "L_a": replace(arm, value=arm.value + 1.0e-9 / 3.0)}
    rig_file.write_text(rig_text(Rig("mine", "One arm", numbers, rig.effects, rig.model), digits=17))
    arguments = ("--sil", "--speed", "max", "--rig", rig_file, "--seed", "7", "--effect", "rotor_lag=0.05")
    flown = terminal(
        "fly",
        plan,
        plan,
        *arguments,
        "--effect",
        "random_torque.travel=0.02",
        "--gains",
        "paper",
        "--log",
        "a.mcap",
    )
    assert flown.code == 0, flown.err
    for file in (rig_file, plan):
        file.unlink()
    for source, target in (("a.mcap", "b.mcap"), ("b.mcap", "c.mcap")):
        repeated = terminal("fly", "--again", source, "--log", target)
        assert repeated.code == 0 and "samples are the same" in repeated.out, repeated.err
        assert_same(Path(source), Path(target))


def test_another_seed_gives_other_samples_and_an_error(
    terminal: Terminal, plan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gusts = ("--effect", "random_torque.travel=0.02")
    assert terminal("fly", plan, "--sil", "--speed", "max", *gusts, "--log", "a.mcap").code == 0
    read = flight.read_repeat

    def with_another_seed(log: Log, files: Mapping[str, Path]) -> flight.Repeat:
        repeat = read(log, files)
        return replace(repeat, options={**repeat.options, "seed": "2"})

    monkeypatch.setattr(flight, "read_repeat", with_another_seed)
    result = terminal("fly", "--again", "a.mcap", "--log", "b.mcap")
    assert result.code != 0 and "the samples differ from" in result.err


def test_code_of_effects_is_asked_for_and_never_taken_from_the_log(
    terminal: Terminal, tmp_path: Path, plan: Path
) -> None:
    file = tmp_path / "mine.py"
    file.write_text(EFFECT_FILE)
    arguments = ("--effect-file", file, "--sil", "--speed", "max", "--log", "a.mcap")
    assert terminal("fly", plan, *arguments).code == 0
    refused = terminal("fly", "--again", "a.mcap", "--log", "b.mcap")
    assert (
        refused.code != 0 and "add --effect-file mine.py" in refused.err and "code has run" not in refused.out
    )
    assert not Path("b.mcap").exists() and "code has run" not in str(read_log("a.mcap").metadata)
    file.write_text(EFFECT_FILE + "# changed\n")
    assert "add --effect-file mine.py" in terminal("fly", "--again", "a.mcap", "--effect-file", file).err
    file.write_text(EFFECT_FILE)
    assert terminal("fly", "--again", "a.mcap", "--effect-file", file, "--log", "b.mcap").code == 0
    assert_same(Path("a.mcap"), Path("b.mcap"))


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("again") / "flight.mcap"
    with heli_host.connect("sil://?speed=max") as heli:
        heli.fly(Plan.parse(PLAN, "short"), log=path)
    return read_log(path)


COMPLETE = {
    "flown_by": "heli-host fly",
    "plans": '["short"]',
    "parameters": "{}",
    "gains": "",
    "clear_fault": "0",
    "lands_on_alarm": "0",
}


@pytest.mark.parametrize(
    ("session", "simulation", "lacking"),
    [
        ({}, {}, "because another command than heli-host fly"),
        ({"url": "/dev/ttyACM0", "board": "due"}, None, "is a flight of a real board"),
        ({}, None, "lacks rig, effects and seed, because an older heli-host wrote it"),
        ({"sealed": "sha256:0"}, None, "is a blind flight"),
        ({}, {**COMPLETE, "lands_on_alarm": "1"}, "lacks the twin"),
        ({}, {**COMPLETE, "flash": "flash.bin"}, "lacks the flash memory flash.bin"),
        ({}, {**COMPLETE, "plans": '["other"]'}, "describes its simulation incompletely: 'other'"),
        ({}, {**COMPLETE, "plans": "3"}, "describes its simulation incompletely"),
        ({}, {**COMPLETE, "effect_files": "[1]"}, "effect_files is not a table"),
        ({}, {**COMPLETE, "parameters": '{"travel_kp": "much"}'}, "describes its simulation incompletely"),
    ],
)
def test_a_line_names_what_the_log_lacks(
    log: Log, session: dict[str, str], simulation: dict[str, str] | None, lacking: str
) -> None:
    metadata = {**log.metadata, "session": {**log.metadata["session"], **session}}
    if simulation is None:
        del metadata["simulation"]
    else:
        metadata["simulation"] = {**log.metadata["simulation"], **simulation}
    with pytest.raises(LogError, match=lacking):
        flight.read_repeat(replace(log, metadata=metadata), {})


def test_a_flight_in_real_time_is_repeated_in_lockstep(log: Log) -> None:
    address = f"{log.metadata['simulation']['address']}&speed=1&process=1".replace("speed=max&", "")
    metadata = {**log.metadata, "simulation": {**log.metadata["simulation"], **COMPLETE, "address": address}}
    repeat = flight.read_repeat(replace(log, metadata=metadata), {})
    assert not repeat.is_exact and "process" not in repeat.options


def test_what_a_log_gives_is_refused_on_the_command_line(terminal: Terminal) -> None:
    for words in (
        ("hover",),
        ("--port", "COM3"),
        ("--seed", "2"),
        ("--effect", "rotor_lag=0.1"),
        ("--gains", "paper"),
    ):
        result = terminal("fly", "--again", "a.mcap", *words)
        assert result.code == 2 and "takes this from the log" in result.err
    assert "no plan is given" in terminal("fly", "--sil").err
