"""``heli-host sil``: the simulated board behind a port that any program can open."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from heli_host.cli.options import DEFAULT_RIG, RigOption, SeedOption, SpeedOption, parse_speed


def sil(
    pty: Annotated[
        str | None,
        typer.Option("--pty", metavar="PATH", help="Serve a pseudo-terminal; PATH becomes a link to it."),
    ] = None,
    tcp: Annotated[
        str | None,
        typer.Option("--tcp", metavar="HOST:PORT", help="Serve TCP; hosts connect to socket://HOST:PORT."),
    ] = None,
    rig: RigOption = None,
    speed: SpeedOption = "1",
    seed: SeedOption = 1,
) -> None:
    """Simulate a board and its helicopter behind a serial port, until Ctrl-C.

    Example: `heli-host sil --pty ./due`, and in another terminal: `heli-host fly hover --port ./due`
    """
    if (pty is None) == (tcp is None):
        raise typer.BadParameter("give one of --pty PATH and --tcp HOST:PORT")
    from heli_sim.sil.options import SilOptions
    from heli_sim.sil.server import run_server

    options = SilOptions(rig=rig or DEFAULT_RIG, seed=seed, speed=parse_speed(speed))

    def say(url: str) -> None:
        pace = "as fast as the host keeps up" if options.speed is None else f"{options.speed:g} x real time"
        print(f"simulated board on {url}, rig {options.rig}, {pace}; Ctrl-C ends it", flush=True)

    counters = run_server(options, pty=pty, tcp=tcp, on_ready=say)
    # Whoever started this may have gone, and its pipe with it.
    if not sys.stdout.closed:
        print(
            f"simulated {counters['ticks'] / 1000:.1f} s; {counters['to_host_bytes']} bytes to the host, "
            f"{counters['to_board_bytes']} to the board, {counters['to_host_overflow']} lost in the bridge"
        )
