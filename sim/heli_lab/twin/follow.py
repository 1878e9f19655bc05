"""A twin beside a flight that is over: the same alarms at the same ticks as live."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_host.link.channels import rad_per_count
from heli_host.link.clock import TICK_S
from heli_host.log.flight_file import read_flight
from heli_host.log.reader import read_log

from heli_lab.errors import TwinError
from heli_lab.twin.files import TwinRig
from heli_lab.twin.flights import count_rad_of, samples_of, samples_of_log
from heli_lab.twin.kalman_filter import TwinModel
from heli_lab.twin.samples import Samples
from heli_lab.twin.twin import Twin, TwinEvent


@dataclass(frozen=True)
class Followed:
    """What the twin said of a flight.

    Parameters
    ----------
    label : str
        Name of the flight.
    events : tuple of TwinEvent
        In order.
    evidence_nats : tuple of (float, float)
        Times and evidence of each measurement.
    threshold_nats : float
        Evidence that is an alarm.
    free_s : float
        Time over which it compared.
    flown_rig : str
        Name of the rig that the file of the flight states; empty where it states none.
    """

    label: str
    events: tuple[TwinEvent, ...]
    evidence_nats: tuple[tuple[float, float], ...]
    threshold_nats: float
    free_s: float
    flown_rig: str = ""

    @property
    def max_evidence_nats(self) -> float:
        """Largest evidence of any change, before an alarm or ever."""
        return max(
            (evidence for _, evidence in self.evidence_nats if math.isfinite(evidence)), default=-math.inf
        )

    @property
    def alarms(self) -> tuple[TwinEvent, ...]:
        """The last word on each alarm."""
        return tuple(event for event in self.events if event.kind == "named")

    def sentences(self) -> list[str]:
        """Say it for people."""
        if not self.free_s:
            return ["no free flight to compare"]
        if not self.alarms:
            return [f"no change of the rig ({self.free_s:.0f} s, at most {self.max_evidence_nats:.1f} nats)"]
        return [event.text for event in self.alarms]


def follow_flight(
    chosen: TwinRig,
    flight: Flight,
    label: str,
    hours: float,
    start_s: float | None = None,
    stop_s: float | None = None,
) -> Followed:
    """Fly the twin beside a flight.

    Parameters
    ----------
    chosen : TwinRig
        The rig, and what is normal of it.
    flight : Flight
        The flight; gaps are allowed.
    label : str
        Its name.
    hours : float
        Free flight with one false alarm on average, h.
    start_s, stop_s : float, optional
        Only this part, on the flight's own time axis.

    Raises
    ------
    TwinError
        Its rows are not evenly spaced, or none is in the part.
    """
    samples, sample_s = samples_of(flight)
    zero_s = float(samples.number[0]) * sample_s - float(flight.t_s[0])
    count_rad = count_rad_of(flight, chosen.rig)
    return _follow(chosen, samples, count_rad, sample_s, zero_s, label, hours, (start_s, stop_s))


def follow_file(
    chosen: TwinRig, path: Path, hours: float, start_s: float | None = None, stop_s: float | None = None
) -> Followed:
    """Fly the twin beside the flight in the file at `path`; `hours`, `start_s`, `stop_s` and errors are
    those of `follow_flight`, and a HeliError where the file holds no flight.
    """
    if path.suffix.lower() != ".mcap":
        flight = read_flight(path, allow_gaps=True)
        followed = follow_flight(chosen, flight, path.name, hours, start_s, stop_s)
        return replace(followed, flown_rig=str(flight.meta.get("rig") or ""))
    log = read_log(path)
    samples, zero_s = samples_of_log(log)
    count_rad = rad_per_count(log.parameters)
    followed = _follow(chosen, samples, count_rad, TICK_S, zero_s, path.name, hours, (start_s, stop_s))
    return replace(followed, flown_rig=log.metadata.get("session", {}).get("rig", ""))


def _follow(
    chosen: TwinRig,
    samples: Samples,
    count_rad: Floats,
    sample_s: float,
    zero_s: float,
    label: str,
    hours: float,
    span: tuple[float | None, float | None],
) -> Followed:
    low = -math.inf if span[0] is None else span[0]
    high = math.inf if span[1] is None else span[1]
    t_s = samples.number * sample_s - zero_s
    rows = (t_s >= low) & (t_s < high)
    if not np.any(rows):
        raise TwinError(f"{label} has no row from {low:g} to {high:g} s", "give a part of the flight")
    part = samples.part(rows)
    model = TwinModel(chosen.model, chosen.rig)
    twin = Twin(model, chosen.calibration, count_rad, sample_s, hours, zero_s=zero_s)
    twin.keeps = True
    events = twin.take(part) + twin.finish()
    compared = len(twin.evidence_history) * twin.block_s
    return Followed(label, tuple(events), tuple(twin.evidence_history), twin.threshold_nats, compared)
