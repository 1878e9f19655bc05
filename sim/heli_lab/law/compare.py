"""Two flights over each other: how each followed its setpoints, in numbers and in a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.declaration import AXES, Flags
from heli_host.errors import FlightDataError, LogWriteError
from heli_host.flight import Flight
from heli_host.log.flight_file import read_flight
from heli_host.log.summary import flown_rows

Floats = npt.NDArray[np.float64]

# A step is a setpoint that moves by so much and then rests so long; settled is within the band for good. In a
# smaller band the encoders' counts (0.09 deg) and the rigs' friction decide.
LEAST_STEP_deg: Final = 2.0
REST_s: Final = 3.0
BAND_deg: Final = 0.5
_STILL_deg: Final = 0.02
# A quarter of a count: an axis that a law does not lead is logged with its own angle for a setpoint.
_NO_SETPOINT_deg: Final = 0.02
_COLOURS: Final = ("#0b5fa5", "#b3420f")
_JUDGED: Final = ("elevation", "travel")


@dataclass(frozen=True)
class Step:
    """How the first step of an axis was answered.

    Parameters
    ----------
    axis : str
        Which.
    size_deg : float
        From where the setpoint was to where it came to rest [deg].
    overshoot_percent : float
        Furthest beyond that, as a share of the step [%].
    settling_s : float
        From the step's beginning until the axis stays within half a degree of it [s]; nan: not before the
        setpoint moves again.
    """

    axis: str
    size_deg: float
    overshoot_percent: float
    settling_s: float

    def __str__(self) -> str:
        settled = "not settled" if np.isnan(self.settling_s) else f"settled in {self.settling_s:.1f} s"
        return f"{self.axis} step {self.size_deg:+.0f} deg: {self.overshoot_percent:.0f} % over, {settled}"


@dataclass(frozen=True)
class Judged:
    """A flight, cut to where its law flew.

    Parameters
    ----------
    name : str
        Of its file.
    flight : Flight
        The rows that count; time begins at 0.
    rms_deg : dict of str to float
        Error from the setpoints, by axis [deg]; without those that the law had no setpoint for.
    steps : tuple of Step
        First step of each axis that has one.
    effort_V : float
        Root mean square of the voltages around their mean [V].
    """

    name: str
    flight: Flight
    rms_deg: dict[str, float]
    steps: tuple[Step, ...]
    effort_V: float

    def __str__(self) -> str:
        rms = ", ".join(f"{axis} {error:.2f}" for axis, error in self.rms_deg.items())
        steps = "".join(f"; {step}" for step in self.steps)
        return f"{self.name}: rms error {rms} deg{steps}; effort {self.effort_V:.2f} V"


def judge(path: Path) -> Judged:
    """Read a log and judge what of it a law flew: the host's law where one did, else the board's own.

    Parameters
    ----------
    path : Path
        Log or table of a flight with setpoints.

    Raises
    ------
    FlightDataError
        It holds no flight under setpoints.
    """
    flight = read_flight(path, allow_gaps=True)
    rows = flown_rows(flight)
    if flight.flags is not None and (flight.flags[rows] & Flags.LAW).any():
        rows = rows & ((flight.flags & Flags.LAW) != 0)
    if flight.setpoints_rad is None or np.count_nonzero(rows) < round(REST_s / flight.step_s):
        raise FlightDataError(
            f"{path}: no flight under setpoints in it",
            "give a log in which a law flew, three seconds at least",
        )
    first, last = np.flatnonzero(rows)[[0, -1]]
    cut = flight.between(float(flight.t_s[first]), float(flight.t_s[last]))
    error_deg = np.degrees(cut.angles_rad - cut.setpoints_rad)  # type: ignore[operator]
    rms_deg = np.sqrt(np.mean(error_deg**2, axis=0))
    volts_V = np.column_stack([cut.front_V, cut.back_V])
    return Judged(
        path.stem,
        cut,
        {axis: rms for axis, rms in zip(AXES, rms_deg.tolist(), strict=True) if rms > _NO_SETPOINT_deg},
        tuple(step for axis in _JUDGED if (step := first_step(cut, axis)) is not None),
        float(np.sqrt(np.mean(volts_V.var(axis=0)))),
    )


def first_step(flight: Flight, axis: str) -> Step | None:
    """Find the first step of an axis' setpoint, and how it was answered.

    Parameters
    ----------
    flight : Flight
        With setpoints.
    axis : str
        Which axis.
    """
    setpoint_deg = np.degrees(getattr(flight, f"{axis}_setpoint_rad"))
    angle_deg = np.degrees(getattr(flight, f"{axis}_rad"))
    rest = round(REST_s / flight.step_s)
    # Stretches in which the setpoint does not move.
    moves = np.flatnonzero(np.abs(np.diff(setpoint_deg)) > _STILL_deg * flight.step_s)
    edges = np.concatenate([[-1], moves, [len(setpoint_deg) - 1]])
    began = 0
    for before, after in pairwise(edges.tolist()):
        if after - before < rest:
            continue
        size_deg = float(setpoint_deg[after] - setpoint_deg[began])
        if abs(size_deg) >= LEAST_STEP_deg:
            beyond_deg = (angle_deg[began : after + 1] - setpoint_deg[after]) * np.sign(size_deg)
            outside = np.flatnonzero(np.abs(beyond_deg) > BAND_deg)
            settled = outside[-1] + 1 < len(beyond_deg)
            return Step(
                axis,
                size_deg,
                100.0 * max(0.0, float(beyond_deg.max())) / abs(size_deg),
                float((outside[-1] + 1) * flight.step_s) if settled else float("nan"),
            )
        began = int(after)
    return None


def write_comparison(flights: Sequence[Judged], path: Path) -> None:
    """Draw flights over each other.

    Parameters
    ----------
    flights : sequence of Judged
        Two.
    path : Path
        ``.png``, ``.pdf`` or ``.svg`` to write.

    Raises
    ------
    LogWriteError
        It cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 9.0), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(AXES) + 1, 1, sharex=True)
    for one, colour in zip(flights, _COLOURS, strict=False):
        t_s = one.flight.t_s - one.flight.t_s[0]
        for panel, axis in zip(panels, AXES, strict=False):
            steps = ", ".join(str(step).partition(": ")[2] for step in one.steps if step.axis == axis)
            rms = one.rms_deg.get(axis)
            error = "no setpoint" if rms is None else f"{rms:.2f}° rms"
            label = f"{one.name}: {error}" + (f", {steps}" if steps else "")
            panel.plot(t_s, np.degrees(getattr(one.flight, f"{axis}_rad")), color=colour, lw=1.3, label=label)
            setpoint_deg = np.degrees(getattr(one.flight, f"{axis}_setpoint_rad"))
            panel.plot(t_s, setpoint_deg, color=colour, lw=0.8, ls=(0, (5, 2)), alpha=0.7)
            panel.set_ylabel(f"{axis} [°]")
        panels[-1].plot(
            t_s, one.flight.front_V, color=colour, lw=0.7, label=f"{one.name}: effort {one.effort_V:.2f} V"
        )
    panels[-1].set_ylabel("front [V]")
    panels[-1].set_xlabel("time since the law took over [s]")
    for panel in panels:
        panel.grid(True, color="#bbbbbb", lw=0.5, alpha=0.6)
        panel.margins(y=0.25)
        panel.legend(loc="upper right", fontsize=8.5, ncols=2, frameon=False)
        for side in ("top", "right"):
            panel.spines[side].set_visible(False)
    panels[0].set_title("measured (full) and setpoint (dashed)", fontsize=10, loc="left")
    try:
        figure.savefig(path, dpi=120, facecolor="white")
    except (OSError, ValueError) as error:
        raise LogWriteError(f"cannot write {path}: {error}", "give a .png, .pdf or .svg file") from error
