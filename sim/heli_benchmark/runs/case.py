"""One case from its flights to its row, with files that let an interrupted run continue."""

from __future__ import annotations

import hashlib
import json
import os
import time
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final, Generic, NamedTuple, Protocol, TypeVar

import heli_lab
import heli_sim
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.errors import FlightAborted
from heli_lab.diagnose import Diagnosis, diagnose, to_json
from heli_sim.errors import SimError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig, load_rig

from heli_benchmark.cases.clean import Case, clean_cases
from heli_benchmark.cases.disturbed import DisturbedCase, disturbed_cases
from heli_benchmark.judge import Row, judge
from heli_benchmark.truth import InformedFit, fit_informed, hidden_in
from heli_benchmark.visibility import visibility

REFITS: Final = 80
"""Refits of a search, the default of the command line."""


class _FlyableCase(Protocol):
    """A case that can fly its two flights itself."""

    @property
    def name(self) -> str: ...
    @property
    def rig_name(self) -> str: ...
    def both_flights(self) -> tuple[Flight, Flight]: ...


_Case = TypeVar("_Case", bound=_FlyableCase)


def run_diagnosis(
    rig: Rig, flights: tuple[Flight, Flight], refits: int = REFITS, unlisted: Collection[str] = ()
) -> Diagnosis:
    """Diagnose two flights; the diagnosis gets the nominal rig and no truth."""
    kinds = {id_: kind for id_, kind in catalogue().items() if id_ not in unlisted}
    return diagnose(
        MultibodyModel(), rig, flights[:1], flights[1:], kinds=kinds, labels=["a", "b"], refits=refits
    )


def diagnosis_json(rig: Rig, flights: tuple[Flight, Flight], refits: int = REFITS) -> dict[str, Any]:
    """Return the result of `run_diagnosis`, with at most `refits` refits, as JSON."""
    return to_json(run_diagnosis(rig, flights, refits))


class DiagnosedCase(NamedTuple, Generic[_Case]):
    """A case and its diagnosis."""

    case: _Case
    result: dict[str, Any]  # The diagnosis as JSON
    cpu_s: float  # Processor time of the diagnosis


def diagnosed_cases(cases: Iterable[_Case]) -> Iterator[DiagnosedCase[_Case]]:
    """Fly and diagnose `cases`."""
    for case in cases:
        try:
            flights = case.both_flights()
        except FlightAborted as error:
            print(f"{case.name:55} not flown: {error}", flush=True)
            continue
        started_s = time.process_time()
        result = diagnosis_json(load_rig(case.rig_name), flights)
        yield DiagnosedCase(case, result, time.process_time() - started_s)


def timed_diagnosis(rig: Rig, flights: tuple[Flight, Flight], refits: int = REFITS) -> dict[str, Any]:
    """Diagnose two flights, and measure the time."""
    started_s, started_cpu_s = time.perf_counter(), _cpu_s()
    result, failure = None, ""
    try:
        result = diagnosis_json(rig, flights, refits)
    except (SimError, ArithmeticError, LookupError, TypeError, ValueError) as error:
        # An error in one case must not end the run; it counts as a miss and is reported.
        failure = f"{type(error).__name__}: {error}"
    return {
        "result": result,
        "failure": failure,
        "seconds": time.perf_counter() - started_s,
        "cpu_seconds": _cpu_s() - started_cpu_s,
    }


def _cpu_s() -> float:
    """CPU time of this process and of the children that it has waited for."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


WORK = f"{__name__}:run_named_case"
"""Address of the function that a campaign calls for each case."""
_BENCHMARK = Path(__file__).parents[1]
_SIM, _LAB = Path(heli_sim.__file__).parent, Path(heli_lab.__file__).parent
_FLIGHT_FILES = (
    *(_BENCHMARK / name for name in ("plant.py", "flights.py", "cases/clean.py", "cases/disturbed.py")),
    *sorted((_BENCHMARK / "effects").glob("*.py")),
)
_DIAGNOSIS_FILES = tuple(
    path
    for room in (
        *(_LAB / name for name in ("explain", "fit")),
        *(_SIM / name for name in ("evaluate", "model", "rig")),
        *(_SIM.with_name(name) for name in ("kalman", "expression_vm")),
    )
    for path in sorted(room.rglob("*"))
    if path.suffix in (".py", ".toml", ".hpp", ".cpp", ".c")
)
"""Files that an answer depends on."""
_PAPER = "makki2024"


@dataclass(frozen=True)
class PreparedCase:
    """Flights of a case, and how visible its causes are."""

    flights: tuple[Flight, Flight]  # Training and validation flight
    rig: Rig  # The nominal rig
    reference: InformedFit | dict[str, float]
    """The fit with the true causes; with disturbances, the visibility of each cause in standard deviations.
    """


def run(case: Case, folder: Path, *, keep: bool = False, refits: int = REFITS) -> Row:
    """Fly a case, diagnose its flights, and judge the answer."""
    prepared = prepare(case, folder, keep=keep)
    code = _digest_of_files("", _DIAGNOSIS_FILES)
    case_folder = folder / case.name / "diagnosis.json"
    answer = _cached_result(
        case_folder, code, keep, lambda: timed_diagnosis(prepared.rig, prepared.flights, refits)
    )
    return judge(
        case,
        hidden_in(case, _motors_on_s(prepared.flights[0], prepared.rig)),
        prepared.reference,
        answer["result"],
        answer["seconds"],
        answer["failure"],
        cpu_seconds=answer["cpu_seconds"],
        disturbances=_conditions_text(case) if isinstance(case, DisturbedCase) else {},
    )


def run_named_case(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run a case of a campaign by its name in `settings`; return its summary and its row."""
    cases = (*clean_cases(), *disturbed_cases())
    case = next(candidate for candidate in cases if candidate.name == settings["case"])
    row = run(case, Path(settings["folder"]), keep=settings["keep"], refits=settings["refits"])
    answer = {
        "verdict": row.verdict,
        "right": row.right,
        "failure": row.failure,
        "causes": ", ".join(row.named),
    }
    return answer, asdict(row)


