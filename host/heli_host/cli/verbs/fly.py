"""``heli-host fly``: fly plans, and leave a log, a summary and a figure."""

from __future__ import annotations

import secrets
from pathlib import Path
from typing import Annotated

import typer

from heli_host.cli import simulated
from heli_host.cli.gains import GainsOption, ParamsFileOption, check_gains, chosen_parameters
from heli_host.cli.options import ClearFaultOption, PortOption, flight_folder
from heli_host.cli.say import say, say_files, say_progress
from heli_host.cli.twin_options import OnChangeOption, TwinOption, check_on_change, open_watch, read_twin
from heli_host.cli.verb import Verb


def fly(
    plans: Annotated[
        list[str], typer.Argument(metavar="PLAN...", help="Built-in plans (hover, sine, ...) or TOML files.")
    ],
    port: PortOption = None,
    sil: simulated.SilOption = False,
    board: simulated.BoardOption = None,
    elf: simulated.ElfOption = None,
    rig: simulated.RigOption = None,
    model: simulated.ModelOption = None,
    effect: simulated.EffectOption = None,
    effects: simulated.EffectFilesOption = None,
    speed: simulated.SpeedOption = "1",
    seed: Annotated[
        int | None,
        typer.Option(
            "--seed",
            min=0,
            help="Seed of everything random in the simulation.  [default: 1; with --blind a random seed]",
        ),
    ] = None,
    blind: Annotated[
        bool,
        typer.Option(
            "--blind",
            help="Leave rig, effects and seed out of all files but LOG.truth.json; needs --sil.",
        ),
    ] = False,
    clear_fault: ClearFaultOption = False,
    gains: GainsOption = None,
    params: ParamsFileOption = None,
    twin: TwinOption = None,
    on_change: OnChangeOption = None,
    log: Annotated[Path | None, typer.Option("--log", metavar="FILE", help="Log, MCAP.")] = None,
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="Summary.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="FILE", help="Figure: .png, .pdf or .svg.")
    ] = None,
) -> None:
    """Take off, fly plans one after the other, land. Ctrl-C lands too; a second Ctrl-C stops the motors.

    Without --log, --json and --figure the three files go into a new folder, flights/<time>/. With any of them
    only those are written, and the log always is.

    With --blind the log has a seal, a salted digest of what flew. The truth is written next to the log, as
    LOG.truth.json: keep it, and hand out the other files. `heli-host info LOG --truth LOG.truth.json`
    compares the two.

    Example: `heli-host fly hover sine --sil --speed 5`
    """
    from heli_host.cli.board import board_text, check_board_rig, clear_latched_fault, open_board
    from heli_host.cli.outputs import check_result_places
    from heli_host.cli.progress import LiveLine
    from heli_host.cli.report import summary_lines
    from heli_host.errors import FlightAborted
    from heli_host.fly.interrupts import was_interrupted
    from heli_host.fly.plan import load_plan
    from heli_host.fly.runner import Progress
    from heli_host.fly.runner import fly as fly_plans
    from heli_host.link.transport import transport_label, transport_note, transport_rig
    from heli_host.log.blind import Truth, truth_path
    from heli_host.log.disk import check_new
    from heli_host.published_gains import load_gains

    simulated.parse_speed(speed)
    land_on_change = check_on_change(twin, on_change)
    if not sil:
        simulated.refuse_without_sil(
            board=board, elf=elf, model=model, effect=effect, effects=effects, blind=blind
        )
    if blind and twin is not None:
        raise typer.BadParameter("--twin names what has changed; leave it out, or leave out --blind")
    if seed is None:
        # The flight of a known seed could be flown again with each effect, and compared byte by byte.
        seed = secrets.randbelow(1 << 31) if blind else 1
    address = simulated.sil_address(
        rig=rig,
        speed=speed,
        seed=seed,
        board=board,
        elf=elf,
        model=model,
        effect=effect,
        effect_files=effects,
    )
    check_gains(gains, sil)
    parameters = chosen_parameters(params, gains)
    loaded = [load_plan(plan) for plan in plans]
    check_result_places(json, figure=figure)
    if log is not None:
        check_new(log)
    truth = None
    if blind:
        truth = Truth.seal(
            simulated.flown(
                address, rig=rig, model=model, effect=effect, effect_files=effects, seed=seed, plans=plans
            )
        )
    maker = read_twin(twin)
    with open_board(port, address if sil else None) as heli:
        if clear_fault:
            clear_latched_fault(heli)
        load_gains(heli.params, gains)
        if parameters:
            heli.params.restore(parameters)
        check_board_rig(heli, rig)
        everything = log is None and json is None and figure is None
        folder = flight_folder() if log is None else log.parent
        log = log if log is not None else folder / "flight.mcap"
        json, figure = (folder / "summary.json", folder / "figure.png") if everything else (json, figure)
        text, transport = board_text(heli, hidden=blind), heli.session.transport
        key = truth_path(log)
        if truth is not None:
            truth.write(key)
        if note := transport_note(transport):
            say_progress(note)
        say_progress(text, f"flying: {', then '.join(plan.title for plan in loaded)}")
        watch = open_watch(heli, maker)
        with LiveLine() as live:

            def show(progress: Progress) -> None:
                live.show(
                    progress.sample,
                    progress.counters,
                    t_s=progress.t_s,
                    phase=progress.phase,
                    left_s=progress.left_s,
                )

            summary = fly_plans(
                heli,
                loaded,
                log_path=log,
                json_path=json,
                figure_path=figure,
                on_progress=show,
                rig_name="" if blind else simulated.rig_name(rig, simulated=sil),
                rig=rig or transport_rig(transport),
                board_name=transport_label(transport).partition(",")[0].removesuffix(" board"),
                twin=watch,
                land_on_change=land_on_change,
                sealed=truth.digest if truth is not None else "",
            )
    say(*summary_lines(summary), f"board: {text}")
    if watch is not None:
        say(f"twin: {watch.words()}")
    say_files((log, json, figure))
    if truth is not None:
        say(f"sealed: {truth.digest}", f"truth, not for those who search: {key}")
    if was_interrupted(summary.outcome):
        raise KeyboardInterrupt
    if not summary.completed:
        raise FlightAborted(summary.outcome)


VERB = Verb(fly, "Fly")
