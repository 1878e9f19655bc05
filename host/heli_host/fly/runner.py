"""Flies plans: check, take off, stream setpoints on device time, land; a log is written in any case."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from heli_host.board.interrupts import Interrupts
from heli_host.board.twins import EVENT
from heli_host.data.log.blind import hide
from heli_host.data.log.figure import write_figure
from heli_host.data.log.reader import Log, read_log
from heli_host.data.log.schema import TICK_LAYOUT
from heli_host.data.log.summary import FlightSummary, flight_findings, summarise
from heli_host.declaration import AXES
from heli_host.errors import LogError, PlanError
from heli_host.fly.pilot import Pilot, Progress
from heli_host.fly.plan import Plan, load_plan, take_off
from heli_host.fly.recorder import Recorder
from heli_host.fly.tracking import Tolerance

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.twins import TwinWatch

PlanLike = Plan | str | Path


def fly(
    heli: Heli,
    plans: PlanLike | Sequence[PlanLike],
    *,
    log_path: str | Path | None = None,
    json_path: str | Path | None = None,
    figure_path: str | Path | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    rig_name: str = "",
    rig: str = "",
    board_name: str = "",
    twin: TwinWatch | None = None,
    land_on_change: bool = False,
    on_taken_off: Callable[[], object] | None = None,
    overwrite: bool = False,
    seal_digest: str = "",
    setup: Mapping[str, str] = MappingProxyType({}),
) -> FlightSummary:
    """Take off, fly plans one after the other, land. Blocks until the motors are off and the log is complete.

    A fault, a lost link, a full disk or Ctrl-C ends the flight in a landing, as long as the board can be
    reached; the summary's outcome gives the reason, and the log is kept. A second Ctrl-C switches the motors
    off immediately: an arm in the air falls. The log has an event for each. SIGTERM and SIGHUP do the same if
    their handlers raise KeyboardInterrupt, as those of ``heli-host`` do.

    Parameters
    ----------
    heli : Heli
        Connected and idle, with its arm at rest on the table.
    plans : Plan, str or Path, or a sequence of them
        Plans, names of built-in plans, or TOML files.
    log_path : str or Path, optional
        Log to write (``.mcap``); without it no log is kept.
    json_path, figure_path : str or Path, optional
        Files to write the summary and the figure to.
    on_progress : callable taking Progress, optional
        Called in this thread about twenty times per second.
    rig_name : str
        Name of the rig, for the log.
    rig : str
        Name or file of the rig that the finished flight is checked against, for example for an encoder with
        other counts; empty for no check.
    board_name : str
        Description of the board, for the log; empty takes what the board reports. An emulated Due reports
        that it is a Due.
    on_taken_off : callable, optional
        Called once in this thread when the first plan begins, for example to engage a control law.
    twin : TwinWatch, optional
        Twin that compares the flight with a model; its alarms go into the log.
    land_on_change : bool
        True ends the flight in a landing when the twin raises an alarm.
    overwrite : bool
        True replaces an existing log; False refuses to fly if there is one.
    seal_digest : str
        Seal of a flight whose cause is hidden, see `heli_host.data.log.blind`: the log holds it instead of
        address, rig, seed and boot id. Empty for any other flight.
    setup : Mapping of str to str
        Settings of the board before the flight, for the log; see `heli_host.ui.cli.flight`.

    Returns
    -------
    FlightSummary
        ``outcome`` is ``completed``; begins with ``not_tracked`` if an axis did not follow its setpoint; or
        gives the reason of the end.

    Raises
    ------
    PlanError
        A plan cannot be flown on this board. The motors stay off.
    LogWriteError
        The log exists already, cannot be created, or the disk has too little room; the motors stay off. Or
        the summary or the figure cannot be written after the flight.
    """
    read_plans = _read_plans(plans)
    sample = heli.latest
    start_deg = np.degrees([getattr(sample, f"{axis}_rad") for axis in AXES])
    route = take_off(read_plans, dict(heli.params), start_deg)
    with _log_path_or_temporary(log_path) as path:
        recorder = Recorder(
            heli,
            path,
            rig_name=rig_name,
            plans=read_plans,
            board_name=board_name,
            duration_s=route.duration_s,
            overwrite=overwrite,
            seal_digest=seal_digest,
            setup=setup,
        )
        tolerance = Tolerance.widest([plan.tolerance for plan in read_plans])
        end_when = (lambda: twin.alarm) if twin is not None and land_on_change else None
        if twin is not None:
            twin.listen(lambda news: recorder.note(EVENT, news.text))
        with Interrupts() as interrupts:
            pilot = Pilot(
                heli=heli,
                route=route,
                axes=read_plans[0].axes,
                recorder=recorder,
                on_progress=on_progress,
                tolerance=tolerance,
                interrupts=interrupts,
                end_when=end_when,
                on_taken_off=on_taken_off,
            )
            try:
                pilot.fly()
            finally:
                if twin is not None:
                    twin.close()
                recorder.close(pilot.outcome)
        log = _read_log_or_disk_error(path, recorder)
    # From here on the motors are off and the log is complete, so that an error loses no data.
    outcome = hide(pilot.outcome) if seal_digest else pilot.outcome
    summary = replace(summarise(log), outcome=outcome, log=str(log_path) if log_path else "")
    if recorder.error is not None and str(recorder.error) not in summary.outcome:
        summary = replace(summary, notes=(*summary.notes, str(recorder.error)))
    if rig and len(log.ticks):
        summary = replace(summary, findings=flight_findings(log.flight(), rig))
    if json_path is not None:
        summary.write_json(json_path)
    if figure_path is not None:
        _draw_figure(log, summary, figure_path)
    return summary


def _read_log_or_disk_error(path: Path, recorder: Recorder) -> Log:
    """Read the log. If the disk took not even its beginning, report the disk's error, not the reader's."""
    try:
        return read_log(path)
    except LogError as error:
        if recorder.error is None:
            raise
        ticks = np.zeros(0, TICK_LAYOUT.dtype)
        return Log(
            path, ticks, TICK_LAYOUT, events=(), link=(), metadata={}, notes=(str(error),), complete=False
        )


def _read_plans(plans: PlanLike | Sequence[PlanLike]) -> list[Plan]:
    """Return plans as a list, and load those that are given by name or file."""
    listed = [plans] if isinstance(plans, Plan | str | Path) else list(plans)
    if not listed:
        raise PlanError("no plan is given", "give at least one plan, such as hover")
    return [plan if isinstance(plan, Plan) else load_plan(plan) for plan in listed]


@contextlib.contextmanager
def _log_path_or_temporary(log_path: str | Path | None) -> Iterator[Path]:
    """Yield the path of the log; without one, a path in a folder that is removed afterwards."""
    if log_path is not None:
        yield Path(log_path)
        return
    with tempfile.TemporaryDirectory(prefix="heli-") as folder:
        yield Path(folder) / "flight.mcap"


def _draw_figure(log: Log, summary: FlightSummary, path: str | Path) -> None:
    if len(log.ticks):
        write_figure(log.flight(), summary, path)


__all__ = ["Pilot", "Progress", "fly"]
