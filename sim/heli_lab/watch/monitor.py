"""A twin of a finished flight, and a live one for the host: both raise the same alarms at the same ticks.

`open_twin` is an entry point ``heli_host.twins``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.board.twins import TwinNews
from heli_host.data.arrays import Floats, Integers
from heli_host.data.files import save_figure
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight, read_log
from heli_host.link.channels import rad_per_count
from heli_host.link.clock import TICK_S

from heli_lab.errors import TwinError
from heli_lab.watch.calibration import TwinRig, open_rig
from heli_lab.watch.disturbances import acting_flights
from heli_lab.watch.steps import Samples, count_rad_of, samples_of, samples_of_log, samples_of_ticks
from heli_lab.watch.twin import Twin, TwinEvent
from heli_lab.watch.twin_model import TwinModel

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
    slow_log_note: str = ""  # What a log lacks that is slower than its control loop; empty for other logs

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

    @property
    def fit(self) -> str:
        """State whether the model fits the beginning of the flight; empty if nothing shows it."""
        kinds = ("fits", "contradicts")
        return next((event.text for event in self.events if event.kind in kinds), "")

    def sentences(self) -> list[str]:
        """Describe the result for people: the alarms, then what was not judged, then jumps of encoders."""
        if not self.free_s:
            return ["no free flight to compare"]
        contradictions = [event.text for event in self.events if event.kind == "contradicts"]
        if contradictions:
            # What a model names before it turns out not to fit is none of the rig.
            withdrawn = [f"withdrawn: {event.text}" for event in self.alarms]
            return [*contradictions, *withdrawn, *self._unjudged()]
        alarms = [event.text for event in self.alarms]
        glitches = [event.text for event in self.events if event.kind == "glitch"]
        return [*(alarms or self._no_change()), *self._unjudged(), *glitches]

    def _no_change(self) -> list[str]:
        """State for how long no change was detected."""
        judged_s = self.free_s - self.unjudged_s
        if judged_s < _MIN_JUDGED_s:
            return []  # too short for a statement
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
        twin_rig,
        samples,
        count_rad,
        label,
        sample_s=sample_s,
        zero_s=zero_s,
        false_alarm_interval_h=false_alarm_interval_h,
        span_s=(start_s, stop_s),
    )


def monitor_file(
    twin_rig: TwinRig,
    path: Path,
    false_alarm_interval_h: float,
    start_s: float | None = None,
    stop_s: float | None = None,
    loop_Hz: float | None = None,
) -> TwinReport:
    """Compare the flight in the file at `path` with the twin of a rig."""
    # `loop_Hz` is the rate of the control loop of a table, None if it is unknown. The other arguments and
    # errors are those of `monitor_flight`. A file that holds no flight raises a HeliError.
    if path.suffix.lower() != ".mcap":
        flight = read_flight(path, allow_gaps=True)
        flown_rig = str(flight.meta.get("rig") or "")
        (flight,), notes = acting_flights(twin_rig.model, twin_rig.rig, [flight], [path.name], loop_Hz)
        report = monitor_flight(twin_rig, flight, path.name, false_alarm_interval_h, start_s, stop_s)
        return replace(report, flown_rig=flown_rig, slow_log_note="; ".join(notes))
    log = read_log(path)
    samples, zero_s = samples_of_log(log)
    count_rad = rad_per_count(log.parameters)
    report = _monitor_samples(
        twin_rig,
        samples,
        count_rad,
        path.name,
        sample_s=TICK_S,
        zero_s=zero_s,
        false_alarm_interval_h=false_alarm_interval_h,
        span_s=(start_s, stop_s),
    )
    return replace(report, flown_rig=log.metadata.get("session", {}).get("rig", ""))


def _monitor_samples(
    twin_rig: TwinRig,
    samples: Samples,
    count_rad: Floats,
    label: str,
    *,
    sample_s: float,
    zero_s: float,
    false_alarm_interval_h: float,
    span_s: tuple[float | None, float | None],
) -> TwinReport:
    """Compare the samples between two times with the twin; `span_s` has the times, None without a limit."""
    # `zero_s`: Time on the clock of the samples at which the time of the flight is 0.
    from_s, to_s = span_s
    start_s = -math.inf if from_s is None else from_s
    stop_s = math.inf if to_s is None else to_s
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
    return TwinReport(
        label,
        tuple(events),
        evidence_nats=tuple(twin.evidence_history),
        threshold_nats=twin.threshold_nats,
        free_s=len(twin.evidence_history) * twin.block_s,
        unjudged_s=twin.unjudged_blocks * twin.block_s,  # A part of `free_s`
    )


_TITLE_LENGTH: Final = 140
"""Letters that fit above a panel."""


def draw_evidence(flights: Sequence[TwinReport], path: Path) -> None:
    """Draw the evidence of some flights below each other, into a .png, .pdf or .svg file at `path`."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 0.6 + 2.2 * len(flights)), layout="constrained")
    axes = figure.subplots(len(flights), 1, squeeze=False)[:, 0]
    for ax, flight in zip(axes, flights, strict=True):
        t_s, evidence_nats = np.array(flight.evidence_nats, float).reshape(-1, 2).T
        # No line is drawn through times at which the evidence is unknown.
        is_known = np.isfinite(evidence_nats)
        ax.plot(
            t_s,
            np.where(is_known, np.maximum(evidence_nats, 0.0), np.nan),
            color="#0b5394",
            lw=1.2,
            label="most likely change",
        )
        ax.axhline(flight.threshold_nats, color="#b45f06", ls="--", lw=1.0, label="alarm")
        for event in flight.events:
            if event.kind == "alarm":
                ax.axvline(event.t_s, color="#990000", lw=1.0)
        text = "; ".join(flight.sentences())
        ax.set_title(f"{flight.label}: {text}"[:_TITLE_LENGTH], fontsize=8, loc="left")
        ax.set_ylabel("evidence, nats")
        ax.legend(loc="upper left", fontsize=7)
    axes[-1].set_xlabel("time, s")
    save_figure(figure, path, dpi=130)


