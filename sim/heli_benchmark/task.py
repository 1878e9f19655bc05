"""Format of the published benchmark: folders of cases, answers, names of causes."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.files import file_digest, read_file
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import write_csv
from heli_sim.rig import RIG_QUANTITIES, Rig, load_rig, write_rig

from heli_benchmark.errors import BenchmarkError

_MOST_BYTES: Final = 1 << 24
"""Largest file. The names of a split need 10 kB, and an answer with a predicted flight at 500 Hz 2 MB."""


def read_json(path: Path, remedy: str, keys: Sequence[str] = ()) -> dict[str, Any]:
    """Read a JSON object."""
    try:
        content = json.loads(read_file(path, _MOST_BYTES))
    except OSError as error:
        raise BenchmarkError(f"cannot read {path}: {error.strerror or error}", remedy) from None
    except (ValueError, RecursionError):
        raise BenchmarkError(f"{path} is not valid JSON", remedy) from None
    if not isinstance(content, dict):
        raise BenchmarkError(f"{path} is not a JSON object", remedy)
    for key in keys:
        if key not in content:
            raise BenchmarkError(f"{path} has no '{key}'", remedy)
    return content


def write_json(path: Path, content: object) -> None:
    """Write JSON; the file is complete or absent."""
    unfinished = path.with_name(f"unfinished-{path.name}")
    unfinished.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    unfinished.replace(path)


_AXES: Final = ("elevation", "pitch", "travel")
_FLIGHT: Final = re.compile(r"validation-[1-9]\d?")
_MIN_ROWS, _MAX_ROWS = 2, 100_000


@dataclass(frozen=True, eq=False)
class AxisSeries:
    """Numbers of the three axes over time."""

    t_s: Floats  # (n,): Times on the clock of the flight, rising
    values: Floats  # (n, 3): Elevation, pitch and travel

    def at(self, t_s: Floats) -> Floats:
        """Interpolate at other times, shape (m, 3); NaN outside of the times of the series. Shapes: `t_s`
        (m,).
        """
        columns = [np.interp(t_s, self.t_s, column, np.nan, np.nan) for column in self.values.T]
        return np.stack(columns, axis=1)


def flight_name(number: int) -> str:
    """Return the name of a validation flight."""
    return f"validation-{number + 1}"


def read_series(content: object, unit: str, where: str) -> dict[str, AxisSeries]:
    """Check and convert series by flight."""
    keys = ["t_s", *(f"{axis}_{unit}" for axis in _AXES)]
    if not isinstance(content, Mapping):
        raise BenchmarkError(f"{where} is not an object", "give one entry per validation flight")
    series = {}
    for name, columns in content.items():
        if not _FLIGHT.fullmatch(str(name)):
            raise BenchmarkError(
                f"{where}: unknown flight '{name}'", "name the flights validation-1 and so on"
            )
        if not isinstance(columns, Mapping) or set(columns) != set(keys):
            raise BenchmarkError(f"{where}: {name} has other keys", f"give {', '.join(keys)}")
        series[str(name)] = _checked_series([columns[key] for key in keys], f"{where}: {name}")
    return series


def _checked_series(lists: list[Any], where: str) -> AxisSeries:
    """Check and convert the lists of times, elevation, pitch and travel; `where` names them in messages."""
    remedy = f"give four lists of {_MIN_ROWS} to {_MAX_ROWS} finite numbers, with rising times"
    try:
        # Below, the type of the array shows text, truth values and nested lists.
        columns = [np.array(numbers) for numbers in lists if isinstance(numbers, list)]
        table = np.stack(columns, axis=1)
    except ValueError:
        raise BenchmarkError(f"{where} has lists of different lengths", remedy) from None
    if table.ndim != 2 or table.shape[1] != len(lists) or table.dtype.kind not in "if":
        raise BenchmarkError(f"{where} has lists without numbers", remedy)
    values: Floats = table.astype(np.float64)
    if not _MIN_ROWS <= len(values) <= _MAX_ROWS:
        raise BenchmarkError(f"{where} has {len(values)} rows", remedy)
    if not np.isfinite(values).all() or (np.diff(values[:, 0]) <= 0.0).any():
        raise BenchmarkError(f"{where} has times that do not rise, or numbers that are not finite", remedy)
    return AxisSeries(values[:, 0].copy(), values[:, 1:].copy())


def series_content(series: Mapping[str, AxisSeries], unit: str) -> dict[str, dict[str, list[float]]]:
    """Return series by flight as the content of a file; `unit` ends the keys of the axes."""
    return {
        name: {"t_s": axes.t_s.tolist()}
        | {f"{axis}_{unit}": column.tolist() for axis, column in zip(_AXES, axes.values.T, strict=True)}
        for name, axes in series.items()
    }


PARTS: Mapping[str, tuple[str, ...]] = {"rotor_lag_with_delay": ("rotor_lag", "input_delay")}
"""Effects of the catalogue that combine others; the generator hides the parts."""
_SUFFIXES: Final = {"rotor_lag": "lag_s", "input_delay": "delay_s"}


def of_parts(id_: str, parameters: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Split a cause that combines several effects."""
    if id_ not in PARTS:
        return {id_: dict(parameters)}
    # Name of the parameter of each part within the combined cause.
    names = {part: f"{id_}_{suffix}" for part, suffix in _SUFFIXES.items()}
    return {part: {f"{part}_s": parameters[names[part]]} for part in PARTS[id_] if names[part] in parameters}


