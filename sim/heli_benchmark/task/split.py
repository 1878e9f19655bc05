"""A split: a folder of cases, the names of all causes, and the truth in a folder of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task.axis_series import AxisSeries, read_series
from heli_benchmark.task.commitments import read_commitments, verify_commitment
from heli_benchmark.task.json_file import read_json

SCHEMA: Final = 1
"""Number of the layout of all files of a split; it grows when a key is renamed or removed."""
NOTHING: Final = "nothing"
"""Name of the answer that nothing is hidden."""
UNLISTED: Final = "unlisted"
"""Name of a hidden cause that the list of causes does not have."""
CAUSES_FILE: Final = "causes.json"
_REMEDY: Final = "give a folder that `heli-host benchmark make` wrote"


@dataclass(frozen=True)
class Causes:
    """Names that an answer may use."""

    base_rates: Mapping[str, float]
    """Share of the cases in which each cause is hidden, as the split was drawn. It includes `nothing` and
    `unlisted`."""
    parameters: Mapping[str, Mapping[str, str]]  # Parameters of each cause and their units

    @property
    def names(self) -> tuple[str, ...]:
        """All names, with `nothing` and `unlisted`."""
        return tuple(self.base_rates)

    @property
    def listed(self) -> tuple[str, ...]:
        """Names of the causes, without `nothing` and `unlisted`."""
        return tuple(name for name in self.base_rates if name not in (NOTHING, UNLISTED))

    @cached_property
    def parameter_names(self) -> frozenset[str]:
        """Names of all parameters of all causes."""
        return frozenset(name for parameters in self.parameters.values() for name in parameters)


@dataclass(frozen=True)
class Split:
    """A folder of cases."""

    folder: Path  # Folder that contains `causes.json`, `cases`, and, if the split is open, `truth`
    name: str  # Its name: public, train, or another word
    causes: Causes  # Names that an answer may use
    truth_folder: Path  # Folder of the truths; a sealed split comes without it
    commitments: Mapping[str, str] | None = None
    """Digest of each truth of a sealed split by case, None for an open split."""

    @property
    def cases(self) -> list[Path]:
        """Folders of the cases, in order."""
        return sorted(path for path in (self.folder / "cases").iterdir() if path.is_dir())

    def truth(self, case: str) -> dict[str, Any]:
        """Read the truth of a case."""
        file = self.truth_folder / f"{case}.json"
        if self.commitments is not None:
            verify_commitment(file, self.commitments.get(case))
        return read_json(file, "give the folder of the truths with --truth")

    def unlisted_torques_Nm(self, case: str) -> dict[str, AxisSeries]:
        """Read the torques of the unlisted causes of a case along its validation flights, by flight."""
        file = self.truth_folder / torques_file(case)
        if not file.exists():
            return {}
        return read_series(read_json(file, _REMEDY), "Nm", str(file))


def torques_file(case: str) -> str:
    """Return the name of the file with the torques of the unlisted causes of a case."""
    return f"{case}-torques.json"


def read_split(folder: Path, truth_folder: Path | None = None) -> Split:
    """Read a split."""
    content = read_json(folder / CAUSES_FILE, _REMEDY, ("schema", "split", "causes"))
    if content.get("schema") != SCHEMA:
        raise BenchmarkError(
            f"{folder / CAUSES_FILE} has schema {content.get('schema')}, not {SCHEMA}", "make the split again"
        )
    sealed = "secret_sha256" in content
    split = Split(
        folder,
        str(content["split"]),
        causes_of(content),
        truth_folder or folder / "truth",
        read_commitments(folder) if sealed else None,
    )
    if not (folder / "cases").is_dir() or not split.cases:
        raise BenchmarkError(f"{folder} has no case", _REMEDY)
    return split


def causes_of(content: Mapping[str, Any]) -> Causes:
    """Return the causes in the `content` of a causes file."""
    return Causes(
        {name: float(cause["base_rate"]) for name, cause in content["causes"].items()},
        {name: dict(cause["parameters"]) for name, cause in content["causes"].items()},
    )
