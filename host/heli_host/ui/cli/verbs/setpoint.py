"""``heli-host setpoint``: hold a setpoint for a while, by hand."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.ui.cli.options import ClearFaultOption, JsonOption, PortOption
from heli_host.ui.cli.say import data_on_stdout, say, write_result
from heli_host.ui.cli.simulated import RigOption, SilOption, SpeedOption, rig_name, sil_address
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.samples import Sample
    from heli_host.declaration import Axes
    from heli_host.fly.heli import Heli
    from heli_host.fly.recorder import Recorder

STEP_S = 0.1
"""Device time between two looks at the clock."""


def setpoint(
    elevation_deg: Annotated[
        float | None, typer.Option("--elevation-deg", metavar="DEG", help="Hold this elevation. 0 is level.")
    ] = None,
    travel_deg: Annotated[
        float | None, typer.Option("--travel-deg", metavar="DEG", help="Hold this travel angle.")
    ] = None,
    pitch_deg: Annotated[
        float | None,
        typer.Option("--pitch-deg", metavar="DEG", help="Hold this pitch, and leave travel free."),
    ] = None,
    duration_s: Annotated[
        float, typer.Option("--duration", metavar="S", min=0.1, help="Hold for this time in s.")
    ] = 10.0,
    take_off: Annotated[
        bool, typer.Option("--take-off", help="Arm and take off first if the board is idle.")
    ] = False,
    clear_fault: ClearFaultOption = False,
    keep: Annotated[
        bool,
        typer.Option("--keep", help="Keep flying at the end, so that another command can take over."),
    ] = False,
    log: Annotated[
        Path | None, typer.Option("--log", metavar="FILE", help="Record the flight into this log, .mcap.")
    ] = None,
    json: JsonOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Step to a setpoint, hold it, and land.

    The board must fly already, unless you add --take-off. Ctrl-C lands too. Without --log nothing is
    recorded.

    Example: `heli-host setpoint --sil --take-off --elevation-deg 5 --duration 20`
    """
    options_deg = {"elevation": elevation_deg, "pitch": pitch_deg, "travel": travel_deg}
    targets_deg = {axis: value for axis, value in options_deg.items() if value is not None}
    if not targets_deg:
        raise typer.BadParameter(
            "no setpoint is given; give at least one of --elevation-deg, --travel-deg and --pitch-deg"
        )
    if "pitch" in targets_deg and "travel" in targets_deg:
        raise typer.BadParameter(
            "--travel-deg and --pitch-deg exclude each other, because pitch controls travel; give one of them"
        )
    from heli_host.board.interrupts import name_of
    from heli_host.board.open_loop import ALL_AXES
    from heli_host.board.setpoints import check_setpoint
    from heli_host.data.log.disk import check_new
    from heli_host.declaration import Axes
    from heli_host.errors import FlightAborted, HeliError
    from heli_host.fly.recorder import Recorder
    from heli_host.ui.cli.board import check_board_rig, clear_latched_fault, open_board

    if log is not None:
        check_new(log)
    data_on_stdout(json)
    axes = Axes.ELEVATION | Axes.PITCH if "pitch" in targets_deg else ALL_AXES
    with contextlib.ExitStack() as stack:
        heli = stack.enter_context(open_board(port, sil_address(rig=rig, speed=speed) if sil else None))
        check_board_rig(heli, rig)
        check_setpoint(targets_deg, heli.params)
        if clear_fault:
            clear_latched_fault(heli)
        recorder = None
        if log is not None:
            recorder = Recorder(heli, log, rig_name=rig_name(rig, simulated=sil))
            stack.enter_context(recorder)
        error: HeliError | None = None
        sample: Sample | None = None
        try:
            with heli.landing_on_error():
                _begin_control(heli, axes, take_off)
                _hold_setpoints(heli, targets_deg, duration_s, recorder)
                sample = heli.latest
                say(
                    f"elevation {sample.elevation_deg:.1f}, pitch {sample.pitch_deg:.1f}, "
                    f"travel {sample.travel_deg:.1f} deg after {duration_s:g} s"
                )
                if keep:
                    heli.leave_flying()
                    say("left flying: the board holds level, and lands unless another command takes over")
                else:
                    heli.land()
                    say("landed")
        except KeyboardInterrupt as interrupt:
            notes = getattr(interrupt, "__notes__", ("the arm landed",))
            error = FlightAborted(f"{name_of(interrupt)} ended the flight; {'; '.join(notes)}")
        except HeliError as failure:
            error = failure
        write_result(
            json,
            {
                "outcome": "completed" if error is None else str(error),
                "targets_deg": targets_deg,
                "duration_s": duration_s,
                "elevation_deg": sample.elevation_deg if sample else None,
                "pitch_deg": sample.pitch_deg if sample else None,
                "travel_deg": sample.travel_deg if sample else None,
                "landed": error is None and not keep,
            },
        )
        if error is not None:
            raise error


def _begin_control(heli: Heli, axes: Axes, take_off: bool) -> None:
    """Bring the board under control of the host's setpoints for `axes`, by a take-off if it is permitted and
    needed.
    """
    from heli_host.declaration import State
    from heli_host.errors import SetpointError

    if heli.state in (State.IDLE, State.ARMED):
        if not take_off:
            raise SetpointError(f"the board is {heli.state.name.lower()}, not flying", "add --take-off")
        heli.take_off(axes=axes)
    elif heli.state is State.FAULT:
        heli.arm()  # is refused, and says which fault it is
    else:
        heli.control(axes)


def _hold_setpoints(
    heli: Heli, targets_deg: Mapping[str, float], duration_s: float, recorder: Recorder | None
) -> None:
    """Hold setpoints [deg] for a time [s of the device], with a status line; a FlightAborted reports that the
    board switched the motors off.
    """
    from heli_host.declaration import State
    from heli_host.errors import FlightAborted, fault_text
    from heli_host.ui.cli.progress import LiveLine

    heli.setpoint(**{f"{axis}_deg": value_deg for axis, value_deg in targets_deg.items()})
    with LiveLine() as live:
        for passed_s in heli.pace(STEP_S, duration_s):
            if recorder is not None:
                recorder.check()
            sample = heli.latest
            if sample.state in (State.FAULT, State.IDLE):
                raise FlightAborted(f"the motors were switched off: {fault_text(sample.fault)}")
            live.show(sample, heli.counters, t_s=passed_s, phase="setpoint", left_s=duration_s - passed_s)


VERB = Verb(setpoint, "Fly")
