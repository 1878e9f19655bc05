"""The verbs that command or record a running board: ``fly``, ``setpoint``, ``record`` and ``watch``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.ui.cli.board import board_text, check_board_rig, clear_latched_fault, open_board
from heli_host.ui.cli.flight import FlightOptions, fly_again, fly_plans
from heli_host.ui.cli.options import (
    MAX_SPEED,
    ClearFaultOption,
    DurationOption,
    FoxgloveOption,
    JsonOption,
    PortOption,
    RigOption,
    SilOption,
    SpeedOption,
    flight_folder,
    rig_name,
    sil_address,
)
from heli_host.ui.cli.say import data_on_stdout, say, say_progress, summary_lines, write_result
from heli_host.ui.cli.verb import Verb, with_option_groups

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.samples import Sample
    from heli_host.declaration import Axes
    from heli_host.fly.recorder import Recorder
    from heli_host.ui.cli.live import LiveDisplay

_HOLD_STEP_S = 0.1
"""Device time between two looks at the clock."""
_RECORD_STEP_S = 0.25
"""Device time between two looks at the clock."""
_WATCH_STEP_S = 0.2
"""Device time between two looks."""
_WATCH_LINE_S = 1.0
"""When the output goes to a file or another program."""


@with_option_groups()
def fly(
    plans: Annotated[
        list[str] | None,
        typer.Argument(metavar="PLAN...", help="Fly these plans: built-in (hover, sine) or TOML files."),
    ] = None,
    again: Annotated[
        Path | None,
        typer.Option("--again", metavar="LOG", help="Repeat the simulated flight of this log exactly."),
    ] = None,
    *,
    options: FlightOptions,
) -> None:
    """Take off, fly plans one after the other, and land.

    Writes the log, a summary and a figure into a new folder, flights/TIME/. With --log, --json or --figure,
    it writes a log, and the other files only if you name them. Ctrl-C lands. A second Ctrl-C stops the
    motors.

    --blind leaves rig, effects and seed out of the log, and seals them by a salted digest. The truth goes to
    LOG.truth.json next to the log. Keep it, and share the other files. `heli-host info LOG --truth
    LOG.truth.json` compares the two.

    --again reads rig, effects, seed, parameters and plans from the log of an earlier flight, and compares the
    samples. Files with effects are code, so the log does not hold them: give them with --effect-file.

    Example: `heli-host fly hover sine --sil --speed 5`
    """
    from heli_host.fly.plan import load_plan

    if not plans and again is None:
        raise typer.BadParameter("no plan is given; name one, such as hover, or give --again LOG")
    if again is not None:
        _refuse_with_again(again, options, plans or ())
        flown = fly_again(again, options)
    else:
        named = list(plans or ())
        flown = fly_plans(options, [load_plan(plan) for plan in named], plan_names=named)
    flown.report()
    flown.write()
    flown.raise_if_not_completed()


def _refuse_with_again(again: Path, options: FlightOptions, plans: Sequence[str]) -> None:
    """Refuse options that a log gives: a typer.BadParameter that names the first."""
    given_options = {
        **{f"PLAN {plan}": True for plan in plans},
        "--port": options.port is not None and options.port != os.environ.get("HELI_PORT"),
        "--sil": options.sil,
        "--board": options.board,
        "--elf": options.elf,
        "--rig": options.rig,
        "--model": options.model,
        "--effect": options.effect,
        "--speed": options.speed not in ("1", MAX_SPEED),
        "--seed": options.seed is not None,
        "--blind": options.blind,
        "--gains": options.gains,
        "--params": options.params,
        "--clear-fault": options.clear_fault,
        "--twin": options.twin,
    }
    for name, value in given_options.items():
        if value:
            raise typer.BadParameter(f"--again {again} takes this from the log: {name}; leave it out")


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
        bool, typer.Option("--keep", help="Keep flying at the end, so that another command can take over.")
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
    from heli_host.board.flying import ALL_AXES, check_setpoint
    from heli_host.board.interrupts import name_of
    from heli_host.data.log.disk import check_new
    from heli_host.declaration import Axes
    from heli_host.errors import FlightAborted, HeliError
    from heli_host.fly.recorder import Recorder

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
            # The landing noted what went wrong in it.
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
    from heli_host.ui.cli.live import LiveLine

    heli.setpoint(**{f"{axis}_deg": value_deg for axis, value_deg in targets_deg.items()})
    with LiveLine() as live:
        for passed_s in heli.pace(_HOLD_STEP_S, duration_s):
            if recorder is not None:
                recorder.check()
            sample = heli.latest
            if sample.state in (State.FAULT, State.IDLE):
                raise FlightAborted(f"the motors were switched off: {fault_text(sample.fault)}")
            live.show(sample, heli.counters, t_s=passed_s, phase="setpoint", left_s=duration_s - passed_s)


def record(
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FILE",
            help="Write this log.  [default: flights/TIME/flight.mcap]",
            show_default=False,
        ),
    ] = None,
    duration_s: DurationOption = None,
    json: JsonOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
    foxglove: FoxgloveOption = None,
) -> None:
    """Record every tick of a board without sending commands.

    No motor starts. Use it to check encoders, or while another program flies. Ctrl-C ends the recording and
    keeps the log.

    Example: `heli-host record --port /dev/ttyACM0 --duration 30 -o turning-by-hand.mcap`
    """
    from heli_host.data.log.disk import check_new
    from heli_host.data.log.reader import read_log
    from heli_host.data.log.summary import summarise
    from heli_host.fly.recorder import Recorder
    from heli_host.ui.cli.live import LiveLine
    from heli_host.ui.foxglove_feed import foxglove_feed

    if output is not None:
        check_new(output)
    data_on_stdout(json)
    with (
        open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli,
        foxglove_feed(heli, foxglove) as feed,
    ):
        if feed is not None:
            say_progress(f"viewers: {feed.address}")
        path = output if output is not None else flight_folder() / "flight.mcap"
        recorder = Recorder(heli, path, rig_name=rig_name(rig, simulated=sil))
        try:
            with recorder, LiveLine() as live:
                for passed_s in heli.pace(_RECORD_STEP_S, duration_s):
                    recorder.check()
                    left_s = None if duration_s is None else duration_s - passed_s
                    live.show(heli.latest, heli.counters, t_s=passed_s, phase="recording", left_s=left_s)
        except KeyboardInterrupt:
            # A recording without --duration ends this way.
            pass
    summary = summarise(read_log(path))
    say(*summary_lines(summary), f"log: {path}")
    write_result(json, {**summary.as_dict(), "log": str(path)})


def watch(
    duration_s: DurationOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Show counts, angles, encoder errors, voltages and state, live.

    Sends no command, so that no motor starts. Turn an axis by hand, and see which counter moves, and which
    way. Ctrl-C ends it.

    Example: `heli-host watch --port /dev/ttyACM0 --duration 60`
    """
    with open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli:
        info = heli.info
        say(f"{board_text(heli)}; last start: {info.reset}; parameters: {info.params_source}")
        if info.boot_fault:
            say(f"before that start: {info.boot_fault}")
        try:
            _show_until(heli, duration_s)
        except KeyboardInterrupt:
            # Watching without --duration ends this way.
            print()


