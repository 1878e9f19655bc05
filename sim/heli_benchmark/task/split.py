"""A split: a folder of cases, the names of all causes, and the truth in a folder of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from heli_benchmark.errors import BenchmarkError
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
    """Names that an answer may use.

    Parameters
    ----------
    base_rates : Mapping[str, float]
        Share of the cases in which each cause is hidden, as the split was drawn. It includes `nothing` and
        `unlisted`.
    parameters : Mapping[str, Mapping[str, str]]
        Parameters of each cause and their units.
    """

    base_rates: Mapping[str, float]
    parameters: Mapping[str, Mapping[str, str]]

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
        return frozenset(name for of in self.parameters.values() for name in of)


@dataclass(frozen=True)
class Split:
    """A folder of cases.

    Parameters
    ----------
    folder : Path
        Place of `causes.json`, `cases` and `truth`.
    name : str
        Its name: public, train, or another word.
    seed : int
        Seed that drew it.
    causes : Causes
        Names that an answer may use.
    """

    folder: Path
    name: str
    seed: int
    causes: Causes

    @property
    def cases(self) -> list[Path]:
        """Folders of the cases, in order."""
        return sorted(path for path in (self.folder / "cases").iterdir() if path.is_dir())

    def truth(self, case: str) -> dict[str, Any]:
        """Read the truth of a case.

        Parameters
        ----------
        case : str
            Name of the case.

        Raises
        ------
        BenchmarkError
            If the split has no truth of this case.
        """
        return read_json(self.folder / "truth" / f"{case}.json", "score a split that includes its truth")


def read_split(folder: Path) -> Split:
    """Read a split.

    Parameters
    ----------
    folder : Path
        Folder of the split.

    Raises
    ------
    BenchmarkError
        If the folder is not a complete split.
    """
    content = read_json(folder / CAUSES_FILE, _REMEDY, ("schema", "split", "seed", "causes"))
    if content.get("schema") != SCHEMA:
        raise BenchmarkError(
            f"{folder / CAUSES_FILE} has schema {content.get('schema')}, not {SCHEMA}", "make the split again"
        )
    split = Split(folder, str(content["split"]), int(content["seed"]), causes_of(content))
    if not (folder / "cases").is_dir() or not split.cases:
        raise BenchmarkError(f"{folder} has no case", _REMEDY)
    return split


def causes_of(content: Mapping[str, Any]) -> Causes:
    """Return the causes in the `content` of a causes file."""
    return Causes(
        {name: float(of["base_rate"]) for name, of in content["causes"].items()},
        {name: dict(of["parameters"]) for name, of in content["causes"].items()},
    )
