"""``heli-host export``: a log for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heli_host.cli.verb import Verb


def export(
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A .mcap, .csv or .csv.gz file.")],
    csv: Annotated[bool, typer.Option("--csv", help="A table that every program reads.")] = False,
    mat: Annotated[bool, typer.Option("--mat", help="A MATLAB file.")] = False,
    parquet: Annotated[bool, typer.Option("--parquet", help="A Parquet file; needs pyarrow.")] = False,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="File to write; else beside the log."),
    ] = None,
) -> None:
    """Write a log as a table, for MATLAB, or as Parquet.

    Example: `heli-host export flights/2026-01-31_12-00-00/flight.mcap --csv`
    """
    if csv + mat + parquet != 1:
        raise typer.BadParameter("give one of --csv, --mat and --parquet")
    from heli_host.log.export import export_mat, export_parquet
    from heli_host.log.flight_file import read_flight
    from heli_host.log.table import write_csv

    flight = read_flight(log, allow_gaps=True)
    write, suffix = (
        (write_csv, ".csv") if csv else (export_mat, ".mat") if mat else (export_parquet, ".parquet")
    )
    target = out if out is not None else log.with_name(_stem(log) + suffix)
    if target.exists() and target.samefile(log):
        raise typer.BadParameter(f"{target} is the log itself; name another file with --out")
    write(flight, target)
    gaps = f", {len(flight.gaps)} gaps" if len(flight.gaps) else ""
    print(f"{len(flight)} rows{gaps} -> {target}")


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").rpartition(".")[0]


VERB = Verb(export, "Logs")
