"""``heli-host info``: what a log holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.cli.verb import Verb
from heli_host.errors import printable

if TYPE_CHECKING:
    from heli_host.flight import Flight
    from heli_host.log.reader import Log


def info(
    flight_file: Annotated[Path, typer.Argument(metavar="LOG", help="A .mcap, .csv or .csv.gz file.")],
    events: Annotated[bool, typer.Option("--events", help="List the events too.")] = False,
    parameters: Annotated[bool, typer.Option("--params", help="List the board's parameters too.")] = False,
    plan: Annotated[bool, typer.Option("--plan", help="Print the flight plans too.")] = False,
) -> None:
    """Say what a log holds: versions, duration, tracking errors, losses, and what is wrong with it.

    Example: `heli-host info flights/2026-01-31_12-00-00/flight.mcap --events`
    """
    if flight_file.name.lower().endswith(".mcap"):
        from heli_host.log.reader import read_log

        log = read_log(flight_file)
        _print_log(log)
        flight = log.flight() if len(log.ticks) else None
    else:
        from heli_host.log.flight_file import read_flight

        flight = read_flight(flight_file, allow_gaps=True)
        _print_table(flight, flight_file)
    if flight is None:
        return
    if events:
        print("events:")
        for event in flight.events:
            print(printable(f"  {event.t_s:10.3f} s  {event.name}: {event.text}"))
    if parameters:
        print("parameters:")
        for name, value in flight.parameters.items():
            print(printable(f"  {name} = {value:g}"))
    if plan:
        for line in (flight.plan.rstrip() or "no plan").splitlines():
            print(printable(line.replace("\t", "    ")))


def _print_log(log: Log) -> None:
    from heli_host.cli.report import summary_lines
    from heli_host.log.summary import summarise

    for line in summary_lines(summarise(log)):
        print(line)
    for name, value in sorted(log.metadata.get("session", {}).items()):
        print(printable(f"{name}: {value}"))


def _print_table(flight: Flight, path: Path) -> None:
    rate_Hz = 1.0 / flight.step_s if flight.step_s else 0.0
    print(printable(f"{path}: {len(flight)} rows, {flight.duration_s:.3f} s at {rate_Hz:.6g} Hz"))
    print(printable(f"columns: {', '.join(flight.columns())}"))
    if len(flight.gaps):
        print(f"{len(flight.gaps)} gaps in time, the first after {flight.t_s[flight.gaps[0]]:.3f} s")
    for name, value in flight.meta.items():
        print(printable(f"{name}: {value}"))


VERB = Verb(info, "Logs")
