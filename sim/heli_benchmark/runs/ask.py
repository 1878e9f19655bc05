"""Run the diagnosis of the laboratory on two flights."""

from __future__ import annotations

import os
import time
from collections.abc import Collection, Iterable, Iterator
from typing import Any, Final, Protocol, TypeVar

from heli_host.data.flight import Flight
from heli_host.errors import FlightAborted
from heli_lab.diagnose import Diagnosis, diagnose, to_json
from heli_sim.errors import SimError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig, load_rig

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


def diagnosed_cases(cases: Iterable[_Case]) -> Iterator[tuple[_Case, dict[str, Any], float]]:
    """Fly and diagnose `cases`: yield each with its result as JSON and the processor time in s.

    A case whose rig leaves the safe range is reported and skipped.
    """
    for case in cases:
        try:
            flights = case.both_flights()
        except FlightAborted as error:
            print(f"{case.name:55} not flown: {error}", flush=True)
            continue
        started_s = time.process_time()
        result = diagnosis_json(load_rig(case.rig_name), flights)
        yield case, result, time.process_time() - started_s


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
