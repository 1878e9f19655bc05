"""The verbs that read logs: ``info``, ``plot`` and ``export``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from heli_host.ui.cli.options import JsonOption, check_place, check_result_places
from heli_host.ui.cli.say import data_on_stdout, say, say_error, say_files, summary_lines, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.data.flight import Flight
    from heli_host.data.log.reader import Log

_SUFFIXES = (".csv", ".mat", ".parquet", ".ros2.mcap")
"""Ending of the files of each format, in the order of the options."""


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
            "--truth", metavar="FILE", help="Show what flew in a blind flight, from its truth file."
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
    if flight is not None:
        _print_details(flight, events=events, parameters=parameters, plan=plan)


def _print_details(flight: Flight, *, events: bool, parameters: bool, plan: bool) -> None:
    """Print what the options ask for beyond the summary."""
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


def plot(
    logs: Annotated[
        list[Path],
        typer.Argument(
            metavar="LOG...", help="Draw this log or table, or compare several: .mcap, .csv, .csv.gz."
        ),
    ],
    figure: Annotated[
        Path | None,
        typer.Option(
            "--figure",
            metavar="FILE",
            help="Draw to .png, .pdf or .svg.  [default: figure.png next to the log, or comparison.png]",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Draw a log or a table, or compare several in one figure.

    The figure of a log shows setpoints, angles, voltages and events. For a table, and for several flights, it
    also prints metrics. For each
    axis with setpoints these are rise time, overshoot, settling time and RMS tracking error. The effort is
    the RMS deviation of the motor voltages from their mean.

    Example: `heli-host plot pid.mcap lqr.mcap --figure both.pdf`
    """
    check_result_places(json, figure=figure)
    data_on_stdout(json)
    is_table = logs[0].name.lower().endswith((".csv", ".csv.gz"))
    needs_metrics = len(logs) > 1 or json is not None or is_table
    if needs_metrics:
        if len(logs) == 1 and figure is None and json is None:
            figure = logs[0].with_name("figure.png")
            check_result_places(figure=figure)
        _compare_flights(logs, figure, json)
        return
    from heli_host.data.log.figure import write_figure
    from heli_host.data.log.reader import read_log
    from heli_host.data.log.summary import summarise

    (log,) = logs
    content = read_log(log)
    target = figure if figure is not None else log.with_name("figure.png")
    write_figure(content.flight(), summarise(content), target)
    say(f"{content.ticks.size} ticks -> {target}")


def _compare_flights(logs: Sequence[Path], figure: Path | None, json: Path | None) -> None:
    """Compare flights: metrics as JSON if requested, otherwise on the terminal; and a figure, unless only
    JSON was requested.
    """
    from heli_host.data.log.comparison import (
        MAX_FLIGHTS,
        comparison_lines,
        comparison_numbers,
        write_comparison,
    )
    from heli_host.data.log.reader import read_flight

    if len(logs) > MAX_FLIGHTS:
        raise typer.BadParameter(
            f"{len(logs)} flights are too many for one figure; give at most {MAX_FLIGHTS}"
        )
    labels = [str(log) for log in logs]
    if len(set(labels)) < len(labels):
        raise typer.BadParameter("the same log is given twice; give each log once")
    flights = {label: read_flight(log, allow_gaps=True) for label, log in zip(labels, logs, strict=True)}
    numbers = comparison_numbers(flights)
    if figure is None and json is None:
        figure = Path("comparison.png")
    if figure is not None:
        write_comparison(flights, figure)
    if write_result(json, {"flights": numbers, "figure": None if figure is None else str(figure)}):
        return
    say(*comparison_lines(numbers, flights))
    say_files([figure])


