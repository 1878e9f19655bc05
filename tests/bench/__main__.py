"""``python -m tests.bench``: measure everything, write bench.json, print a table."""

from __future__ import annotations

import json
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench import (
    campaign,
    decoding,
    diagnosis,
    due,
    identification,
    line,
    many_flights,
    page,
    plant,
    reading,
    recording,
    simulation,
)
from tests.bench.result import PROMISES, Measured

RESULT = Path("bench.json")


def processor() -> str:
    """Return the processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def measure_all(say: Callable[[str], None]) -> list[Measured]:
    """Measure everything.

    Parameters
    ----------
    say : callable
        Told what is measured next, and how long that takes.
    """
    say("[1/12] flying in simulation as fast as possible (about 60 s)")
    measured = simulation.measure()
    say("[2/12] decoding, against pymavlink (about 10 s)")
    sent, duration_s = line.flight_bytes()
    measured += decoding.measure(sent)
    say("[3/12] counting bytes on the line (about 5 s)")
    measured += line.measure(sent, duration_s)
    say("[4/12] reading a ten-minute log (about 10 s)")
    measured += reading.measure()
    say("[5/12] recording in real time (about 85 s)")
    measured += recording.measure()
    say("[6/12] stopping from the live page, and what it costs (about 150 s)")
    measured += page.measure()
    say("[7/12] counting instructions of the Due's firmware (about 40 s)")
    counted = due.measure()
    if not counted:
        say("      skipped: there is no cross-compiler for the Due; make firmware says how to get it")
    measured += counted
    say("[8/12] stepping and linearising the rig, against MuJoCo (about 10 s)")
    measured += plant.measure()
    say("[9/12] a campaign of two hundred short cases, with one worker and with two (about 35 s)")
    measured += campaign.measure()
    say("[10/12] diagnosing, against an earlier commit, and ten minutes of flight (about 10 minutes)")
    measured += diagnosis.measure(say)
    say("[11/12] diagnosing ten flights of a rig, and a hundred (about 10 minutes)")
    measured += many_flights.measure()
    say("[12/12] identifying fifty simulated rigs (about 5 minutes)")
    return measured + identification.measure(say)


def table(measured: list[Measured]) -> tuple[Table, bool]:
    """Return the table, and whether every promise holds.

    Parameters
    ----------
    measured : list of Measured
        Every number.
    """
    values = {one.key: one for one in measured}
    report = Table(box=None, pad_edge=False)
    for heading in ("number", "median", "worst", "bound", "", "what"):
        report.add_column(heading, no_wrap=heading != "what")
    all_hold = True
    for promise in PROMISES:
        if promise.key not in values:
            report.add_row(promise.key, "-", "-", "", "[yellow]not measured[/]", promise.meaning)
            continue
        one = values[promise.key]
        holds = promise.holds(one.value)
        all_hold &= holds
        worst = min(one.repetitions) if promise.at_least else max(one.repetitions)
        bound = "" if promise.bound is None else f"{'>=' if promise.at_least else '<='} {promise.bound:g}"
        report.add_row(
            promise.key,
            f"{one.value:.3g}",
            f"{worst:.3g}",
            bound,
            "" if promise.bound is None else "[green]pass[/]" if holds else "[red]FAIL[/]",
            promise.meaning,
        )
    return report, all_hold


def main() -> int:
    """Run the bench; 1 when a promise does not hold."""
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 110)
    measured = measure_all(lambda text: console.print(text, markup=False))
    content = {
        **{one.key: one.value for one in measured},
        "repetitions": {one.key: list(one.repetitions) for one in measured},
        "machine": {
            "processor": processor(),
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "system": platform.platform(),
        },
    }
    RESULT.write_text(json.dumps(content, indent=2) + "\n")
    report, all_hold = table(measured)
    console.print(report)
    console.print(f"-> {RESULT}")
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main())
