"""A case as a method sees it: a rig with tolerances, flights, and the names of all causes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Final

from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import write_csv
from heli_sim.rig import Rig, load_rig, write_rig

from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task.json_file import read_json
from heli_benchmark.task.split import CAUSES_FILE, Causes, causes_of

RIG_FILE: Final = "rig.toml"
_TRAINING, _VALIDATION = "training", "validation"


@dataclass(frozen=True)
class BenchmarkCase:
    """Input of a method."""

    name: str  # Name of the case
    rig: Rig  # Nominal parameters; a tolerance is two standard deviations
    training: tuple[Flight, ...]  # training, validation: Flights to learn from, and flights to check on
    validation: tuple[Flight, ...]
    causes: Causes  # Names that an answer may use
    resources: Path | None = None  # Folder that the user gave to the method, such as a trained model


def read_case(folder: Path, resources: Path | None = None) -> BenchmarkCase:
    """Read a case from its folder."""
    remedy = "give the folder of a case in a split"
    causes = causes_of(read_json(folder.parents[1] / CAUSES_FILE, remedy))
    flights = {
        kind: tuple(read_flight(path) for path in sorted(folder.glob(f"{kind}-*.csv")))
        for kind in (_TRAINING, _VALIDATION)
    }
    if not all(flights.values()):
        raise BenchmarkError(f"{folder} has no training or no validation flight", remedy)
    rig = load_rig(folder / RIG_FILE)
    return BenchmarkCase(folder.name, rig, flights[_TRAINING], flights[_VALIDATION], causes, resources)


def write_case(folder: Path, rig: Rig, training: tuple[Flight, ...], validation: tuple[Flight, ...]) -> None:
    """Write the files of a case: six columns per flight, as CSV and as Parquet.

    `folder`: Folder to write into; it must exist.
    """
    from heli_host.data.log.table import export_parquet

    write_rig(rig, folder / RIG_FILE)
    for kind, flights in ((_TRAINING, training), (_VALIDATION, validation)):
        for number, flight in enumerate(flights, 1):
            write_csv(flight, folder / f"{kind}-{number}.csv")
            # The same numbers in both files: a method may read either.
            export_parquet(read_flight(folder / f"{kind}-{number}.csv"), folder / f"{kind}-{number}.parquet")
