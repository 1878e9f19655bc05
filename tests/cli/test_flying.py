"""Flights from the command line: what they leave, how they are interrupted, and which board and rig flies."""

import json
import os
import pty
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import heli_host
import numpy as np
import pytest
from heli_host.board.interrupts import Interrupts
from heli_host.data.log.reader import Log, read_flight, read_log
from heli_host.ui.cli import entry, run
from heli_sim.due import firmware
from heli_sim.model.effects import catalogue, effect_numbers
from heli_sim.rig import Rig, load_rig, write_rig
from heli_sim.sil.transport import SilProcess

from tests.cli.terminal import PATIENCE_S, Terminal, command, process
from tests.running.long import samples
from tests.sil.harness import patient_file

SIL = ("--sil", "--speed", "max")
FLY = ("fly", "hover", "--sil", "--speed", "10", "--log", "f.mcap", "--params", "patient.toml")
LOADING = """
import importlib.abc, sys

class Interrupted(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt
        return None

sys.meta_path.insert(0, Interrupted())
from heli_host.ui.cli import main
sys.argv = ["heli-host", "fly", "hover", "--sil"]
main()
"""
LAW = Path(__file__).parents[2] / "docs/laws/lqi.py"
FLY_MINE = ("fly", "short.toml", "--sil", "--speed", "max", "--rig", "mine.toml", "--log", "a.mcap")
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


@pytest.mark.slow
def test_a_flight_leaves_log_summary_and_figure(terminal: Terminal, tmp_path: Path) -> None:
    result = terminal("fly", "hover", "step", *SIL)
    assert result.code == 0
    (folder,) = (tmp_path / "flights").iterdir()
    assert sorted(path.name for path in folder.iterdir()) == ["figure.png", "flight.mcap", "summary.json"]
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["outcome"] == "completed"
    assert summary["ticks_lost"] == 0
    assert summary["ticks_logged"] == pytest.approx(1000 * summary["duration_s"], abs=2)
    assert set(summary["rms_error_deg"]) == {"elevation", "pitch", "travel"}
    assert {"frames_ok", "frames_bad", "retries", "reconnects"} <= set(summary["link"])
    # The note on the checks of travel's encoder is one of these lines.
    last = "\n".join(result.out.splitlines()[-6:])
    for expected in ("hover + step", "elevation", "ticks logged, 0 lost", str(folder.name), "board:"):
        assert expected in last


