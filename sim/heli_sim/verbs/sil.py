"""``heli-host sil``: the simulated board behind a port that any program can open."""

from __future__ import annotations

import sys
from typing import Annotated

import typer
from heli_host.ui.cli.options import (
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
from heli_host.ui.cli.say import say
from heli_host.ui.cli.verb import Verb


def sil(
    pty: Annotated[
        str | None,
        typer.Option("--pty", metavar="PATH", help="Serve a pseudo-terminal, and link PATH to it."),
    ] = None,
    tcp: Annotated[
        str | None,
        typer.Option(
            "--tcp", metavar="HOST:PORT", help="Serve TCP, for hosts that use --port socket://HOST:PORT."
        ),
    ] = None,
    rfc2217: Annotated[
        str | None,
        typer.Option(
            "--rfc2217",
            metavar="HOST:PORT",
            help="Serve RFC 2217, for hosts that use --port rfc2217://HOST:PORT.",
        ),
    ] = None,
    board: BoardOption = None,
    elf: ElfOption = None,
    reset_on_open: Annotated[
        bool | None,
        typer.Option(
            "--reset-on-open/--no-reset-on-open",
            help="Reset the board when the port opens.  [default: on the emulated Due only]",
            show_default=False,
        ),
    ] = None,
    rig: RigOption = None,
    model: ModelOption = None,
    effect: EffectOption = None,
    effect_file: EffectFilesOption = None,
    encoder_out: Annotated[
        list[str] | None,
        typer.Option(
            "--encoder-out",
            metavar="AXIS:START[:LENGTH]",
            help="Unplug an encoder at START, in simulated s. Repeatable.",
        ),
    ] = None,
    stop_switch: Annotated[
        list[str] | None,
        typer.Option(
            "--stop-switch",
            metavar="START[:LENGTH]",
            help="Press the stop switch at START, in simulated s. Repeatable.",
        ),
    ] = None,
    supply_out: Annotated[
        list[str] | None,
        typer.Option(
            "--supply-out",
            metavar="START[:LENGTH]",
            help="Switch the motors' supply off at START, in simulated s. Repeatable.",
        ),
    ] = None,
    speed: SpeedOption = "1",
    seed: SeedOption = 1,
) -> None:
    """Simulate a board and its rig behind a serial port (software in the loop).

    Serves until Ctrl-C. Only this computer can connect, unless you give another HOST. To simulate a failure,
    type it in the terminal of this command: `stop`, `release`, `pull pitch`, `plug pitch`, `supply off` or
    `supply on`.

    Example: `heli-host sil --pty ./due`, and in another terminal: `heli-host fly hover --port ./due`
    """
    if (pty, tcp, rfc2217).count(None) != 2:
        raise typer.BadParameter(
            "sil needs exactly one port to serve; give one of --pty PATH, --tcp HOST:PORT and --rfc2217 "
            "HOST:PORT"
        )
    from heli_sim.rig import load_rig
    from heli_sim.rig.board import in_simulation, set_from_rig_text
    from heli_sim.sil.boards import choose
    from heli_sim.sil.fault_console import HELP
    from heli_sim.sil.faults import RigFaults
    from heli_sim.sil.options import SilOptions, parse_encoders_out, parse_times
    from heli_sim.sil.server import is_local, run_server

    rig_name = rig or DEFAULT_RIG
    loaded_rig = load_rig(rig_name)
    set_parameters_text = set_from_rig_text(loaded_rig.name, in_simulation(loaded_rig))
    chosen_board = choose(which_board(board, elf), str(elf) if elf is not None else "")
    options = SilOptions(
        rig=rig_name,
        seed=seed,
        speed=parse_speed(speed),
        board=chosen_board.name,
        elf=chosen_board.elf,
        reset_on_open=reset_on_open,
        model=model or "",
        effects=tuple(effect or ()),
        effect_files=tuple(map(str, effect_file or ())),
        rig_faults=RigFaults(
            encoders_out=parse_encoders_out("--encoder-out", encoder_out or ()),
            stop_switch=parse_times("--stop-switch", stop_switch or ()),
            supply_out=parse_times("--supply-out", supply_out or ()),
        ),
    )
    # Failures are typed in this terminal. Windows cannot wait for a terminal and a port in one call.
    has_console = sys.platform != "win32" and sys.stdin is not None and sys.stdin.isatty()

    def say_ready(url: str) -> None:
        """Print the address of the board, what it simulates, and how fast."""
        pace = "as fast as the host keeps up" if options.speed is None else f"{options.speed:g} x real time"
        # Only the emulated Due has an ELF, which its text names.
        board_text = chosen_board.text if chosen_board.elf else "simulated board"
        rig_text = " with ".join(filter(None, (options.rig, ", ".join(options.effects))))
        say(f"{board_text} on {url}, rig {rig_text}, {pace}; Ctrl-C ends it")
        if set_parameters_text:
            say(set_parameters_text)
        if has_console:
            say(f"to rehearse, type: {HELP}")
        if not is_local(url):
            print(
                "warning: everybody on the network can fly this board, nothing asks who they are; "
                "127.0.0.1 keeps it on this machine",
                file=sys.stderr,
                flush=True,
            )

    counters = run_server(
        options,
        pty=pty,
        tcp=tcp,
        rfc2217=rfc2217,
        words_fd=sys.stdin.fileno() if has_console else None,
        answer=say,
        on_ready=say_ready,
    )
    # The program that reads this output may have ended.
    if not sys.stdout.closed:
        say(
            f"simulated {counters['ticks'] / 1000:.1f} s; {counters['to_host_bytes']} bytes to the host, "
            f"{counters['to_board_bytes']} to the board, {counters['to_host_overflow']} lost in the bridge"
        )


VERB = Verb(sil, "Simulation")
