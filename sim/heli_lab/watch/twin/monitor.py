"""Change detection in a finished flight: the same alarms at the same ticks as live."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight, read_log
from heli_host.link.channels import rad_per_count
from heli_host.link.clock import TICK_S

from heli_lab.errors import TwinError
from heli_lab.watch.twin.events import TwinEvent
from heli_lab.watch.twin.files import TwinRig
from heli_lab.watch.twin.flights import count_rad_of, samples_of, samples_of_log
from heli_lab.watch.twin.samples import Samples
from heli_lab.watch.twin.twin import Twin
from heli_lab.watch.twin.twin_model import TwinModel

_MIN_JUDGED_s: Final = 2.0
"""Judged time below which a flight is not called unchanged [s]: most changes need longer to show."""


@dataclass(frozen=True)
class TwinReport:
    """Result of comparing a flight with a twin."""

    label: str  # Name of the flight
    events: tuple[TwinEvent, ...]  # Events in order of time
    evidence_nats: tuple[tuple[float, float], ...]  # Time [s] and evidence [nats] of each measurement
    threshold_nats: float  # Evidence above which an alarm is raised [nats]
    free_s: float  # Length of the part of the flight that was compared [s]
    unjudged_s: float = 0.0
    """Time in that part with voltages that the nominal flights do not contain; no alarm begins then [s]."""
    flown_rig: str = ""  # Name of the rig in the flight's file; empty if it has none

    @property
    def max_evidence_nats(self) -> float:
        """Largest evidence of any change [nats]; -inf if nothing was compared."""
        return max(
            (evidence for _, evidence in self.evidence_nats if math.isfinite(evidence)), default=-math.inf
        )

    @property
    def alarms(self) -> tuple[TwinEvent, ...]:
        """The event with the final ranking of each alarm."""
        return tuple(event for event in self.events if event.kind == "diagnosed")

    def sentences(self) -> list[str]:
        """Describe the result for people: the alarms, then what was not judged, then jumps of encoders."""
        if not self.free_s:
            return ["no free flight to compare"]
        contradictions = [event.text for event in self.events if event.kind == "contradicts"]
        alarms = [event.text for event in self.alarms]
        glitches = [event.text for event in self.events if event.kind == "glitch"]
        return [*(contradictions + alarms or self._no_change()), *self._unjudged(), *glitches]

    def _no_change(self) -> list[str]:
        """State for how long no change was detected."""
        judged_s = self.free_s - self.unjudged_s
        if judged_s < _MIN_JUDGED_s:
            return []
        return [
            f"no change of the rig in {judged_s:.0f} s (evidence: {self.max_evidence_nats:.1f} nats at most)"
        ]

    def _unjudged(self) -> list[str]:
        """State which part was not judged, and why."""
        reasons = [event.text for event in self.events if event.kind == "unjudged"]
        if not reasons:
            return []
        return [f"{self.unjudged_s:.1f} s of {self.free_s:.1f} s are not judged: {reasons[0]}"]


def monitor_flight(
    twin_rig: TwinRig,
    flight: Flight,
    label: str,
    false_alarm_interval_h: float,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> TwinReport:
    """Compare a flight with the twin of a rig."""
    samples, sample_s = samples_of(flight)
    zero_s = float(samples.number[0]) * sample_s - float(flight.t_s[0])
    count_rad = count_rad_of(flight, twin_rig.rig)
    return _monitor_samples(
        twin_rig, samples, count_rad, sample_s, zero_s, label, false_alarm_interval_h, (start_s, stop_s)
    )


def monitor_file(
    twin_rig: TwinRig,
    path: Path,
    false_alarm_interval_h: float,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> TwinReport:
    """Compare the flight in the file at `path` with the twin of a rig.

    The other arguments and errors are those of `monitor_flight`. A file that holds no flight raises a
    HeliError.
    """
    if path.suffix.lower() != ".mcap":
        flight = read_flight(path, allow_gaps=True)
        report = monitor_flight(twin_rig, flight, path.name, false_alarm_interval_h, start_s, stop_s)
        return replace(report, flown_rig=str(flight.meta.get("rig") or ""))
    log = read_log(path)
    samples, zero_s = samples_of_log(log)
    count_rad = rad_per_count(log.parameters)
    report = _monitor_samples(
        twin_rig, samples, count_rad, TICK_S, zero_s, path.name, false_alarm_interval_h, (start_s, stop_s)
    )
    return replace(report, flown_rig=log.metadata.get("session", {}).get("rig", ""))


def _monitor_samples(
    twin_rig: TwinRig,
    samples: Samples,
    count_rad: Floats,
    sample_s: float,
    zero_s: float,
    label: str,
    false_alarm_interval_h: float,
    span: tuple[float | None, float | None],
) -> TwinReport:
    """Compare the samples between two times with the twin; `span` has the times, None without a limit."""
    start_s = -math.inf if span[0] is None else span[0]
    stop_s = math.inf if span[1] is None else span[1]
    t_s = samples.number * sample_s - zero_s
    is_inside = (t_s >= start_s) & (t_s < stop_s)
    if not np.any(is_inside):
        raise TwinError(
            f"{label} has no row between {start_s:g} and {stop_s:g} s",
            "give --from and --to within the flight",
        )
    chosen_samples = samples.select(is_inside)
    model = TwinModel(twin_rig.model, twin_rig.rig, twin_rig.calibration.uncertainty)
    twin = Twin(model, twin_rig.calibration, count_rad, sample_s, false_alarm_interval_h, zero_s=zero_s)
    twin.records_evidence = True
    events = twin.update(chosen_samples) + twin.finish()
    free_s = len(twin.evidence_history) * twin.block_s
    unjudged_s = twin.unjudged_blocks * twin.block_s
    return TwinReport(
        label, tuple(events), tuple(twin.evidence_history), twin.threshold_nats, free_s, unjudged_s
    )
