"""``heli-host log``: record without flying."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from heli_host.cli.options import ForOption, PortOption, flight_folder
from heli_host.cli.say import say
from heli_host.cli.simulated import RigOption, SilOption, SpeedOption, rig_name, sil_address
from heli_host.cli.verb import Verb

STEP_S = 0.25
"""Device time between two looks at the clock."""


def log(
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE", help="Log to write; else flights/<time>/flight.mcap."),
    ] = None,
    for_s: ForOption = None,
    port: PortOption = None,
    sil: SilOption = False,
    rig: RigOption = None,
    speed: SpeedOption = "1",
) -> None:
    """Record every tick without commanding anything: to check encoders, or what another program flies.

    Example: `heli-host log --for-s 30 -o turning-by-hand.mcap`
    """
    from heli_host.cli.board import open_board
    from heli_host.cli.progress import LiveLine
    from heli_host.cli.report import summary_lines
    from heli_host.fly.recorder import Recorder
    from heli_host.log.disk import check_new
    from heli_host.log.reader import read_log
    from heli_host.log.summary import summarise

    if out is not None:
        check_new(out)
    with open_board(port, sil_address(rig=rig, speed=speed) if sil else None) as heli:
        path = out if out is not None else flight_folder() / "flight.mcap"
        recorder = Recorder(heli, path, rig_name=rig_name(rig, simulated=sil))
        try:
            with recorder, LiveLine() as live:
                start_s = heli.latest.t_s
                passed_s = 0.0
                while for_s is None or passed_s < for_s:
                    heli.wait(STEP_S if for_s is None else min(STEP_S, for_s - passed_s))
                    recorder.check()
                    sample = heli.latest
                    passed_s = sample.t_s - start_s
                    left_s = None if for_s is None else for_s - passed_s
                    live.show(sample, heli.counters, t_s=passed_s, phase="recording", left_s=left_s)
        except KeyboardInterrupt:
            # This is how a recording without --for-s is meant to end.
            pass
    say(*summary_lines(summarise(read_log(path))), f"log: {path}")


VERB = Verb(log, "Fly")
