"""``python -m tests.bench``: measure everything, write bench.json, print a table."""

import argparse
import importlib.util
import json
import os
import platform
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench.board import (
    flight_bytes,
    has_cross_compiler,
    measure_decoding,
    measure_due,
    measure_line,
    measure_plant,
    measure_reading,
    measure_recording,
    measure_simulation,
)
from tests.bench.lab import (
    diagnosis_peak,
    diagnosis_ratios,
    measure_campaign,
    measure_identification,
    measure_many_flights,
)
from tests.bench.page import measure_foxglove, measure_page
from tests.bench.result import PROMISES, Measured
from tests.bench.web import measure_web, measure_web_diagnosis

Say = Callable[[str], None]


def nothing() -> str:
    """Say that nothing is lacking."""
    return ""


def module(name: str) -> Callable[[], str]:
    """Say whether a package is lacking."""
    return lambda: "" if importlib.util.find_spec(name) else f"{name} is not installed; make bench does that"


def cross_compiler() -> str:
    """Say whether the Due's compiler is lacking."""
    return "" if has_cross_compiler() else "no cross-compiler for the Due; make firmware says how to get it"


def web_compiler() -> str:
    """Say whether the compiler for WebAssembly, or the browser's driver, is lacking."""
    return module("ziglang")() or module("playwright")()


@cache
def sent() -> tuple[bytes, float]:
    """Bytes of the board during a flight, and its duration; two parts use them."""
    return flight_bytes()


@dataclass(frozen=True)
class Part:
    """One part of the bench."""

    name: str  # Name on the command line
    what: str  # What is measured, for the line before it begins
    usual_s: float  # Usual time on two cores
    measure: Callable[[Say], list[Measured]]  # Measures; its argument shows the next step
    # Says what is not installed without which it cannot measure; empty where nothing is lacking
    lack: Callable[[], str] = nothing

    def usual_time(self) -> str:
        return f"{self.usual_s:.0f} s" if self.usual_s < 200.0 else f"{self.usual_s / 60.0:.0f} minutes"


PARTS = (
    Part("simulation", "flying in simulation as fast as possible", 60, lambda _: measure_simulation()),
    Part(
        "decoding",
        "decoding, against pymavlink",
        10,
        lambda _: measure_decoding(sent()[0]),
        module("pymavlink"),
    ),
    Part("line", "counting bytes on the line", 5, lambda _: measure_line(*sent())),
    Part("reading", "reading a ten-minute log", 10, lambda _: measure_reading()),
    Part("recording", "recording in real time", 85, lambda _: measure_recording()),
    Part("page", "stopping from the live page, and what it costs", 150, lambda _: measure_page()),
    Part(
        "foxglove",
        "stopping while a viewer takes every tick, and what the viewer costs",
        300,
        lambda _: measure_foxglove(),
        module("foxglove"),
    ),
    Part("web", "flying in Chromium, stopping, and an hour of it", 330, measure_web, web_compiler),
    Part(
        "web-diagnosis",
        "diagnosing a hidden lag from two logs of the page",
        90,
        measure_web_diagnosis,
        web_compiler,
    ),
    Part("due", "counting instructions of the Due's firmware", 40, lambda _: measure_due(), cross_compiler),
    Part(
        "plant",
        "stepping and linearising the rig, against MuJoCo",
        10,
        lambda _: measure_plant(),
        module("mujoco"),
    ),
    Part(
        "campaign",
        "a campaign of two hundred short cases, with one worker and with two",
        35,
        lambda _: measure_campaign(),
    ),
    Part("diagnosis", "diagnosing, against an earlier commit", 630, diagnosis_ratios),
    Part("memory", "diagnosing ten minutes of flight", 120, lambda _: [diagnosis_peak()]),
    Part(
        "many-flights", "diagnosing ten flights of a rig, and a hundred", 60, lambda _: measure_many_flights()
    ),
    Part("identification", "identifying fifty simulated rigs", 300, measure_identification),
)

RESULT = Path("bench.json")


def processor() -> str:
    """Return the processor's name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def measured_by(parts: Sequence[Part], console: Console) -> tuple[list[Measured], list[str]]:
    """Measure some parts, one after the other, and return the results and the names of the parts that failed.

    A part that lacks something is skipped and says what.
    """
    measured: list[Measured] = []
    failed: list[str] = []
    for number, part in enumerate(parts, 1):
        console.print(f"[{number}/{len(parts)}] {part.what} (about {part.usual_time()})", markup=False)
        lack = part.lack()
        if lack:
            console.print(f"      skipped: {lack}", markup=False)
            continue
        try:
            measured += part.measure(lambda text: console.print(text, markup=False))
        except Exception:  # noqa: BLE001 - half an hour of other parts would be lost
            console.print(traceback.format_exc(), markup=False)
            failed.append(part.name)
    return measured, failed


def table(measured: Sequence[Measured], whole: bool) -> tuple[Table, bool]:
    """Return the table, and whether every promise holds."""
    values = {result.key: result for result in measured}
    report = Table(box=None, pad_edge=False)
    for heading in ("number", "median", "worst", "bound", "", "what"):
        report.add_column(heading, no_wrap=heading != "what")
    all_hold = True
    for promise in PROMISES:
        if promise.key not in values:
            if whole:
                report.add_row(promise.key, "-", "-", "", "[yellow]not measured[/]", promise.meaning)
            continue
        result = values[promise.key]
        holds = promise.holds(result.value)
        all_hold &= holds
        worst = min(result.repetitions) if promise.at_least else max(result.repetitions)
        bound = "" if promise.bound is None else f"{'>=' if promise.at_least else '<='} {promise.bound:g}"
        report.add_row(
            promise.key,
            f"{result.value:.3g}",
            f"{worst:.3g}",
            bound,
            "" if promise.bound is None else "[green]pass[/]" if holds else "[red]FAIL[/]",
            promise.meaning,
        )
    return report, all_hold


def main(words: Sequence[str]) -> int:
    """Run the bench; 1 when a promise does not hold."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench",
        description=__doc__,
        epilog="Parts: " + "; ".join(f"{part.name}: {part.what}" for part in PARTS) + ".",
    )
    names = [part.name for part in PARTS]
    parser.add_argument(
        "parts", nargs="*", metavar="PART", help="measure these only, and leave bench.json as it is"
    )
    chosen = parser.parse_args(words).parts
    if unknown := [name for name in chosen if name not in names]:
        parser.error(f"no part is called {', '.join(unknown)}; there are {', '.join(names)}")
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 110)
    measured, failed = measured_by([part for part in PARTS if not chosen or part.name in chosen], console)
    report, all_hold = table(measured, whole=not chosen)
    if not chosen:
        content = {
            **{result.key: result.value for result in measured},
            "repetitions": {result.key: list(result.repetitions) for result in measured},
            "machine": {
                "processor": processor(),
                "cores": os.cpu_count(),
                "python": platform.python_version(),
                "system": platform.platform(),
            },
        }
        RESULT.write_text(json.dumps(content, indent=2) + "\n")
    console.print(report)
    if not chosen:
        console.print(f"-> {RESULT}")
    if failed:
        console.print(f"failed, see above: {', '.join(failed)}", markup=False)
    return 0 if all_hold and not failed else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
