"""``heli-host export``: a log for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.ui.cli.say import say
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.data.flight import Flight

_SUFFIXES = (".csv", ".mat", ".parquet", ".ros2.mcap")
"""Ending of the files of each format, in the order of the options."""


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
        bool,
        typer.Option("--blind", help="Hide address, rig, effects and seed, and seal them."),
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
    if csv + mat + parquet + ros2 != 1:
        raise typer.BadParameter(
            "export needs exactly one format; give one of --csv, --mat, --parquet and --ros2"
        )
    from heli_host.data.log.reader import read_flight
    from heli_host.data.log.table import MAX_TABLE_BYTES, notes_path, write_csv
    from heli_host.ui.cli.outputs import check_place

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
    from heli_host.ui.cli.say import say_error

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


VERB = Verb(export, "Logs")
