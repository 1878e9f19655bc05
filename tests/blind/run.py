"""One case from beginning to end, kept so that a run that was interrupted goes on."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import heli_lab
import heli_sim
from heli_host.flight import Flight
from heli_host.log.flight_file import read_flight
from heli_lab.diagnose import diagnose, to_json
from heli_sim.errors import SimError
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig, load_rig

from tests.blind.cases import Case
from tests.blind.judge import Row, judged
from tests.blind.oracle import Told, tell
from tests.blind.truth import hidden_in
from tests.blind.visibility import visibility
from tests.blind.weather_cases import WeatherCase
from tests.running.clock import spent_s

BUDGET_s = 600.0
"""As the command line has it."""
_HERE = Path(__file__).parent
_SIM, _LAB = Path(heli_sim.__file__).parent, Path(heli_lab.__file__).parent
_ENGINE = (
    _HERE.with_name("mujoco_rig.py"),
    *(_HERE / name for name in ("mujoco_rig.py", "hidden.py", "off_list.py", "cases.py")),
)
_CLEAN = (*_ENGINE, _HERE / "flights.py")
_WINDY = (
    *_ENGINE,
    *(_HERE / name for name in ("measured_effects.py", "weather.py", "tracking.py", "weather_cases.py")),
)
_ORACLE = (_HERE / "oracle.py", _HERE / "truth.py")
_VISIBILITY = (*_WINDY, *(_HERE / name for name in ("course.py", "replay.py", "visibility.py")))
_PAPER = "makki2024"


def run(case: Case, folder: Path, *, keep: bool = False, budget_s: float = BUDGET_s) -> Row:
    """Make the flights of a case, have them diagnosed, and judge the answer.

    Parameters
    ----------
    case : Case
        The case.
    folder : Path
        Where flights and results are kept.
    keep : bool
        Take flights and results that are there, whatever code they were made with.
    budget_s : float
        Most time for the search.

    Returns
    -------
    Row
        The judgement.
    """
    place = folder / case.name
    place.mkdir(parents=True, exist_ok=True)
    windy = isinstance(case, WeatherCase)
    made_by = _digest(repr(case), _WINDY if windy else _CLEAN)
    mark = place / "made_by.txt"
    if not keep and not (mark.exists() and mark.read_text() == made_by):
        for old in place.iterdir():
            old.unlink()
    paths = case.flights(folder)
    if not mark.exists():
        mark.write_text(made_by)
    flights = read_flight(paths[0]), read_flight(paths[1])
    rig = load_rig(case.rig_name if isinstance(case, WeatherCase) else _PAPER)
    hidden = hidden_in(case, _motors_on_s(flights[0], rig))
    told: Told | dict[str, float]
    if isinstance(case, WeatherCase):
        seen = _digest(repr(case), _VISIBILITY)
        told = _kept(place / "visibility.json", seen, keep, lambda: dict(visibility(case)))
    else:
        fits = _digest("", (*_ORACLE, *_sources(_LAB / "identify"), *_sources(_SIM / "model")))
        told = Told(**_kept(place / "told.json", fits, keep, lambda: asdict(tell(rig, flights, hidden))))
    all_of_it = _digest("", [*_sources(_LAB), *_sources(_SIM / "model"), *_sources(_SIM / "rig")])
    answer = _kept(place / "diagnosis.json", all_of_it, keep, lambda: asked(rig, flights, budget_s))
    return judged(
        case,
        hidden,
        told,
        answer["result"],
        answer["seconds"],
        answer["failure"],
        cpu_seconds=answer["cpu_seconds"],
        weather=_conditions(case) if isinstance(case, WeatherCase) else {},
    )


def diagnosed(rig: Rig, flights: tuple[Flight, Flight], budget_s: float = BUDGET_s) -> dict[str, Any]:
    """Ask the diagnosis, which gets the flights and the nominal rig and nothing else.

    Parameters
    ----------
    rig : Rig
        Nominal numbers.
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    budget_s : float
        Most time for the search.

    Returns
    -------
    dict
        Its JSON.
    """
    labels = ["a", "b"]
    found = diagnose(MultibodyModel(), rig, flights[:1], flights[1:], labels=labels, seconds=budget_s)
    return to_json(found)


def asked(rig: Rig, flights: tuple[Flight, Flight], budget_s: float = BUDGET_s) -> dict[str, Any]:
    """Ask the diagnosis, and take the time.

    Parameters
    ----------
    rig : Rig
        Nominal numbers.
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    budget_s : float
        Most time for the search.

    Returns
    -------
    dict
        ``result``, its JSON or None; ``failure``, the error that ended it; ``seconds`` and ``cpu_seconds``.
    """
    started_s, worked_s = time.perf_counter(), spent_s()
    result, failure = None, ""
    try:
        result = diagnosed(rig, flights, budget_s)
    except (SimError, ArithmeticError, LookupError, TypeError, ValueError) as error:
        # One case that dies must not end the night's run; it counts as a miss and is said.
        failure = f"{type(error).__name__}: {error}"
    return {
        "result": result,
        "failure": failure,
        "seconds": time.perf_counter() - started_s,
        "cpu_seconds": spent_s() - worked_s,
    }


def _conditions(case: WeatherCase) -> dict[str, Any]:
    of = case.weather
    return {
        "rig": case.rig_name,
        "rate_Hz": case.rate_Hz,
        "gentle": case.gentle,
        "controller": case.controller,
        "gusts_Nm": list(of.gusts_Nm),
        "memory_s": of.memory_s,
        "drift_Nm": list(of.drift_Nm),
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


def _sources(room: Path) -> list[Path]:
    return sorted(path for path in room.rglob("*") if path.suffix in (".py", ".toml", ".hpp", ".cpp", ".c"))


def _digest(text: str, files: Iterable[Path]) -> str:
    digest = hashlib.sha256(text.encode())
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()
