"""A flight to judge a law by: a step of travel, then sines of elevation and travel."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import heli_host
import numpy as np
import numpy.typing as npt
from heli_host.declaration import Channel
from heli_host.fly.recorder import Recorder
from heli_host.guest_law import LawReport, engage, fly_law
from heli_host.link.channels import physical
from heli_host.link.telemetry import Ticks

from heli_lab.law.law import Law

Floats = npt.NDArray[np.float64]

STEP_deg: Final = 10.0
STEP_s: Final = 10.0
BAND_deg: Final = 1.0


@dataclass(frozen=True)
class LawTrial:
    """How a law followed.

    Parameters
    ----------
    report : LawReport or None
        What ended it; None for the board's own law.
    overshoot_percent, settling_s : float
        Of the step of travel, from the shaped setpoint's end value, to within a degree; nan when it did not
        settle.
    elevation_rms_deg, travel_rms_deg : float
        Errors from the setpoints that the law followed, as logged [deg].
    effort_V : float
        Root mean square of the voltages' change around their mean [V].
    """

    report: LawReport | None
    overshoot_percent: float
    settling_s: float
    elevation_rms_deg: float
    travel_rms_deg: float
    effort_V: float

    def __str__(self) -> str:
        over = f"; taken over: {self.report.taken_over}" if self.report and self.report.taken_over else ""
        return (
            f"step of travel: {self.overshoot_percent:.0f} % over, settled in {self.settling_s:.1f} s; "
            f"rms error {self.elevation_rms_deg:.2f} deg of elevation, {self.travel_rms_deg:.2f} of travel; "
            f"effort {self.effort_V:.2f} V{over}"
        )


def try_law(law: Law | None, address: str, seconds: float, log: Path | None = None) -> LawTrial:
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

    Raises
    ------
    HeliError
        The board does not take the law, or the flight ended with a fault.
    """
    kept: list[Ticks] = []
    with heli_host.connect(address, land_on_exit=True) as heli:
        recorder = Recorder(heli, log) if log is not None else contextlib.nullcontext()
        with recorder:
            heli.take_off()
            if law is not None:
                engage(heli, law.tape)
            start = heli.latest.tick

            def steer(new: Ticks) -> None:
                kept.append(new)
                t_s = (int(new.tick[-1]) - start) * 1e-3 - STEP_s
                sine = t_s > 0.0
                heli.setpoint(
                    elevation_deg=4.0 * float(np.sin(2.0 * np.pi * t_s / 15.0)) if sine else 0.0,
                    travel_deg=STEP_deg * (1.0 + (float(np.sin(2.0 * np.pi * t_s / 20.0)) if sine else 0.0)),
                )

            unsubscribe = heli.session.subscribe_ticks(steer)
            report = None
            if law is not None:
                report = fly_law(heli, law.tape, duration_s=seconds)
            else:
                heli.wait(seconds)
            unsubscribe()
            heli.land()
    return _judged(np.concatenate([one.raw for one in kept]), report)


def _judged(raw: npt.NDArray[np.int32], report: LawReport | None) -> LawTrial:
    def column(channel: Channel) -> Floats:
        return np.asarray(physical(raw, channel), float)

    per_count = 360.0 / 4096.0
    elevation_deg = raw[:, Channel.ELEVATION_COUNT] * per_count
    travel_deg = raw[:, Channel.TRAVEL_COUNT] * per_count
    wanted = np.degrees(column(Channel.ELEVATION_SETPOINT)), np.degrees(column(Channel.TRAVEL_SETPOINT))
    step = travel_deg[: round(STEP_s * 1e3)]
    outside = np.flatnonzero(np.abs(step - STEP_deg) > BAND_deg)
    settled = len(outside) == 0 or outside[-1] < len(step) - 1
    volts = np.column_stack([column(Channel.FRONT), column(Channel.BACK)])
    return LawTrial(
        report,
        max(0.0, float(step.max() - STEP_deg)) / STEP_deg * 100.0,
        (float(outside[-1] + 1) * 1e-3 if len(outside) else 0.0) if settled else float("nan"),
        float(np.sqrt(np.mean((elevation_deg - wanted[0]) ** 2))),
        float(np.sqrt(np.mean((travel_deg - wanted[1]) ** 2))),
        float(np.sqrt(np.mean(volts.var(axis=0)))),
    )
