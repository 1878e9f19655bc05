"""``heli-host plot``: a log as a figure, or several over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb


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
    from heli_host.ui.cli.outputs import check_result_places

    check_result_places(json, figure=figure)
    data_on_stdout(json)
    is_table = logs[0].name.lower().endswith((".csv", ".csv.gz"))
    if len(logs) == 1 and is_table and figure is None and json is None:
        figure = logs[0].with_name("figure.png")
        check_result_places(figure=figure)
    if len(logs) > 1 or json is not None or is_table:
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
    say(*comparison_lines(numbers))
    say_files([figure])


VERB = Verb(plot, "Logs")
