"""Speed, memory and accuracy of the laboratory: identification, diagnosis, campaigns."""

import io
import itertools
import os
import subprocess
import sys
import tarfile
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import heli_host
from heli_host.errors import FlightAborted, SetpointError
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_lab.apps.campaign import Campaign, Case, Store, run_campaign
from heli_lab.apps.campaign.cases import Limits
from heli_lab.diagnose import diagnose
from heli_lab.fit.identification import identify
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.bench.board import RIG
from tests.bench.result import Measured, repeat
from tests.channels.changed_copy import ROOT, ChangedCopy
from tests.identify.coverage import Covered, cover, share_within
from tests.identify.made import flown, thinned
from tests.running.alone import spent_s

FIT_REPETITIONS = 3
FIT_S = 60.0
FREE = (
    *("M_w", "L_phi", "L_theta", "thrust_gain", "dead_zone"),
    *(f"{kind}_{axis}" for kind in ("friction", "torque") for axis in ("elevation", "pitch", "travel")),
    *("offset_elevation", "offset_pitch"),
)
RIGS = 50


def identify_flight_s() -> list[float]:
    """Seconds for a minute at 500 Hz with thirteen parameters, checks included, compiled before."""
    rig = load_rig(RIG)
    flight = thinned(flown(rig, 1, FIT_S), 2)
    assert len(FREE) == 13
    identify(MultibodyModel(), rig, [flight], free=FREE)
    passed_s = []
    for _ in range(FIT_REPETITIONS):
        start_s = time.perf_counter()
        identify(MultibodyModel(), rig, [flight], free=FREE)
        passed_s.append(time.perf_counter() - start_s)
    return passed_s


def coverage(say: Callable[[str], None] = lambda _: None) -> list[Covered]:
    """Draw fifty rigs that fly to the end, fly each twice, identify each."""
    flights: list[Covered] = []
    seeds = itertools.count(1)
    while len(flights) < RIGS:
        seed = next(seeds)
        try:
            flights.append(cover(seed))
        except (FlightAborted, SetpointError) as error:
            # A cable that pulls hard is taken for a wrong sign, or keeps travel from its setpoint.
            say(f"      rig {seed}: the board ended the flight ({error}); another rig is drawn")
            continue
        if len(flights) % 10 == 0:
            share = share_within(flights)
            say(f"      {len(flights)} of {RIGS} rigs: {share:.1%} within two standard errors")
    return flights


def measure_identification(say: Callable[[str], None] = lambda _: None) -> list[Measured]:
    """Time a fit, then count over fifty rigs."""
    measured = [Measured("identify_60s_flight_s", identify_flight_s())]
    flights = coverage(say)
    return [
        *measured,
        repeat("identify_coverage_2std", 1, lambda: share_within(flights)),
        repeat("identify_heldout_normalised", 1, lambda: max(flight.held_out for flight in flights)),
    ]


EARLIER: Final = "17841163cc5c689c9e712c83b827c0566276004d"
"""Before the diagnosis models voltages between the rows of a slow log."""
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
RATIO_REPETITIONS: Final = {"diagnose_one_effect_ratio": 5, "diagnose_measured_pair_ratio": 2}
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
        copy.build("-O2", compiled=("_native", "_kalman", "_expression_vm"))
    except AssertionError as error:
        return f"commit {EARLIER[:7]} does not build here: {str(error).strip().splitlines()[-1]}"
    return lambda arguments: run_and_measure(copy.heli_host_command(*arguments), folder, copy.environment())


def diagnosis_ratios(say: Callable[[str], None]) -> list[Measured]:
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

            def diagnosed(run: Run, words: Sequence[str]) -> Spent:
                # A folder of its own: whose outputs those of an earlier run are would be checked first.
                with TemporaryDirectory(dir=folder) as place:
                    outputs = [f"{place}/{name}" for name in ("page", "found.toml", "found.json")]
                    options = zip(("--report", "--save-rig", "--json"), outputs, strict=True)
                    return run([*words, *itertools.chain(*options)])

            words = ["diagnose", str(DATA / fit), "--validate", str(DATA / validation), "--rig", rig]
            pairs = [
                (diagnosed(before, words), diagnosed(here, words)) for _ in range(RATIO_REPETITIONS[key])
            ]
            measured += [
                Measured(key, [old.elapsed_s / new.elapsed_s for old, new in pairs]),
                Measured(f"{key}_cpu", [old.cpu_s / new.cpu_s for old, new in pairs]),
            ]
        return measured


def diagnosis_peak() -> Measured:
    """Memory of a diagnosis of ten simulated minutes at 1 kHz."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        with heli_host.connect(f"sil://?rig={RIG}&speed=max&effect=rotor_lag=0.06") as heli:
            summary = fly(heli, Plan.parse(LONG, "ten minutes"), log_path=folder / "long.mcap")
        assert summary.completed, summary.outcome
        words = ["diagnose", "long.mcap", "--rig", RIG]
        return Measured("diagnose_peak_GB_10_min", [run_heli_host(folder)(words).peak_GB])


FEW, MANY = 10, 100
FLIGHT_S = 8.0
REFITS = 1
"""Refits of each search. Their number depends on the causes, and this measures the cost of one refit."""
HIDDEN = ("rotor_lag=0.08", *(f"random_torque.{axis}=0.006" for axis in ("elevation", "pitch", "travel")))


def records() -> list[Record]:
    """Return ten flights of one rig, repeated: what a flight costs does not depend on its numbers."""
    rig = load_rig(RIG)
    model = MultibodyModel(parse_effects(HIDDEN))
    few = [thinned(flown(rig, seed, FLIGHT_S, model), 4) for seed in range(1, FEW + 1)]
    prepared = [prepare(flight, rig, f"flight {number}") for number, flight in enumerate(few)]
    return [replace(prepared[n % FEW], label=f"flight {n}") for n in range(MANY)]


def cost_s(flights: list[Record]) -> float:
    """CPU time for each of some flights."""
    start_s = time.process_time()
    diagnose(MultibodyModel(), load_rig(RIG), flights, refits=REFITS, threads=1)
    return (time.process_time() - start_s) / len(flights)


def measure_many_flights() -> list[Measured]:
    """Diagnose ten flights, then a hundred."""
    every = records()
    few_s = cost_s(every[:FEW])
    return [Measured("diagnose_growth_100_flights", [cost_s(every) / few_s])]


CASES, NAP_s = 200, 0.1
"""Cases that wait and use no core: what is measured is the campaign and not how many cores are free."""


def measure_campaign() -> list[Measured]:
    """Do two hundred cases with one worker, then with two."""
    taken_s, spent = [], []
    for processes in (1, 2):
        cases = tuple(
            Case(f"{number}", "tests.campaign.works:count", {"number": number, "nap_s": NAP_s})
            for number in range(CASES)
        )
        with tempfile.TemporaryDirectory() as folder:
            start_s, before_s = time.perf_counter(), spent_s()
            run_campaign(
                Campaign("naps", cases, Limits(60.0, 600.0)), Store(Path(folder)), processes=processes
            )
            taken_s.append(time.perf_counter() - start_s)
            spent.append((spent_s() - before_s) / CASES)
    return [
        Measured("campaign_two_workers_ratio", [taken_s[0] / taken_s[1]]),
        Measured("campaign_case_overhead_cpu_ms", [1e3 * cpu_s for cpu_s in spent]),
    ]


if __name__ == "__main__":
    import resource
    import sys

    every = records()
    for count in map(int, sys.argv[1:]):
        peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(count, cost_s(every[:count]), "s a flight;", f"{peak_MB:.0f} MB before", flush=True)
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB at most")