_WAITS: Final = "The twin waits for free flight."
_COMPARES: Final = "The twin compares: no change of the rig."
_DOES_NOT_JUDGE: Final = "The twin does not judge these voltages, because no nominal flight has them."


class TickTwin:
    """A `twin` that takes ticks of a board; `count_rad`, shape (3,), is the angle of one count of each
    encoder [rad].
    """

    def __init__(self, twin: Twin, count_rad: Floats) -> None:
        self._twin, self._count_rad = twin, count_rad
        self._alarm_text = ""

    def update(self, tick: Integers, raw: npt.NDArray[np.int32]) -> list[TwinNews]:
        """Process raw numbers `raw`, (n, channels), at the ticks `tick`, (n,), and return the messages that
        they cause.
        """
        events = self._twin.update(samples_of_ticks(tick, raw, self._count_rad))
        for event in events:
            if event.ranking or event.kind == "contradicts":
                self._alarm_text = event.text
            elif event.kind == "free":
                self._alarm_text = ""
        return [TwinNews(event.kind, round(event.t_s / TICK_S), event.text) for event in events]

    def ghost_rad(self) -> tuple[float, float, float] | None:
        """Elevation, pitch and travel of the ghost [rad]; None if there is none."""
        ghost = self._twin.ghost_rad
        return None if ghost is None else (float(ghost[0]), float(ghost[1]), float(ghost[2]))

    def words(self) -> str:
        """Return the twin's status in one line: the newest alarm or contradiction, or whether it compares,
        does not judge or waits.
        """
        if self._alarm_text:
            return f"Twin: {self._alarm_text}"
        if not self._twin.free:
            return _WAITS
        return _COMPARES if self._twin.judges else _DOES_NOT_JUDGE


def open_twin(name: str) -> Callable[[Mapping[str, float], float], TickTwin]:
    """Read a rig, and return a function that makes its twin."""
    # The function takes the board's parameters and the mean time between two false alarms [h]. It raises a
    # TwinError if the parameters do not give the counts of the encoders.
    return partial(_make_twin, open_rig(name))


def _make_twin(twin_rig: TwinRig, parameters: Mapping[str, float], false_alarm_interval_h: float) -> TickTwin:
    """Return the twin of a board with these parameters."""
    count_rad = rad_per_count(parameters)
    if not np.all(np.isfinite(count_rad)):
        raise TwinError(
            "the board does not report the counts per turn of its encoders",
            "set elevation_counts_per_rev, pitch_counts_per_rev and travel_counts_per_rev on the board",
        )
    model = TwinModel(twin_rig.model, twin_rig.rig, twin_rig.calibration.uncertainty)
    twin = Twin(model, twin_rig.calibration, count_rad, TICK_S, false_alarm_interval_h, with_ghost=True)
    return TickTwin(twin, count_rad)