def code_of_rows() -> str:
    """Return the digest of all files that a row depends on: flights, diagnosis and scoring."""
    return _digest_of_files("", (*sorted(_BENCHMARK.rglob("*.py")), *_DIAGNOSIS_FILES))


def prepare(case: Case, folder: Path, *, keep: bool = False) -> PreparedCase:
    """Fly a case, and compute how visible its causes are."""
    case_folder = folder / case.name
    case_folder.mkdir(parents=True, exist_ok=True)
    made_by = _digest_of_files(repr(case), _FLIGHT_FILES)
    digest_file = case_folder / "made_by.txt"
    is_current = digest_file.exists() and digest_file.read_text() == made_by
    has_files = any(case_folder.iterdir())
    if not is_current and not (keep and has_files):
        for old_file in case_folder.iterdir():
            old_file.unlink()
        # Written before the flights: each is complete or absent, so an interrupted run keeps the first.
        digest_file.write_text(made_by)
    paths = case.flights(folder)
    flights = read_flight(paths[0]), read_flight(paths[1])
    rig = load_rig(case.rig_name if isinstance(case, DisturbedCase) else _PAPER)
    if isinstance(case, DisturbedCase):
        # Visibility against the disturbances replaces the fit with the true causes.
        code = _digest_of_files(made_by, [_BENCHMARK / "visibility.py"])
        visible = _cached_result(case_folder / "visibility.json", code, keep, lambda: dict(visibility(case)))
        return PreparedCase(flights, rig, visible)
    # The truth does not depend on the laboratory: an edit there does not require 127 new fits.
    hidden = hidden_in(case, _motors_on_s(flights[0], rig))
    code = _digest_of_files(made_by, [_BENCHMARK / "truth.py"])
    informed = _cached_result(
        case_folder / "informed.json", code, keep, lambda: asdict(fit_informed(rig, flights, hidden))
    )
    return PreparedCase(flights, rig, InformedFit(**informed))


def cause_visibility(case: Case, folder: Path, keep: bool) -> dict[str, float | None]:
    """Return the standard deviations by which each cause of a case is visible; None if it has no size."""
    reference = prepare(case, folder, keep=keep).reference
    return reference.significance if isinstance(reference, InformedFit) else dict(reference)


def _conditions_text(case: DisturbedCase) -> dict[str, Any]:
    """Return rig, rate, controller and disturbances of a case, for tables of results."""
    disturbances = case.disturbances
    return {
        "rig": case.rig_name,
        "rate_Hz": case.rate_Hz,
        "gentle": case.gentle,
        "controller": case.controller,
        "gusts_Nm": list(disturbances.gusts_Nm),
        "correlation_time_s": disturbances.correlation_time_s,
        "slow_std_Nm": list(disturbances.slow_std_Nm),
    }


def _motors_on_s(flight: Flight, rig: Rig) -> float:
    """Return the time from the start of the log until a motor first gets a voltage."""
    # Drivers pass no voltage below their dead band.
    dead_band_V = rig["driver_dead_band"].value * rig["supply"].value
    is_on = (flight.voltages_V > dead_band_V).any(axis=1)
    return float(flight.t_s[is_on][0] - flight.t_s[0])


def _cached_result(
    path: Path, made_by: str, keep: bool, compute: Callable[[], dict[str, Any]]
) -> dict[str, Any]:
    """Return the result in the file `path`; if it is missing or outdated, `compute` and write it."""
    # A result is outdated if code of another digest than `made_by` wrote it, unless `keep` is set.
    if path.exists():
        earlier: dict[str, Any] = json.loads(path.read_text())
        if keep or earlier["made_by"] == made_by:
            return dict(earlier["what"])
    result = compute()
    # Renamed when complete, so that an interrupted run leaves no partial file.
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps({"made_by": made_by, "what": result}, indent=1, default=float))
    unfinished.rename(path)
    return result


def _digest_of_files(text: str, files: Iterable[Path]) -> str:
    """Return the SHA-256 of a text followed by the content of files."""
    digest = hashlib.sha256(text.encode())
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()
