"""``heli-host info``: show the content of a log."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.say import say, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.data.flight import Flight
    from heli_host.data.log.reader import Log


def info(
    flight_file: Annotated[
        Path, typer.Argument(metavar="LOG", help="Read this .mcap, .csv or .csv.gz file.")
    ],
    events: Annotated[bool, typer.Option("--events", help="List the events too.")] = False,
    parameters: Annotated[bool, typer.Option("--params", help="List the board's parameters too.")] = False,
    plan: Annotated[bool, typer.Option("--plan", help="Print the flight plans too.")] = False,
    truth: Annotated[
        Path | None,
        typer.Option(
            "--truth",
            metavar="FILE",
            help="Show what flew in a blind flight, from its truth file.",
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Show what a log contains, and what is wrong with it.

    Prints versions, duration, tracking errors and losses. The log stays unchanged.

    Example: `heli-host info flights/2026-01-31_12-00-00/flight.mcap --events`
    """
    if json is not None:
        content = _log_content(flight_file)
        if truth is not None:
            content["truth"] = _verified_truth(flight_file, truth)
        if write_result(json, content):
            return
    if truth is not None:
        for name, value in _verified_truth(flight_file, truth).items():
            # A rig's file has a hundred lines; the truth file holds them.
            value_text = ", ".join(map(str, value)) if isinstance(value, list | dict) else value
            say(f"truth, {name}: {value_text}")
    if flight_file.name.lower().endswith(".mcap"):
        from heli_host.data.log.reader import read_log

        log = read_log(flight_file)
        _print_log(log)
        flight = log.flight() if len(log.ticks) else None
    else:
        from heli_host.data.log.reader import read_flight

        flight = read_flight(flight_file, allow_gaps=True)
        _print_table(flight, flight_file)
    if flight is None:
        return
    if events:
        say("events:")
        for event in flight.events:
            say(f"  {event.t_s:10.3f} s  {event.name}: {event.text}")
    if parameters:
        say("parameters:")
        for name, value in flight.parameters.items():
            say(f"  {name} = {value:g}")
    if plan:
        for line in (flight.plan.rstrip() or "no plan").splitlines():
            say(line.replace("\t", "    "))


def _verified_truth(path: Path, truth_file: Path) -> dict[str, Any]:
    """What flew by a truth file whose seal is that of the flight; else a LogError."""
    from heli_host.data.log.blind import SEALED, Truth
    from heli_host.data.log.reader import read_flight

    truth = Truth.read(truth_file)
    truth.check(path, read_flight(path, allow_gaps=True).meta.get(SEALED, ""))
    return {SEALED: truth.digest, **truth.flown}


def _log_content(path: Path) -> dict[str, Any]:
    """Return the content of a log without its rows."""
    from heli_host.data.log.reader import read_flight, read_log
    from heli_host.data.log.summary import summarise

    content: dict[str, Any] = {"file": str(path)}
    flight: Flight | None
    if path.name.lower().endswith(".mcap"):
        log = read_log(path)
        content |= {"summary": summarise(log).as_dict(), "session": dict(log.metadata.get("session", {}))}
        flight = log.flight() if len(log.ticks) else None
    else:
        flight = read_flight(path, allow_gaps=True)
    if flight is not None:
        content |= {
            "rows": len(flight),
            "duration_s": flight.duration_s,
            "step_s": flight.step_s,
            "columns": list(flight.columns()),
            "gaps": len(flight.gaps),
            "events": [{"t_s": event.t_s, "name": event.name, "text": event.text} for event in flight.events],
            "parameters": dict(flight.parameters),
            "plan": flight.plan,
            "notes": dict(flight.meta),
        }
    return content


def _print_log(log: Log) -> None:
    """Print the summary of a log, and the notes of its session."""
    from heli_host.data.log.summary import summarise
    from heli_host.ui.cli.report import summary_lines

    for line in summary_lines(summarise(log)):
        say(line)
    for name, value in sorted(log.metadata.get("session", {}).items()):
        say(f"{name}: {value}")


def _print_table(flight: Flight, path: Path) -> None:
    """Print size, rate, columns, gaps and notes of a flight from a table."""
    rate_Hz = 1.0 / flight.step_s if flight.step_s else 0.0
    say(f"{path}: {len(flight)} rows, {flight.duration_s:.3f} s at {rate_Hz:.6g} Hz")
    say(f"columns: {', '.join(flight.columns())}")
    if len(flight.gaps):
        say(f"{len(flight.gaps)} gaps in time, the first after {flight.t_s[flight.gaps[0]]:.3f} s")
    for name, value in flight.meta.items():
        say(f"{name}: {value}")


VERB = Verb(info, "Logs")