def export(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="Read this .mcap, .csv or .csv.gz file.")],
    csv: Annotated[bool, typer.Option("--csv", help="Write a CSV table.")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="Write a MATLAB file.")] = False,
    parquet: Annotated[
        bool, typer.Option("--parquet", help="Write a Parquet file. Requires pyarrow.")
    ] = False,
    ros2: Annotated[
        bool, typer.Option("--ros2", help="Write an MCAP file for ROS 2, in CDR encoding.")
    ] = False,
    blind: Annotated[
        bool, typer.Option("--blind", help="Hide address, rig, effects and seed, and seal them.")
    ] = False,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Write this file, or standard output for -.  [default: next to the log]",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Convert a log to CSV, MATLAB, Parquet or ROS 2.

    The log stays unchanged. Columns have the same names in each format, such as `elevation_rad` and
    `front_V`. ROS 2 allows no capitals, so `front_V` becomes `front_volt`. Notes of a CSV
    table, such as parameters and events, go to FILE.notes.txt, or into lines with # on standard output.

    --blind leaves out rig, effects and seed, and seals them by a salted digest. The truth goes to
    LOG.truth.json next to the log. `heli-host info LOG --truth LOG.truth.json` compares the two.

    Example: `heli-host export flights/2026-01-31_12-00-00/flight.mcap --csv`
    """
    if sum((csv, mat, parquet, ros2)) != 1:
        raise typer.BadParameter(
            "export needs exactly one format; give one of --csv, --mat, --parquet and --ros2"
        )
    from heli_host.data.log.reader import read_flight
    from heli_host.data.log.table import MAX_TABLE_BYTES, notes_path, write_csv

    write, suffix = _writer_and_ending(csv, mat, parquet)
    _check_ending(output, suffix)
    flight = read_flight(log, allow_gaps=True)
    if blind:
        flight = _without_revealing_facts(flight, log)
    if output is not None and str(output) == "-":
        _write_to_stdout(flight, write, suffix)
        return
    target = output if output is not None else log.with_name(_name_without_ending(log) + suffix)
    if target.exists() and target.samefile(log):
        raise typer.BadParameter(f"{target} is the log itself; name another file with --output")
    check_place(target)
    size_bytes = write(flight, target)
    gaps = f", {len(flight.gaps)} gaps" if len(flight.gaps) else ""
    say(f"{len(flight)} rows{gaps} -> {target}")
    if write is write_csv and notes_path(target).exists():
        say(f"parameters, plan and events -> {notes_path(target)}")
    if size_bytes is not None and size_bytes > MAX_TABLE_BYTES:
        say(
            f"note: the table has {size_bytes >> 20} MiB, and heli-host reads at most "
            f"{MAX_TABLE_BYTES >> 20} MiB; give {log} itself to the other commands"
        )


def _writer_and_ending(
    csv: bool, mat: bool, parquet: bool
) -> tuple[Callable[[Flight, Path], int | None], str]:
    """Return the function that writes the requested format, and the ending of its files."""
    from heli_host.data.log.ros2 import export_ros2
    from heli_host.data.log.table import export_mat, export_parquet, write_csv

    writers = (write_csv, export_mat, export_parquet, export_ros2)
    chosen = (csv, mat, parquet, True).index(True)
    return writers[chosen], _SUFFIXES[chosen]


def _check_ending(output: Path | None, suffix: str) -> None:
    """Refuse a name that makes other programs, and heli-host itself, take the file for another format."""
    endings = {".csv": (".csv", ".csv.gz"), ".ros2.mcap": (".mcap",)}.get(suffix, (suffix,))
    is_file = output is not None and str(output) != "-" and (output.is_file() or not output.exists())
    if output is not None and is_file and not output.name.lower().endswith(endings):
        raise typer.BadParameter(
            f"--output {output} has the ending of another format; give a name that ends in {suffix}"
        )


def _without_revealing_facts(flight: Flight, log: Path) -> Flight:
    """Return a flight without the facts that reveal its rig and effects; those go into the log's truth file.

    The flight of a log that was recorded blind is sealed already, and its truth file exists.
    """
    from heli_host.data.log.blind import SEALED, blind, sealed_truth, truth_path

    truth = sealed_truth(flight, log)
    if truth is None:
        return blind(flight, flight.meta[SEALED])
    truth.write(truth_path(log))
    say_error(f"sealed: {truth.digest}", f"truth (keep it, share only the other files): {truth_path(log)}")
    return blind(flight, truth.digest)


def _write_to_stdout(flight: Flight, write: Callable[[Flight, Path], int | None], suffix: str) -> None:
    """Write the bytes of a table to standard output, for another program to read."""
    import sys
    import tempfile

    from heli_host.data.log.table import write_csv

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"flight{suffix}"
        if write is write_csv:
            write_csv(flight, target, notes_inside=True)
        else:
            write(flight, target)
        sys.stdout.flush()
        sys.stdout.buffer.write(target.read_bytes())
        sys.stdout.buffer.flush()


def _name_without_ending(path: Path) -> str:
    return path.name.removesuffix(".gz").rpartition(".")[0]


VERBS = {verb.__name__: Verb(verb, "Logs") for verb in (export, info, plot)}
