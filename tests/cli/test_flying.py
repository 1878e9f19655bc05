"""Whole flights from the command line, and what they leave."""

from __future__ import annotations

import json
import os
import pty
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from heli_host.data.log.reader import Log, read_flight, read_log

from tests.cli.terminal import Terminal, command, process
from tests.running.long import LONG, samples
from tests.sil.patient import patient_file

pytestmark = pytest.mark.slow

SIL = ("--sil", "--speed", "max")
FLY = ("fly", "hover", "--sil", "--speed", "10", "--log", "f.mcap", "--params", "patient.toml")


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
    last = "\n".join(result.out.splitlines()[-5:])
    for expected in ("hover + step", "elevation", "ticks logged, 0 lost", str(folder.name), "board:"):
        assert expected in last


def test_a_flight_that_hung_low_is_not_tracked_and_ends_with_4(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "weak.toml").write_text(
        "[parameters]\nelevation_integral_max_V = 0.0\nhover_V = 0.8\nelevation_kp = 0.03\n"
    )
    result = terminal("fly", "hover", *SIL, "--params", "weak.toml", "--log", "low.mcap")
    assert result.code == 4
    assert "not_tracked: elevation was up to" in result.out + result.err


@pytest.mark.skipif(not LONG, reason="tests/fly and tests/sil ask the same; this one runs in make long")
def test_the_same_seed_gives_the_same_log(terminal: Terminal, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert terminal("fly", "hover", *SIL, "--seed", "7", "--log", tmp_path / f"{name}.mcap").code == 0
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_what_is_named_is_written_and_nothing_else(terminal: Terminal, tmp_path: Path) -> None:
    files = ("--log", tmp_path / "a.mcap", "--json", tmp_path / "new" / "a.json")
    assert terminal("fly", "hover", *SIL, *files).code == 0
    written = [path.relative_to(tmp_path) for path in tmp_path.rglob("*") if path.is_file()]
    assert sorted(map(str, written)) == ["a.mcap", "new/a.json"]


def test_flights_of_one_second_do_not_overwrite_each_other(terminal: Terminal, tmp_path: Path) -> None:
    for _ in range(2):
        assert terminal("record", "--duration", "0.5", *SIL).code == 0
    assert len(list((tmp_path / "flights").iterdir())) == 2


def ignoring_interrupts() -> None:
    """Be what a script starts with ``&``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def assert_landed(log: Log) -> None:
    """The flight came down before its log was closed, and both are in it."""
    assert log.complete
    assert log.layout.names("STATE")[int(log.ticks["state"][-1])] == "idle"
    assert "landing" in {event["message"] for event in log.events}


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


def test_under_nohup_a_hang_up_ends_nothing(tmp_path: Path) -> None:
    patient_file(tmp_path)
    with process(tmp_path, *FLY, prepare=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN)) as host:
        assert host.stdout is not None
        while "closed_loop" not in (line := host.stdout.readline()):
            assert line, "it ended before it flew"
        host.send_signal(signal.SIGHUP)
        host.communicate(timeout=60)
    assert host.returncode == 0


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
