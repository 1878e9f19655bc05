"""``heli-host record``: record without flying."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heli_host.ui.cli.options import DurationOption, FoxgloveOption, JsonOption, PortOption, flight_folder
from heli_host.ui.cli.say import data_on_stdout, say, say_progress, write_result
from heli_host.ui.cli.simulated import RigOption, SilOption, SpeedOption, rig_name, sil_address
from heli_host.ui.cli.verb import Verb

STEP_S = 0.25
"""Device time between two looks at the clock."""


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
    from heli_host.ui.cli.board import open_board
    from heli_host.ui.cli.progress import LiveLine
    from heli_host.ui.cli.report import summary_lines
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
                for passed_s in heli.pace(STEP_S, duration_s):
                    recorder.check()
                    left_s = None if duration_s is None else duration_s - passed_s
                    live.show(heli.latest, heli.counters, t_s=passed_s, phase="recording", left_s=left_s)
        except KeyboardInterrupt:
            # A recording without --duration ends this way.
            pass
    summary = summarise(read_log(path))
    say(*summary_lines(summary), f"log: {path}")
    write_result(json, {**summary.as_dict(), "log": str(path)})


VERB = Verb(record, "Fly", aliases=("log",))