COMMITMENTS_FILE: Final = "commitments.json"


def write_commitments(split_folder: Path, truth_folder: Path, names: list[str]) -> None:
    """Write the SHA-256 digest of each case's truth into the folder of the split."""
    digests = {name: file_digest(truth_folder / f"{name}.json") for name in names}
    write_json(split_folder / COMMITMENTS_FILE, {"sha256": digests})


def read_commitments(split_folder: Path) -> Mapping[str, str]:
    """Read the commitments in a `split_folder`: a digest by case."""
    remedy = "run the same `heli-host benchmark make` again, it continues"
    digests = read_json(split_folder / COMMITMENTS_FILE, remedy, ("sha256",))["sha256"]
    if not isinstance(digests, dict):
        raise BenchmarkError(f"{split_folder / COMMITMENTS_FILE} has no digests by case", remedy)
    return {str(name): str(digest) for name, digest in digests.items()}


def verify_commitment(truth_file: Path, digest: str | None) -> None:
    """Refuse a truth that is not the one the split committed to."""
    if digest is None:
        raise BenchmarkError(
            f"{COMMITMENTS_FILE} has no commitment to {truth_file.stem}", "use the split as it was published"
        )
    if not truth_file.exists():
        raise BenchmarkError(f"there is no truth {truth_file}", "give the folder of the truths with --truth")
    if file_digest(truth_file) != digest:
        raise BenchmarkError(
            f"{truth_file} is not the truth that the split committed to", "use the truth as it was written"
        )


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
    """Read a split; without a `truth_folder`, its truths are in its folder `truth`."""
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
    """Read a case from its folder; a method may also have `resources`."""
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
    """Write the files of a case: six columns per flight, as CSV and as Parquet."""
    from heli_host.data.log.table import export_parquet

    write_rig(rig, folder / RIG_FILE)
    for kind, flights in ((_TRAINING, training), (_VALIDATION, validation)):
        for number, flight in enumerate(flights, 1):
            write_csv(flight, folder / f"{kind}-{number}.csv")
            # The same numbers in both files: a method may read either.
            export_parquet(read_flight(folder / f"{kind}-{number}.csv"), folder / f"{kind}-{number}.parquet")


_KEYS: Final = {
    *("schema", "probabilities", "parameters"),
    *("equation", "equation_torques", "predicted_flights"),
}
_RIG_PARAMETERS: Final = frozenset(quantity.name for quantity in RIG_QUANTITIES)
_ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Estimate:
    """An estimated parameter."""

    value: float  # The estimate, in the unit of the causes file
    std: float  # Its standard error


@dataclass(frozen=True)
class Answer:
    """Answer to a case."""

    probabilities: Mapping[str, float]
    """Probability that each cause is hidden, with `nothing` and `unlisted`. A name without an entry has 0.
    Several causes may be hidden together, so that the probabilities need not add up to 1."""
    parameters: Mapping[str, Estimate] = field(default_factory=dict)
    """Estimates by name, of causes or of the rig."""
    equation: str = ""  # An equation in words or symbols, for readers; it is not scored
    equation_torques: Mapping[str, AxisSeries] = field(default_factory=dict)
    """Torques of the unlisted cause along validation flights, by flight, N m; empty if there are none."""
    predicted_flights: Mapping[str, AxisSeries] = field(default_factory=dict)
    """Angles of validation flights, rad, each predicted from the voltages and from the angles up to 1 s
    earlier; empty if the model of the answer predicts."""


