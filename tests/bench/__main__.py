"""``python -m tests.bench``: measure everything, write bench.json, print a table."""

from __future__ import annotations

import argparse
import json
import os
import platform
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.table import Table

from tests.bench.parts import PARTS, Part
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


def measured_by(parts: Sequence[Part], console: Console) -> list[Measured]:
    """Measure some parts, one after the other; a part that lacks something is skipped and says what."""
    measured: list[Measured] = []
    for number, part in enumerate(parts, 1):
        console.print(f"[{number}/{len(parts)}] {part.what} (about {part.usual_time()})", markup=False)
        lack = part.lack()
        if lack:
            console.print(f"      skipped: {lack}", markup=False)
        else:
            measured += part.measure(lambda text: console.print(text, markup=False))
    return measured


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
    measured = measured_by([part for part in PARTS if not chosen or part.name in chosen], console)
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
    return 0 if all_hold else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
