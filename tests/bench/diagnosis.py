"""How long a diagnosis takes, against an earlier commit in the same run, and how much memory it needs."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import heli_host
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly

from tests.bench.flights import RIG
from tests.bench.result import Measured
from tests.channels.changed_copy import ROOT, ChangedCopy

EARLIER: Final = "dbf78e4af8d516c4feade925c8b4043909de5f0b"
"""Before the search went by innovations."""
DATA: Final = ROOT.parent / "shared" / "data"
PAIRS: Final = {
    "diagnose_one_effect_ratio": (
        *("practice/rotor_lag/a.csv.gz", "practice/rotor_lag/b.csv.gz", "makki2024"),
    ),
    "diagnose_measured_pair_ratio": (
        *("measured/rendellc_P4p2_noint_pf5.csv.gz", "measured/rendellc_P2p1.csv.gz", "quanser-course"),
    ),
}
"""For each key the flight to fit, the one to validate on, and the rig."""
REPETITIONS: Final = {"diagnose_one_effect_ratio": 5, "diagnose_measured_pair_ratio": 2}
"""Runs of seconds differ by a tenth, runs of most of a minute by less."""
LONG: Final = (
    """
title = "Ten minutes"
[start]
settle_s = 2
"""
    + 5
    * """
[[segment]]
kind = "sine"
travel_amplitude_deg = 40
travel_period_s = 16
elevation_amplitude_deg = 7
elevation_period_s = 9
duration_s = 120
excite = { signal = "multisine", front_V = 0.25, back_V = 0.25, start_Hz = 0.1, stop_Hz = 4 }
"""
)


@dataclass(frozen=True)
class Spent:
    """Time and memory of a process."""

    elapsed_s: float  # By the clock on the wall, and by its own time and that of its children
    cpu_s: float  # By the clock on the wall, and by its own time and that of its children
    peak_GB: float  # Most memory that it held at once


Run = Callable[[Sequence[str]], Spent]


def run_and_measure(command: Sequence[str], folder: Path, environment: dict[str, str]) -> Spent:
    """Run a command to its end and look at what the system counted."""
    start_s = time.perf_counter()
    started = subprocess.Popen(
        command, cwd=folder, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    assert started.stderr is not None
    output = started.stderr.read().decode()
    _, status, used = os.wait4(started.pid, 0)
    started.returncode = os.waitstatus_to_exitcode(status)
    if started.returncode != 0:
        raise RuntimeError(f"{' '.join(command)}: {output[-2000:]}")
    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return Spent(time.perf_counter() - start_s, used.ru_utime + used.ru_stime, used.ru_maxrss * unit / 1e9)


def run_heli_host(folder: Path) -> Run:
    """Run ``heli-host`` as it is."""
    program = [sys.executable, "-c", "from heli_host.ui.cli import main; main()"]
    return lambda arguments: run_and_measure([*program, *arguments], folder, dict(os.environ))


def earlier(folder: Path) -> Run | str:
    """Run ``heli-host`` of the earlier commit, built in another folder; or the reason why that fails."""
    packed = subprocess.run(
        ["git", "-C", str(ROOT), "archive", "--format=tar", EARLIER], capture_output=True, check=False
    )
    if packed.returncode != 0:
        return f"git has no commit {EARLIER[:7]} here"
    with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
        archive.extractall(folder / "commit", filter="data")
    copy = ChangedCopy(folder / "copy", folder / "commit")
    try:
        copy.build("-O2")
    except AssertionError as error:
        return f"commit {EARLIER[:7]} does not build here: {str(error).strip().splitlines()[-1]}"
    return lambda arguments: run_and_measure(copy.heli_host_command(*arguments), folder, copy.environment())


def ratios(say: Callable[[str], None]) -> list[Measured]:
    """Time of the earlier commit over the time now, both run in turn."""
    if not DATA.exists():
        say("      skipped: no shared data")
        return []
    with TemporaryDirectory() as name:
        folder = Path(name)
        before, here = earlier(folder), run_heli_host(folder)
        if isinstance(before, str):
            say(f"      skipped: {before}")
            return []
        measured = []
        for key, (fit, validation, rig) in PAIRS.items():
            words = ["diagnose", str(DATA / fit), "--validate", str(DATA / validation), "--rig", rig]
            words += ["--report", "page", "--save-rig", "found.toml", "--json", "found.json"]
            pairs = [(before(words), here(words)) for _ in range(REPETITIONS[key])]
            measured += [
                Measured(key, [old.elapsed_s / new.elapsed_s for old, new in pairs]),
                Measured(f"{key}_cpu", [old.cpu_s / new.cpu_s for old, new in pairs]),
            ]
        return measured


def peak() -> Measured:
    """Memory of a diagnosis of ten simulated minutes at 1 kHz."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        with heli_host.connect(f"sil://?rig={RIG}&speed=max&effect=rotor_lag=0.06") as heli:
            summary = fly(heli, Plan.parse(LONG, "ten minutes"), log_path=folder / "long.mcap")
        assert summary.completed, summary.outcome
        words = ["diagnose", "long.mcap", "--rig", RIG]
        return Measured("diagnose_peak_GB_10_min", [run_heli_host(folder)(words).peak_GB])
