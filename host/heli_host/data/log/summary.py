"""Summary of a flight, used by ``summary.json``, the figure and the last lines printed; contradictions to its
rig.

The tracking error of a tick is the measured angle minus the setpoint that the control law used in that tick
(after the board's slew limit). It counts from the end of take-off until landing begins. Only ticks in closed
loop count; if a law on the host flew, it must have published its setpoints. Pitch is compared with the
setpoint that the travel loop requests. In a log without phases, of a flight by hand, all such ticks count.

This package contains no models. A package that does offers a function in the entry-point group
``heli_host.flight_checks``, which takes a flight and the name or file of its rig and returns findings.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from heli_host.data.files import RESULT_SCHEMA, write_text
from heli_host.data.flight import Flight
from heli_host.data.log.reader import Log
from heli_host.data.log.writer import DISK_BLOCKED, TICKS_DROPPED
from heli_host.data.response import flown_rows, judged_rows, measuring_notes, rms
from heli_host.declaration import AXES
from heli_host.errors import HeliError, LogWriteError
from heli_host.link.installation import plugins

if TYPE_CHECKING:
    from heli_host.data.flight import Flight


ENTRY_POINT_GROUP: Final = "heli_host.flight_checks"


@dataclass(frozen=True)
class FlightFinding:
    """Something of a finished flight that contradicts its rig."""

    name: str  # Which number, such as ``travel_encoder_scale``
    value: float | None
    """value, standard_error: Its estimate from the flight; None if the check itself failed."""
    standard_error: float | None
    text: str  # For a person


FlightCheck = Callable[["Flight", str], Sequence[FlightFinding]]


def flight_findings(flight: Flight, rig: str) -> tuple[FlightFinding, ...]:
    """Check a flight against its rig."""
    findings: list[FlightFinding] = []
    for entry in plugins(ENTRY_POINT_GROUP):
        # A check that cannot be made must not cost the summary of a flight.
        try:
            check: FlightCheck = entry.load()
            findings += check(flight, rig)
        except (HeliError, ArithmeticError, ValueError):
            continue
        except Exception as error:  # noqa: BLE001 - the check of another package may raise anything
            text = f"the check '{entry.name}' of {entry.value} failed: {type(error).__name__}: {error}"
            findings.append(FlightFinding(entry.name, None, None, text))
    return tuple(findings)


_MAX_COUNT = 2**63
_LONGEST_COUNT = 24
_TOLD = (DISK_BLOCKED, TICKS_DROPPED)


@dataclass(frozen=True)
class FlightSummary:
    """Summary of a flight."""

    outcome: str
    """``completed``; ``not_tracked`` with the axis; ``recorded`` without a plan; or one line with the reason
    why the flight ended."""
    duration_s: float  # Device time from the first tick logged to the last
    ticks_logged: int  # ticks_logged, ticks_lost: Ticks in the log, and ticks that are missing between them
    ticks_lost: int
    rms_error_deg: Mapping[str, float | None]
    """rms_error_deg, max_error_deg: Tracking error by axis, see `heli_host.data.response`; None for an axis
    without rows that count."""
    max_error_deg: Mapping[str, float | None]
    link: Mapping[str, int]  # ``frames_ok``, ``frames_bad``, ``retries``, ``reconnects`` and other counters
    plans: tuple[str, ...] = ()  # Names of the plans flown
    rig: str = ""  # rig, board: Name of the rig, and description of the board
    board: str = ""
    events: tuple[Mapping[str, Any], ...] = ()  # ``t_s``, ``name``, ``text`` of every event
    notes: tuple[str, ...] = ()  # Defects of the log, and rows that are left out of the errors
    log: str = ""  # Path of the log
    findings: tuple[FlightFinding, ...] = ()  # Findings of the flight that contradict its rig

    @property
    def completed(self) -> bool:
        """Whether the flight went to its end."""
        return self.outcome == "completed"

    def as_dict(self) -> dict[str, Any]:
        """Return the content of ``summary.json``."""
        return {
            "outcome": self.outcome,
            "plans": list(self.plans),
            "rig": self.rig,
            "board": self.board,
            "duration_s": round(self.duration_s, 6),
            "ticks_logged": self.ticks_logged,
            "ticks_lost": self.ticks_lost,
            "rms_error_deg": dict(self.rms_error_deg),
            "max_error_deg": dict(self.max_error_deg),
            "link": dict(self.link),
            "events": [dict(event) for event in self.events],
            "notes": list(self.notes),
            "findings": [asdict(finding) for finding in self.findings],
            "log": self.log,
        }

    def write_json(self, path: str | Path) -> None:
        """Write ``summary.json``."""
        path = Path(path)
        try:
            content = {"schema": RESULT_SCHEMA, **self.as_dict()}
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(content, indent=2, ensure_ascii=False) + "\n")
        except OSError as error:
            raise LogWriteError(
                f"cannot write {path}: {error.strerror or error}", "choose another path with --json"
            ) from error


def summarise(log: Log) -> FlightSummary:
    """Sum a log up."""
    session = log.metadata.get("session", {})
    result = log.metadata.get("result", {})
    plans = tuple(log.metadata.get("plan", {}))
    closed_axes = _closed_axes(session.get("axes", ""))
    rms_deg: dict[str, float | None] = dict.fromkeys(AXES)
    max_deg: dict[str, float | None] = dict.fromkeys(AXES)
    measuring: list[str] = []
    if len(log.ticks):
        flight = log.flight()
        measuring = measuring_notes(flight)
        for axis, errors_deg in zip(AXES, tracking_errors_deg(flight).T, strict=True):
            led_deg = errors_deg[~np.isnan(errors_deg)]
            if len(led_deg) and axis in closed_axes:
                rms_deg[axis] = round(rms(led_deg), 4)
                max_deg[axis] = round(float(np.max(np.abs(led_deg))), 4)
    outcome = result.get("outcome")
    if not outcome:
        outcome = (
            "recorded"
            if log.complete
            else "not closed: the host ended, or could write no more, before the flight ended"
        )
    return FlightSummary(
        outcome=outcome,
        duration_s=float(log.ticks["t_s"][-1] - log.ticks["t_s"][0]) if len(log.ticks) else 0.0,
        ticks_logged=len(log.ticks),
        ticks_lost=log.ticks_lost,
        rms_error_deg=rms_deg,
        max_error_deg=max_deg,
        link=_last_link_counters(log),
        plans=plans,
        rig=session.get("rig", ""),
        board=session.get("board", ""),
        events=tuple(
            {"t_s": round(float(event["t_s"]), 6), "name": event["name"], "text": event["message"]}
            for event in log.events
        ),
        notes=(
            *log.notes,
            *(event["message"] for event in log.events if event["name"] in _TOLD),
            *measuring,
        ),
        log=str(log.path),
    )


def tracking_errors_deg(flight: Flight) -> NDArray[np.float64]:
    """Return measured angle less setpoint in the rows that count, see `heli_host.data.response`. Returns
    shape (m, axes).
    """
    setpoints_rad = flight.setpoints_rad
    if setpoints_rad is None:
        return np.zeros((0, len(AXES)))
    rows = flown_rows(flight)
    errors_deg: NDArray[np.float64] = np.rad2deg(flight.angles_rad - setpoints_rad)
    for index, axis in enumerate(AXES):
        errors_deg[~judged_rows(flight, axis), index] = np.nan
    return errors_deg[rows]


def _closed_axes(text: str) -> tuple[str, ...]:
    named = tuple(axis for axis in AXES if axis in text.split())
    return named or AXES


def _last_link_counters(log: Log) -> dict[str, int]:
    """Return the link counters of a log, the last of the flight or those at its end."""
    counted = {"frames_ok": 0, "frames_bad": 0, "retries": 0, "reconnects": 0}
    last = log.link[-1] if log.link else {}
    counted.update({name: int(value) for name, value in last.items() if name != "t_s" and _is_count(value)})
    for name, value in log.metadata.get("counters", {}).items():
        if value.isascii() and value.lstrip("-").isdigit() and _is_count(float(value[:_LONGEST_COUNT])):
            counted[name] = int(value[:_LONGEST_COUNT])
    return counted


def _is_count(value: object) -> bool:
    return isinstance(value, int | float) and abs(value) < _MAX_COUNT