@pytest.mark.slow
def test_only_named_files_are_written_and_the_native_board_flies(terminal: Terminal, tmp_path: Path) -> None:
    files = ("--log", tmp_path / "a.mcap", "--json", tmp_path / "new" / "a.json")
    result = terminal("fly", "hover", *SIL, *files)
    assert result.code == 0
    written = [path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(map(str, written)) == ["a.mcap", "new/a.json"]
    assert "native board" in board_line(result.out)
    assert json.loads((tmp_path / "new" / "a.json").read_text())["board"] == "native"


def ignoring_interrupts() -> None:
    """Be what a script starts with ``&``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def assert_landed(log: Log) -> None:
    """The flight came down before its log was closed, and both are in it."""
    assert log.complete
    assert log.layout.names("STATE")[int(log.ticks["state"][-1])] == "idle"
    assert "landing" in {event["message"] for event in log.events}


@pytest.mark.slow
def test_a_terminal_that_is_closed_lands_the_flight_and_keeps_its_log(tmp_path: Path) -> None:
    patient_file(tmp_path)
    child, terminal = pty.fork()
    if child == 0:
        # Where the tests run under nohup, this process would inherit that a hang-up is ignored.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        os.chdir(tmp_path)
        os.execv(sys.executable, command(*FLY))
    output = b""
    while b"closed_loop" not in output:
        output += os.read(terminal, 4096)
    os.close(terminal)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == 4
    log = read_log(tmp_path / "f.mcap")
    assert_landed(log)
    assert log.metadata["result"]["outcome"] == "aborted: SIGHUP"


@pytest.mark.slow
def test_under_nohup_a_hang_up_ends_nothing(tmp_path: Path) -> None:
    patient_file(tmp_path)
    with process(tmp_path, *FLY, prepare=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)) as host:
        assert host.stdout is not None
        while "closed_loop" not in (line := host.stdout.readline()):
            assert line, "it ended before it flew"
        host.send_signal(signal.SIGHUP)
        host.communicate(timeout=60)
    assert host.returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "prepare"),
    [
        (signal.SIGINT, ignoring_interrupts),
        (signal.SIGTERM, None),
        (signal.SIGINT, None),
        (signal.SIGHUP, None),
    ][: samples(4, 2)],
)
def test_an_interrupted_flight_lands_and_keeps_its_log(
    tmp_path: Path, number: signal.Signals, prepare: Callable[[], None] | None
) -> None:
    patient_file(tmp_path)
    with process(tmp_path, *FLY, prepare=prepare) as host:
        assert host.stdout is not None
        while "closed_loop" not in (line := host.stdout.readline()):
            assert line, "it ended before it flew"
        host.send_signal(number)
        out, err = host.communicate(timeout=60)
    assert host.returncode == 4, err
    assert "Traceback" not in err
    log, name = read_log(tmp_path / "f.mcap"), "Ctrl-C" if number == signal.SIGINT else number.name
    assert_landed(log)
    assert log.metadata["result"]["outcome"] == f"aborted: {name}"
    assert f"aborted: {name}" in out
    [event] = [event["message"] for event in log.events if event["name"] == "interrupt"]
    assert event.startswith(f"{name}: ")


@pytest.mark.slow
def test_a_full_disk_lands_and_keeps_what_was_logged(terminal: Terminal, tmp_path: Path) -> None:
    # Compiles the plant into the cache, which the limit on file sizes would not let the next process do.
    assert terminal("params", "get", "hover_V", "--sil").code == 0
    limit_bytes = 200_000

    def fly(program: list[str]) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            program,
            cwd=tmp_path,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (limit_bytes, limit_bytes)),
            capture_output=True,
            text=True,
            check=False,
            timeout=60,
        )

    python, option, main, *words = command("fly", "hover", *SIL, "--log", "f.mcap")
    # A limit that is known keeps the motors off.
    refused = fly([python, option, main, *words])
    assert refused.returncode == 5 and "raise the limit (ulimit -f)" in refused.stderr
    assert not (tmp_path / "f.mcap").exists()
    # Quotas and file systems have limits that no program knows beforehand.
    unknown = "import heli_host.data.log.disk as disk; disk.max_file_bytes = lambda: None; "
    done = fly([python, option, unknown + main, *words])
    assert done.returncode == 4, done.stderr
    assert done.stderr.startswith("error: ")
    assert len(done.stderr.splitlines()) == 1
    log = read_log(tmp_path / "f.mcap")
    assert len(log.ticks) > 2000
    assert (tmp_path / "f.mcap").stat().st_size <= limit_bytes
    result = terminal("info", "f.mcap").out
    assert "not closed: the log could not be written further (File too large)" in result
    assert "the host ended" not in result


@pytest.mark.slow
def test_a_log_cut_short_is_read_up_to_there(terminal: Terminal, tmp_path: Path) -> None:
    whole, cut = tmp_path / "whole.mcap", tmp_path / "cut.mcap"
    assert terminal("fly", "hover", *SIL, "--log", whole).code == 0
    data = whole.read_bytes()
    cut.write_bytes(data[: len(data) * 2 // 3])
    result = terminal("info", cut)
    assert result.code == 0
    assert "not closed" in result.out
    assert terminal("plot", cut, "--figure", tmp_path / "cut.png").code == 0
    assert terminal("export", cut, "--csv").code == 0
    flown, kept = read_flight(whole), read_flight(tmp_path / "cut.csv")
    assert 10_000 < len(kept) < len(flown)
    assert kept.elevation_rad == pytest.approx(flown.elevation_rad[: len(kept)], abs=1e-6)


@pytest.mark.medium
@pytest.mark.parametrize(
    "module", ["heli_host.ui.cli.entry", "heli_host.ui.cli.verbs.flying", "typer", "heli_host.board.heli"]
)
def test_an_interrupt_while_the_program_loads_is_one_word(module: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", LOADING.format(module=module)], capture_output=True, text=True, check=False
    )
    assert ended.returncode == 130, ended.stderr
    assert ended.stderr == "interrupted\n"


def test_a_verb_that_is_interrupted_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("heli_host.link.transport.available_ports", interrupted)
    assert run(["ports"]) == 130
    assert capsys.readouterr().err == "interrupted\n"


def test_a_signal_after_the_end_of_a_flight_does_not_break_its_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("heli_host.board.interrupts._interrupted", threading.Event())
    before = signal.signal(signal.SIGINT, entry._raise_interrupt)
    try:
        with Interrupts(), pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


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
    (tmp_path / "short.toml").write_text(PLAN)
    for name, options in flights.items():
        log = tmp_path / f"{name}.mcap"
        assert terminal("fly", "short.toml", *SIL, *options, "--log", log).code == 0
        angles[name] = read_flight(log).angles_rad
    rows = min(len(samples) for samples in angles.values())
    np.testing.assert_array_equal(angles["gusts"], angles["again"])
    for first, second in (("plain", "lag"), ("plain", "gusts"), ("gusts", "other")):
        assert np.abs(angles[first][:rows] - angles[second][:rows]).max() > np.radians(0.2)


@pytest.mark.medium
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


@pytest.fixture
def built() -> Path:
    """An ELF that this installation can fly."""
    builds = firmware.candidates()
    if not builds:
        pytest.skip("no firmware is built: install the cross-compiler, then make setup or make firmware")
    return firmware.find_firmware()


def board_line(out: str) -> str:
    (line,) = [line for line in out.splitlines() if line.startswith("board: ")]
    return line


@pytest.mark.emulated
def test_a_flight_of_the_emulated_due_says_so_everywhere(
    terminal: Terminal, tmp_path: Path, built: Path
) -> None:
    result = terminal("fly", "hover", *SIL, "--board", "due", "--json", "f.json", "--log", "f.mcap")
    assert result.code == 0, result.err
    assert f"emulated Due, {built.name}" in board_line(result.out)
    summary = json.loads((tmp_path / "f.json").read_text())
    assert (summary["board"], summary["outcome"]) == ("emulated Due", "completed")
    # Where the ELF lies is no part of a flight: the same flight leaves the same log elsewhere.
    assert str(built.parent).encode() not in (tmp_path / "f.mcap").read_bytes()


@pytest.mark.emulated
def test_auto_without_firmware_flies_the_native_board_and_says_why(
    terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(firmware, "candidates", list)
    result = terminal("fly", "hover", *SIL, "--board", "auto", "--log", "f.mcap")
    assert result.code == 0
    assert "native board" in board_line(result.out)
    assert "make firmware" in result.out
    assert terminal("fly", "hover", *SIL, "--board", "due").code == 2


@pytest.mark.emulated
def test_sil_serves_the_emulated_due_with_its_control_lines(tmp_path: Path, built: Path) -> None:
    arguments = ("--rfc2217", "127.0.0.1:0", "--board", "due", "--elf", built, "--speed", "max")
    with process(tmp_path, "sil", *arguments) as server:
        assert server.stdout is not None
        output = server.stdout.readline()
        assert "emulated Due" in output
        url = next(word for word in output.replace(",", " ").split() if word.startswith("rfc2217://"))
        with heli_host.connect(url) as heli:
            assert (heli.info.board, heli.info.reset) == ("Arduino Due", "user")
        server.send_signal(signal.SIGINT)
        out, err = server.communicate(timeout=60)
    assert server.returncode == 0, err
    assert "simulated" in out


@pytest.mark.emulated
def test_opening_spares_the_board_where_that_was_asked_for(tmp_path: Path, built: Path) -> None:
    arguments = ("--pty", "./due", "--board", "due", "--no-reset-on-open", "--speed", "max")
    with process(tmp_path, "sil", *arguments) as server:
        assert server.stdout is not None
        server.stdout.readline()
        with heli_host.connect(str(tmp_path / "due")) as heli:
            assert heli.info.reset == "power_up"
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=60)


def write_mine(folder: Path, **values: float) -> None:
    write_rig(
        load_rig("makki2024").replace(**{"encoder_counts_travel": 2048.0, **values}), folder / "mine.toml"
    )
    (folder / "short.toml").write_text(PLAN)


@pytest.mark.medium
def test_fly_sets_a_simulated_board_from_the_rig_and_says_so(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path, supply=9.0)
    result = terminal(*FLY_MINE)
    assert result.code == 0, result.err
    assert "parameters set from rig makki2024: travel_counts_per_rev 2048 count, supply_V 9 V" in result.out
    log = read_log(tmp_path / "a.mcap")
    assert (log.parameters["travel_counts_per_rev"], log.parameters["supply_V"]) == (2048.0, 9.0)


@pytest.mark.medium
def test_fly_refuses_parameters_with_another_scale(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path)
    (tmp_path / "p.toml").write_text("[parameters]\ntravel_counts_per_rev = 4096\n")
    result = terminal(*FLY_MINE, "--params", "p.toml")
    assert result.code == 2
    assert "travel_counts_per_rev is 4096 count, but the rig has 2048 count" in result.err
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.medium
@pytest.mark.parametrize(
    ("words", "warning"),
    [([], "supply_V is 13 V, but the rig has 12 V"), (["--blind"], "supply_V is not that of the rig")],
)
def test_fly_warns_of_another_supply_and_flies(
    terminal: Terminal, tmp_path: Path, words: list[str], warning: str
) -> None:
    write_mine(tmp_path, encoder_counts_travel=4096.0)
    (tmp_path / "p.toml").write_text("[parameters]\nsupply_V = 13\n")
    result = terminal(*FLY_MINE, "--params", "p.toml", *words)
    assert result.code == 0, result.err
    assert f"warning: {warning}\n" in result.out


@pytest.mark.slow
@pytest.mark.parametrize(
    "words", ["fly short.toml", "setpoint --take-off --travel-deg 5"], ids=["fly", "setpoint"]
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


@pytest.mark.medium
def test_a_page_refuses_a_wrong_scale_before_it_is_served(tmp_path: Path) -> None:
    write_mine(tmp_path)
    with SilProcess() as sil, process(tmp_path, "dashboard", "--port", sil.url, "--rig", "mine.toml") as page:
        # Without the refusal it serves until Ctrl-C.
        _, err = page.communicate(timeout=PATIENCE_S)
    assert page.returncode == 2
    assert "travel_counts_per_rev is 4096 count, but the rig has 2048 count" in err


@pytest.mark.medium
def test_on_a_port_a_name_that_no_rig_has_is_a_label(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path)
    with SilProcess() as sil:
        result = terminal(*f"fly short.toml --port {sil.url} --rig lab-7 --log a.mcap".split())
        missing = terminal(*f"fly short.toml --port {sil.url} --rig lab-7.toml --log b.mcap".split())
    assert result.code == 0, result.err
    assert "rig lab-7 is a label, not a rig file" in result.out
    assert missing.code == 2 and "cannot read rig file lab-7.toml" in missing.err


@pytest.mark.parametrize(("rig", "is_noted"), [("quanser-course", True), ("makki2024", False)])
def test_a_simulated_rig_without_gains_of_its_own_is_noted(
    terminal: Terminal, rig: str, is_noted: bool
) -> None:
    result = terminal(*f"setpoint --sil --speed max --elevation-deg 0 --rig {rig}".split())
    assert "the board is idle, not flying" in result.err
    assert (f"heli-host tune --rig {rig} designs others" in result.out) == is_noted


@pytest.mark.slow
def test_law_fly_flies_the_rig_that_is_named(terminal: Terminal, tmp_path: Path) -> None:
    write_mine(tmp_path)
    result = terminal(*f"law fly {LAW} --sil --speed max --rig mine.toml --duration 3 --log a.mcap".split())
    assert result.code == 0, result.err
    assert "parameters set from rig makki2024: travel_counts_per_rev 2048 count" in result.out
    log = read_log(tmp_path / "a.mcap")
    assert log.parameters["travel_counts_per_rev"] == 2048.0
    assert np.isfinite(log.flight().travel_rad).all()
