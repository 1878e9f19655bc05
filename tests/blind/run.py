"""One case from beginning to end, kept so that a run that was interrupted goes on."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import heli_lab
import heli_sim
from heli_host.flight import Flight
from heli_host.log.flight_file import read_flight
from heli_lab.diagnose import Diagnosis, diagnose, to_json
from heli_sim.errors import SimError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig, load_rig

from tests.blind.cases import Case, every_case
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.disturbed_cases import disturbed_cases
from tests.blind.judge import Row, judged
from tests.blind.oracle import Told, tell
from tests.blind.truth import hidden_in
from tests.blind.visibility import visibility
from tests.running.clock import spent_s

REFITS = 80
"""As the command line has it."""
WORK = f"{__name__}:answered"
_HERE = Path(__file__).parent
_SIM, _LAB = Path(heli_sim.__file__).parent, Path(heli_lab.__file__).parent
_ENGINE = (
    _HERE.with_name("mujoco_rig.py"),
    *(_HERE / name for name in ("mujoco_rig.py", "hidden.py", "unlisted.py", "cases.py")),
)
_CLEAN = (*_ENGINE, _HERE / "flights.py")
_WINDY = (
    *_ENGINE,
    *(
        _HERE / name
        for name in ("measured_effects.py", "disturbances.py", "tracking.py", "disturbed_case.py")
    ),
)
_ORACLE = (_HERE / "oracle.py", _HERE / "truth.py")
_VISIBILITY = tuple(_HERE / name for name in ("course.py", "replay.py", "visibility.py"))
_PAGE = ("figures.py", "result_figures.py", "missing_law.py", "words.py", "report.py")
_ASKED = tuple(
    path
    for room in (
        *(_LAB / name for name in ("diagnose", "estimation", "identify")),
        *(_SIM / name for name in ("model", "compiled", "rig")),
        *(_SIM.with_name(name) for name in ("kalman", "expression_vm")),
    )
    for path in sorted(room.rglob("*"))
    if path.suffix in (".py", ".toml", ".hpp", ".cpp") and path.name not in _PAGE
)
"""What an answer is made by: all but the page that draws it."""
_PAPER = "makki2024"


@dataclass(frozen=True)
class Ready:
    """A case's flights, and what can be seen in them.

    Parameters
    ----------
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    rig : Rig
        What is known of the rig beforehand.
    told : Told or dict of float
        The fit that was told the answer; in weather, standard deviations of each cause above it.
    """

    flights: tuple[Flight, Flight]
    rig: Rig
    told: Told | dict[str, float]


def run(case: Case, folder: Path, *, keep: bool = False, refits: int = REFITS) -> Row:
    """Make the flights of a case, have them diagnosed, and judge the answer.

    Parameters
    ----------
    case : Case
        The case.
    folder : Path
        Where flights and results are kept.
    keep : bool
        Take flights and results that are there, whatever code they were made with.
    refits : int
        Most refits of the search.

    Returns
    -------
    Row
        The judgement.
    """
    ready = prepare(case, folder, keep=keep)
    code = _digest("", _ASKED)
    place = folder / case.name / "diagnosis.json"
    answer = _kept(place, code, keep, lambda: asked(ready.rig, ready.flights, refits))
    return judged(
        case,
        hidden_in(case, _motors_on_s(ready.flights[0], ready.rig)),
        ready.told,
        answer["result"],
        answer["seconds"],
        answer["failure"],
        cpu_seconds=answer["cpu_seconds"],
        disturbances=_conditions(case) if isinstance(case, DisturbedCase) else {},
    )


def answered(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """A case of a campaign: `run` by its name; the judgement is the detail, its sum the row."""
    every = (*every_case(), *disturbed_cases())
    case = next(one for one in every if one.name == settings["case"])
    row = run(case, Path(settings["folder"]), keep=settings["keep"], refits=settings["refits"])
    said = {"verdict": row.verdict, "right": row.right, "died": row.failure, "causes": ", ".join(row.named)}
    return said, asdict(row)


def code_of_rows() -> str:
    """Digest of all that a judgement depends on: flights, answers, and the judging."""
    return _digest("", (*sorted(_HERE.glob("*.py")), _HERE.with_name("mujoco_rig.py"), *_ASKED))


def prepare(case: Case, folder: Path, *, keep: bool = False) -> Ready:
    """Make the flights of a case, and find out what can be seen in them.

    Parameters
    ----------
    case : Case
        The case.
    folder : Path
        Where both are kept.
    keep : bool
        Take what is there, whatever code it was made with.
    """
    place = folder / case.name
    place.mkdir(parents=True, exist_ok=True)
    made_by = _digest(repr(case), _WINDY if isinstance(case, DisturbedCase) else _CLEAN)
    mark = place / "made_by.txt"
    current = mark.exists() and mark.read_text() == made_by
    if not current and not (keep and any(place.iterdir())):
        for old in place.iterdir():
            old.unlink()
        # Before the flights: each of them is whole or not there, and an interrupted run keeps the first.
        mark.write_text(made_by)
    paths = case.flights(folder)
    flights = read_flight(paths[0]), read_flight(paths[1])
    rig = load_rig(case.rig_name if isinstance(case, DisturbedCase) else _PAPER)
    if isinstance(case, DisturbedCase):
        code = _digest(made_by, _VISIBILITY)
        plain = _kept(place / "visibility.json", code, keep, lambda: dict(visibility(case)))
        return Ready(flights, rig, plain)
    # What is hidden does not change with the laboratory: an edit there does not ask for 127 fits again.
    hidden = hidden_in(case, _motors_on_s(flights[0], rig))
    code = _digest(made_by, _ORACLE)
    told = _kept(place / "told.json", code, keep, lambda: asdict(tell(rig, flights, hidden)))
    return Ready(flights, rig, Told(**told))


def seen(case: Case, folder: Path, keep: bool) -> dict[str, float | None]:
    """By how many standard deviations each cause of a case stands out; None where no number can say.

    Parameters
    ----------
    case : Case
        The case.
    folder : Path
        Where flights are kept.
    keep : bool
        Take what is there, whatever code it was made with.
    """
    told = prepare(case, folder, keep=keep).told
    return told.significance if isinstance(told, Told) else dict(told)


def found_in(
    rig: Rig, flights: tuple[Flight, Flight], refits: int = REFITS, unlisted: Collection[str] = ()
) -> Diagnosis:
    """Ask the diagnosis, which gets the flights and the nominal rig and nothing else.

    Parameters
    ----------
    rig : Rig
        Nominal numbers.
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    refits : int
        Most refits of the search.
    unlisted : collection of str
        Effects that are taken off its list.
    """
    kinds = {id_: kind for id_, kind in catalogue().items() if id_ not in unlisted}
    return diagnose(
        MultibodyModel(), rig, flights[:1], flights[1:], kinds=kinds, labels=["a", "b"], refits=refits
    )


def diagnosed(rig: Rig, flights: tuple[Flight, Flight], refits: int = REFITS) -> dict[str, Any]:
    """JSON of what `found_in` finds, with the same arguments."""
    return to_json(found_in(rig, flights, refits))


def asked(rig: Rig, flights: tuple[Flight, Flight], refits: int = REFITS) -> dict[str, Any]:
    """Ask the diagnosis, and take the time.

    Parameters
    ----------
    rig : Rig
        Nominal numbers.
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    refits : int
        Most refits of the search.

    Returns
    -------
    dict
        ``result``, its JSON or None; ``failure``, the error that ended it; ``seconds`` and ``cpu_seconds``.
    """
    started_s, worked_s = time.perf_counter(), spent_s()
    result, failure = None, ""
    try:
        result = diagnosed(rig, flights, refits)
    except (SimError, ArithmeticError, LookupError, TypeError, ValueError) as error:
        # One case that dies must not end the night's run; it counts as a miss and is said.
        failure = f"{type(error).__name__}: {error}"
    return {
        "result": result,
        "failure": failure,
        "seconds": time.perf_counter() - started_s,
        "cpu_seconds": spent_s() - worked_s,
    }


def _conditions(case: DisturbedCase) -> dict[str, Any]:
    of = case.disturbances
    return {
        "rig": case.rig_name,
        "rate_Hz": case.rate_Hz,
        "gentle": case.gentle,
        "controller": case.controller,
        "gusts_Nm": list(of.gusts_Nm),
        "correlation_time_s": of.correlation_time_s,
        "slow_std_Nm": list(of.slow_std_Nm),
    }


def _motors_on_s(flight: Flight, rig: Rig) -> float:
    # The drivers pass nothing on below their dead band.
    least_V = rig["driver_dead_band"].value * rig["supply"].value
    on = (flight.voltages_V > least_V).any(axis=1)
    return float(flight.t_s[on][0] - flight.t_s[0])


def _kept(path: Path, made_by: str, keep: bool, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Read what an earlier run found with the same code, or find it and write it down."""
    if path.exists():
        found: dict[str, Any] = json.loads(path.read_text())
        if keep or found["made_by"] == made_by:
            return dict(found["what"])
    what = make()
    unfinished = path.with_suffix(".unfinished")
    unfinished.write_text(json.dumps({"made_by": made_by, "what": what}, indent=1, default=float))
    unfinished.rename(path)
    return what


def _digest(text: str, files: Iterable[Path]) -> str:
    digest = hashlib.sha256(text.encode())
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()
