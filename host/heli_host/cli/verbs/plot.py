"""``heli-host plot``: a log as a figure, or several over each other."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from heli_host.cli.options import JsonFlag
from heli_host.cli.say import say, say_files, say_json
from heli_host.cli.verb import Verb


def plot(
    logs: Annotated[
        list[Path], typer.Argument(metavar="LOG...", help="A .mcap log; of several, .csv and .csv.gz too.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "-o",
            metavar="FILE",
            help="A .png, .pdf or .svg; else figure.png beside it, or comparison.png here.",
        ),
    ] = None,
    json: JsonFlag = False,
) -> None:
    """Draw setpoints, angles, voltages and events of a log; several are laid over each other and compared.

    Of each axis that had setpoints: rise, overshoot and settling of its largest step, tracking error (rms);
    of each flight its effort, the motors' voltages' rms about their mean.

    Example: `heli-host plot pid.mcap lqr.mcap -o both.pdf`
    """
    if len(logs) > 1 or json:
        _compare(logs, out, json)
        return
    from heli_host.log.figure import write_figure
    from heli_host.log.reader import read_log
    from heli_host.log.summary import summarise

    (log,) = logs
    read = read_log(log)
    target = out if out is not None else log.with_name("figure.png")
    write_figure(read.flight(), summarise(read), target)
    say(f"{read.ticks.size} ticks -> {target}")


def _compare(logs: Sequence[Path], out: Path | None, json: bool) -> None:
    from heli_host.log.comparison import MAX_FLIGHTS, comparison_lines, comparison_numbers, write_comparison
    from heli_host.log.flight_file import read_flight

    if len(logs) > MAX_FLIGHTS:
        raise typer.BadParameter(
            f"{len(logs)} flights on one page cannot be told apart; give {MAX_FLIGHTS} at most"
        )
    labels = [str(log) for log in logs]
    if len(set(labels)) < len(labels):
        raise typer.BadParameter("a log is given twice; give each once")
    flights = {label: read_flight(log, allow_gaps=True) for label, log in zip(labels, logs, strict=True)}
    numbers = comparison_numbers(flights)
    target = out
    if out is not None or not json:
        target = out if out is not None else Path("comparison.png")
        write_comparison(flights, target)
    if json:
        say_json({"flights": numbers, "figure": None if target is None else str(target)})
        return
    say(*comparison_lines(numbers))
    say_files([target])


VERB = Verb(plot, "Logs")
