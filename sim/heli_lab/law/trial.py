"""A flight to judge a law by: a step of travel, then sines of elevation and travel."""

from __future__ import annotations

import contextlib
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import heli_host
from heli_host.flight import Flight
from heli_host.flight.flown import LANDING
from heli_host.flight.response import effort_V, responses
from heli_host.fly.recorder import Recorder
from heli_host.guest_law import LawReport, engage, fly_law
from heli_host.link.telemetry import Ticks

from heli_lab.law.compare import flight_of_law
from heli_lab.law.law import Law

STEP_deg: Final = 10.0
STEP_AT_s: Final = 2.0
"""Until then the setpoint is held, so that the step begins at rest."""
SINES_AT_s: Final = 12.0
PHASE: Final = "trial"


@dataclass(frozen=True)
class LawTrial:
    """How a law followed.

    Parameters
    ----------
    report : LawReport or None
        What ended it; None for the board's own law.
    flight : Flight
        What it flew, with time from its first tick on.
    """

    report: LawReport | None
    flight: Flight

    def __str__(self) -> str:
        elevation, _, travel = responses(self.flight)
        settled = "not settled" if math.isnan(travel.settling_s) else f"settled in {travel.settling_s:.1f} s"
        step = f"{travel.overshoot_percent:.0f} % over, {settled}"
        over = f"; taken over: {self.report.taken_over}" if self.report and self.report.taken_over else ""
        return (
            f"step of travel: {'not flown to its end' if math.isnan(travel.step_deg) else step}; "
            f"rms error {elevation.rms_deg:.2f} deg of elevation, {travel.rms_deg:.2f} of travel; "
            f"effort {effort_V(self.flight):.2f} V{over}"
        )


def try_law(
    law: Law | None,
    address: str,
    seconds: float,
    log: Path | None = None,
    on_connected: Callable[[heli_host.Heli], object] = lambda heli: None,
) -> LawTrial:
    """Fly a law on a board.

    Parameters
    ----------
    law : Law or None
        What flies; None: the board's own.
    address : str
        As `heli_host.connect` takes it.
    seconds : float
        How long [s].
    log : Path or None
        Log to write.
    on_connected : callable taking Heli
        Called before anything moves, to check the board; what it raises ends the trial.

    Raises
    ------
    HeliError
        The board does not take the law, or the flight ended with a fault.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = log if log is not None else Path(folder) / "trial.mcap"
        report = _fly(law, address, seconds, path, on_connected)
        return LawTrial(report, flight_of_law(path))


def _fly(
    law: Law | None,
    address: str,
    seconds: float,
    log: Path,
    on_connected: Callable[[heli_host.Heli], object],
) -> LawReport | None:
    with heli_host.connect(address, land_on_exit=True) as heli, contextlib.ExitStack() as stack:
        on_connected(heli)
        recorder = stack.enter_context(Recorder(heli, log))
        heli.take_off()
        heli.setpoint(elevation_deg=0.0, travel_deg=0.0)
        start = heli.latest.tick if law is None else engage(heli, law.program)
        recorder.mark_phase(start, PHASE)

        def steer(new: Ticks) -> None:
            t_s = (int(new.tick[-1]) - start) * 1e-3
            swings_s = max(0.0, t_s - SINES_AT_s)
            stepped_deg = STEP_deg if t_s >= STEP_AT_s else 0.0
            heli.setpoint(
                elevation_deg=4.0 * math.sin(2.0 * math.pi * swings_s / 15.0),
                travel_deg=stepped_deg + STEP_deg * math.sin(2.0 * math.pi * swings_s / 20.0),
            )

        unsubscribe = heli.session.subscribe_ticks(steer)
        report = None
        if law is not None:
            report = fly_law(heli, law.program, duration_s=seconds)
        else:
            heli.wait(seconds)
        unsubscribe()
        recorder.mark_phase(heli.latest.tick, LANDING)
        heli.land()
    return report