def _show_until(heli: Heli, duration_s: float | None) -> None:
    """Show the newest sample until `duration_s` has passed on the device; until Ctrl-C if it is None."""
    from heli_host.ui.cli.live import LiveDisplay

    with LiveDisplay(_WATCH_LINE_S) as live:
        for passed_s in heli.pace(_WATCH_STEP_S, duration_s):
            if live.due:
                _show_sample(heli, live, passed_s)


def _show_sample(heli: Heli, live: LiveDisplay, passed_s: float) -> None:
    """Show a sample: angles, encoder counts, illegal transitions and link. Without a terminal it is one line
    of text.
    """
    from math import tau

    from heli_host.declaration import AXES
    from heli_host.errors import fault_text
    from heli_host.ui.cli.live import heading, link_text, numbers_table

    sample, status = heli.latest, heli.session.status()
    illegal = {axis: int(getattr(status, f"illegal_{axis}")) for axis in AXES}
    counts = {
        axis: round(getattr(sample, f"{axis}_rad") / tau * abs(heli.params[f"{axis}_counts_per_rev"]))
        for axis in AXES
    }
    if not live.is_terminal:
        live.print_line(line(sample, counts, illegal))
        return
    fault = fault_text(sample.fault) if sample.fault else ""
    live.replace(
        heading(sample, passed_s, phase="watching", left_s=None),
        numbers_table(sample, counts, illegal),
        *([fault] if fault else []),
        f"link: {link_text(heli.counters)}",
    )


def line(sample: Sample, counts: Mapping[str, int], illegal: Mapping[str, int]) -> str:
    """Say in one line what a board measures and does: for each axis counts, degrees and illegal transitions;
    then voltages, state and fault.
    """
    axes = [
        f"{axis} {counts[axis]:+6d} ({getattr(sample, f'{axis}_deg'):+7.2f} deg, {illegal[axis]} bad)"
        for axis in counts
    ]
    fault = f", fault {sample.fault.name.lower()}" if sample.fault else ""
    volts = f"front {sample.front_V:+.2f} V, back {sample.back_V:+.2f} V"
    return f"{'  '.join(axes)}  {volts}  {sample.state.name.lower()}{fault}"


VERBS = {
    "fly": Verb(fly, "Fly"),
    "record": Verb(record, "Fly", aliases=("log",)),
    "setpoint": Verb(setpoint, "Fly"),
    "watch": Verb(watch, "Fly"),
}