def check_answer(content: object, causes: Causes, where: str) -> Answer:
    """Check the content of an answer."""
    if not isinstance(content, Mapping):
        raise BenchmarkError(f"{where}: the answer is not an object", "return a dictionary")
    if unknown := sorted(str(key) for key in content if key not in _KEYS):
        raise BenchmarkError(f"{where}: unknown key '{unknown[0]}'", f"use {', '.join(sorted(_KEYS))}")
    if content.get("schema") != SCHEMA:
        raise BenchmarkError(f"{where}: schema is {content.get('schema')!r}", f"set schema to {SCHEMA}")
    probabilities = content.get("probabilities")
    if not isinstance(probabilities, Mapping) or not probabilities:
        raise BenchmarkError(f"{where}: there are no probabilities", "add an object 'probabilities'")
    _check_probabilities(probabilities, causes, where)
    equation = content.get("equation", "")
    if not isinstance(equation, str):
        raise BenchmarkError(f"{where}: the equation is not text", "give text, or leave the key out")
    parameters = _read_parameters(content.get("parameters", {}), causes, where)
    return Answer(
        {name: float(value) for name, value in probabilities.items()},
        parameters,
        equation,
        read_series(content.get("equation_torques", {}), "Nm", f"{where}: 'equation_torques'"),
        read_series(content.get("predicted_flights", {}), "rad", f"{where}: 'predicted_flights'"),
    )


def _check_probabilities(probabilities: Mapping[Any, Any], causes: Causes, where: str) -> None:
    """Raise BenchmarkError if a name is unknown, or if the probabilities contradict each other."""
    for name, value in probabilities.items():
        if name not in causes.base_rates:
            raise BenchmarkError(f"{where}: unknown cause '{name}'", "choose from causes.json")
        if not _is_number(value) or not 0.0 <= value <= 1.0:
            raise BenchmarkError(
                f"{where}: the probability of '{name}' is {value!r}", "give a number from 0 to 1"
            )
    highest = max((value for name, value in probabilities.items() if name != NOTHING), default=0.0)
    if probabilities.get(NOTHING, 0.0) + highest > 1.0 + _ROUNDING:
        raise BenchmarkError(
            f"{where}: the probabilities of 'nothing' and of a cause add up to more than 1",
            "lower one of them; both cannot be true",
        )


def _read_parameters(content: object, causes: Causes, where: str) -> dict[str, Estimate]:
    """Check and convert the estimates of an answer."""
    if not isinstance(content, Mapping):
        raise BenchmarkError(f"{where}: 'parameters' is not an object", "give value and std by name")
    for name, estimate in content.items():
        if name not in causes.parameter_names and name not in _RIG_PARAMETERS:
            raise BenchmarkError(
                f"{where}: unknown parameter '{name}'", "choose from causes.json or rig.toml"
            )
        if not isinstance(estimate, Mapping) or set(estimate) != {"value", "std"}:
            raise BenchmarkError(f"{where}: '{name}' needs a value and a std", "give both, nothing else")
        value, std = estimate["value"], estimate["std"]
        if not _is_number(value) or not _is_number(std) or std <= 0.0:
            raise BenchmarkError(
                f"{where}: '{name}' has value {value!r} and std {std!r}",
                "give finite numbers and a positive std",
            )
    return {
        name: Estimate(float(estimate["value"]), float(estimate["std"])) for name, estimate in content.items()
    }


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def read_answer(path: Path, causes: Causes) -> Answer:
    """Read and check an answer."""
    return check_answer(read_json(path, "write the answer again"), causes, str(path))


def write_answer(path: Path, answer: Answer) -> None:
    """Write an answer as JSON."""
    write_json(path, answer_content(answer))


def answer_content(answer: Answer) -> dict[str, Any]:
    """Return an answer as the content of its file."""
    return {
        "schema": SCHEMA,
        "probabilities": dict(answer.probabilities),
        "parameters": {name: asdict(estimate) for name, estimate in answer.parameters.items()},
        "equation": answer.equation,
        "equation_torques": series_content(answer.equation_torques, "Nm"),
        "predicted_flights": series_content(answer.predicted_flights, "rad"),
    }


def answer_with(
    causes: Causes, named: Mapping[str, float], parameters: Mapping[str, Estimate] | None = None
) -> dict[str, Any]:
    """Return the content of an answer that gives probabilities for some causes only. Values outside of 0 to 1
    are clipped.
    """
    named = {name: min(max(value, 0.0), 1.0) for name, value in named.items()}
    highest_named = max((value for name, value in named.items() if name != NOTHING), default=0.0)
    # Other causes keep a share of their base rates: the less certain `named` is, the larger the share.
    # Several causes may be hidden together: a certain cause halves the rates of the others, no more.
    share = (1.0 - 0.5 * highest_named) * (1.0 - named.get(NOTHING, 0.0))
    all_probabilities = {name: rate * share for name, rate in causes.base_rates.items()} | named
    if named and NOTHING not in named:
        all_probabilities[NOTHING] = math.prod(1.0 - value for value in named.values())
    # "Nothing" and any cause exclude each other, so both together have at most 1.
    highest = max(value for name, value in all_probabilities.items() if name != NOTHING)
    all_probabilities[NOTHING] = min(all_probabilities[NOTHING], 1.0 - highest)
    return answer_content(Answer(all_probabilities, parameters or {}))
