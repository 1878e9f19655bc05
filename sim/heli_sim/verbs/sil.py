"""``heli-host sil``: the simulated board behind a port that any program can open."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from heli_host.cli.simulated import (
    DEFAULT_RIG,
    BoardOption,
    EffectFilesOption,
    EffectOption,
    ElfOption,
    ModelOption,
    RigOption,
    SeedOption,
    SpeedOption,
    parse_speed,
    which_board,
)
from heli_host.cli.verb import Verb


def sil(
    pty: Annotated[
        str | None,
        typer.Option("--pty", metavar="PATH", help="Serve a pseudo-terminal; PATH becomes a link to it."),
    ] = None,
    tcp: Annotated[
        str | None,
        typer.Option("--tcp", metavar="HOST:PORT", help="Serve TCP; hosts connect to socket://HOST:PORT."),
    ] = None,
    rfc2217: Annotated[
        str | None,
        typer.Option(
            "--rfc2217",
            metavar="HOST:PORT",
            help="Serve TCP with control lines and rate; hosts connect to rfc2217://HOST:PORT.",
        ),
    ] = None,
    board: BoardOption = None,
    elf: ElfOption = None,
    reset_on_open: Annotated[
        bool | None,
        typer.Option(
            "--reset-on-open/--no-reset-on-open",
            help="Whether opening the port resets the board.  [default: on the emulated Due it does]",
            show_default=False,
        ),
    ] = None,
    rig: RigOption = None,
    model: ModelOption = None,
    effect: EffectOption = None,
    effects: EffectFilesOption = None,
    speed: SpeedOption = "1",
    seed: SeedOption = 1,
) -> None:
    """Simulate a board and its helicopter behind a serial port, until Ctrl-C.

    Example: `heli-host sil --pty ./due`, and in another terminal: `heli-host fly hover --port ./due`
    """
    if (pty, tcp, rfc2217).count(None) != 2:
        raise typer.BadParameter("give one of --pty PATH, --tcp HOST:PORT and --rfc2217 HOST:PORT")
    from heli_sim.sil.boards import choose
    from heli_sim.sil.options import SilOptions
    from heli_sim.sil.server import run_server

    choice = choose(which_board(board, elf), str(elf) if elf is not None else "")
    options = SilOptions(
        rig=rig or DEFAULT_RIG,
        seed=seed,
        speed=parse_speed(speed),
        board=choice.name,
        elf=choice.elf,
        reset_on_open=reset_on_open,
        model=model or "",
        effects=tuple(effect or ()),
        effect_files=tuple(map(str, effects or ())),
    )

    def say(url: str) -> None:
        pace = "as fast as the host keeps up" if options.speed is None else f"{options.speed:g} x real time"
        what = "simulated board" if not choice.elf else choice.text
        flown = " with ".join(filter(None, (options.rig, ", ".join(options.effects))))
        print(f"{what} on {url}, rig {flown}, {pace}; Ctrl-C ends it", flush=True)

    counters = run_server(options, pty=pty, tcp=tcp, rfc2217=rfc2217, on_ready=say)
    # Whoever started this may have gone, and its pipe with it.
    if not sys.stdout.closed:
        print(
            f"simulated {counters['ticks'] / 1000:.1f} s; {counters['to_host_bytes']} bytes to the host, "
            f"{counters['to_board_bytes']} to the board, {counters['to_host_overflow']} lost in the bridge"
        )


VERB = Verb(sil, "Simulation")
