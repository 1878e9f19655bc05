"""``heli-host export``: a log for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.cli.say import say
from heli_host.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.flight import Flight


def export(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A .mcap, .csv or .csv.gz file.")],
    csv: Annotated[bool, typer.Option("--csv", help="A table that every program reads.")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="A MATLAB file.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="A Parquet file; needs pyarrow.")] = False,
    ros2: Annotated[bool, typer.Option("--ros2", help="An MCAP file of ROS 2, all of it in CDR.")] = False,
    blind: Annotated[
        bool,
        typer.Option("--blind", help="Leave out what flew: address, rig, effects, seed; seal it instead."),
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
    """Write a log as a table, for MATLAB, as Parquet, or as a bag of ROS 2.

    Names are the same in each (`elevation_rad`, `front_V`, `elevation_count`), but that ROS 2 takes no
    capitals: there it is `front_volt`.

    With --blind the export has a seal, a salted digest of what is left out. The truth is written next to the
    log, as LOG.truth.json: keep it. `heli-host info LOG --truth LOG.truth.json` shows what flew and the seal.

    Example: `heli-host export flights/2026-01-31_12-00-00/flight.mcap --csv`
    """
    if csv + mat + parquet + ros2 != 1:
        raise typer.BadParameter("give one of --csv, --mat, --parquet and --ros2")
    from heli_host.log.flight_file import read_flight

    write, suffix = _format(csv, mat, parquet)
    flight = read_flight(log, allow_gaps=True)
    if blind:
        flight = _blind(flight, log)
    if output is not None and str(output) == "-":
        _to_stdout(flight, write, suffix)
        return
    target = output if output is not None else log.with_name(_stem(log) + suffix)
    if target.exists() and target.samefile(log):
        raise typer.BadParameter(f"{target} is the log itself; name another file with --output")
    write(flight, target)
    gaps = f", {len(flight.gaps)} gaps" if len(flight.gaps) else ""
    say(f"{len(flight)} rows{gaps} -> {target}")


def _format(csv: bool, mat: bool, parquet: bool) -> tuple[Callable[[Flight, Path], None], str]:
    """What writes a flight in the format asked for, and how its files' names end."""
    from heli_host.log.export import export_mat, export_parquet
    from heli_host.log.ros2 import export_ros2
    from heli_host.log.table import write_csv

    if csv:
        return write_csv, ".csv"
    if mat:
        return export_mat, ".mat"
    return (export_parquet, ".parquet") if parquet else (export_ros2, ".ros2.mcap")


def _blind(flight: Flight, log: Path) -> Flight:
    """The flight without what says what flew; what was left out goes into the truth file of the log."""
    from heli_host.cli.say import say_error
    from heli_host.log.blind import SEALED, blind, sealed_truth, truth_path

    truth = sealed_truth(flight, log)
    if truth is None:
        return blind(flight, flight.meta[SEALED])
    truth.write(truth_path(log))
    say_error(f"sealed: {truth.digest}", f"truth, not for those who search: {truth_path(log)}")
    return blind(flight, truth.digest)


def _to_stdout(flight: Flight, write: Callable[[Flight, Path], None], suffix: str) -> None:
    """Write the bytes of a table to standard output, for another program to read."""
    import sys
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / f"flight{suffix}"
        write(flight, target)
        sys.stdout.flush()
        sys.stdout.buffer.write(target.read_bytes())
        sys.stdout.buffer.flush()


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").rpartition(".")[0]


VERB = Verb(export, "Logs")
