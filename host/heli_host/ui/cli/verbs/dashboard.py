"""``heli-host dashboard``: see a flight live in the browser, and fly from there."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from heli_host.ui.cli.board import board_text, check_board_rig, check_target, open_board
from heli_host.ui.cli.options import (
    DEFAULT_RIG,
    BoardOption,
    EffectFilesOption,
    EffectOption,
    ElfOption,
    FoxgloveOption,
    ModelOption,
    OnAlarmOption,
    PortOption,
    RigOption,
    SeedOption,
    SilOption,
    TwinOption,
    flight_folder,
    lands_on_alarm,
    open_watch,
    read_twin,
    refuse_without_sil,
    rig_name,
    sil_address,
)
from heli_host.ui.cli.say import say
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.law_program import LawProgram
    from heli_host.board.twins import TwinMaker
    from heli_host.fly.plan import Plan
    from heli_host.fly.recorder import Recorder
    from heli_host.ui.page.cockpit import Cockpit
    from heli_host.ui.page.serve import Address


def dashboard(
    plans: Annotated[
        list[str] | None, typer.Argument(metavar="[PLAN...]", help="Offer the plans of these TOML files too.")
    ] = None,
    port: PortOption = None,
    sil: SilOption = False,
    board: BoardOption = None,
    elf: ElfOption = None,
    rig: RigOption = None,
    model: ModelOption = None,
    effect: EffectOption = None,
    effect_file: EffectFilesOption = None,
    seed: SeedOption = 1,
    flown: Annotated[
        list[str] | None,
        typer.Option("--fly", metavar="PLAN", help="Fly this plan as soon as a page is open. Repeatable."),
    ] = None,
    laws: Annotated[
        list[Path] | None,
        typer.Option(
            "--law",
            metavar="FILE.py",
            help="Offer this control law too, and run its code. Repeatable.",
            show_default=False,
        ),
    ] = None,
    twin: TwinOption = None,
    on_alarm: OnAlarmOption = None,
    replay: Annotated[
        Path | None, typer.Option("--replay", metavar="FILE", help="Show this log instead of a board.")
    ] = None,
    host: Annotated[
        str,
        typer.Option(
            "--host", metavar="ADDRESS", help="Serve on this address, 0.0.0.0 for the whole network."
        ),
    ] = "127.0.0.1",
    http_port: Annotated[
        int,
        typer.Option(
            "--http-port", metavar="N", min=0, max=65535, help="Serve on this TCP port, 0 for a free one."
        ),
    ] = 0,
    foxglove: FoxgloveOption = None,
) -> None:
    """Serve a live page of the flight in the browser, and fly from there.

    Prints the address of the page, for this computer only. Nothing flies before you start a plan there, or
    with --fly. Space, Esc and the large button stop the motors. Ctrl-C lands and ends the server. Flights are
    recorded in flights/TIME/.

    Example: `heli-host dashboard --sil`
    """
    from heli_host.board.law_program import read_law
    from heli_host.fly.plan import load_plan, plan_names

    if replay is not None and sil:
        raise typer.BadParameter("--replay and --sil exclude each other; give one of them")
    if not sil:
        refuse_without_sil(board=board, elf=elf, model=model, effect=effect, effect_file=effect_file)
    land_on_alarm = lands_on_alarm(twin, on_alarm)
    if replay is not None:
        if twin is not None:
            raise typer.BadParameter(
                f"--twin needs a board; compare a log with: heli-host twin {replay} --rig {twin}"
            )
        if foxglove is not None:
            raise typer.BadParameter(f"--foxglove needs a board; viewers open {replay} as a file")
        if flown or laws or plans:
            raise typer.BadParameter(
                f"--replay {replay} shows a log and flies nothing; leave plans and laws out"
            )
        _serve_log(replay, rig, host, http_port)
        return
    check_target(port, sil)
    named_plans = [*(plans or ()), *(flown or ())]
    plan_files = dict.fromkeys(name for name in named_plans if name not in plan_names())  # each once
    offered_plans = [load_plan(name) for name in (*plan_names(), *plan_files)]
    # The page names a plan by its title, not by its file.
    first_plans = [load_plan(name).name for name in flown or ()]
    programs = [read_law(path, rig) for path in laws or ()]
    address = sil_address(
        rig=rig, seed=seed, board=board, elf=elf, model=model, effect=effect, effect_files=effect_file
    )
    _serve_board(
        port=port,
        address=address if sil else None,
        rig=rig,
        plans=offered_plans,
        first_plans=first_plans,
        laws=programs,
        twin_maker=read_twin(twin),
        land_on_alarm=land_on_alarm,
        host=host,
        http_port=http_port,
        foxglove=foxglove,
    )


def _serve_board(
    port: str | None,
    address: str | None,
    rig: str | None,
    plans: Sequence[Plan],
    first_plans: Sequence[str],
    laws: Sequence[LawProgram],
    twin_maker: TwinMaker | None,
    land_on_alarm: bool,
    host: str,
    http_port: int,
    foxglove: int | None,
) -> None:
    """Serve the page of a board until Ctrl-C; fly `first_plans` as soon as a page watches."""
    from heli_host.fly.recorder import Recorder
    from heli_host.link.transport import transport_board_name, transport_note
    from heli_host.ui.foxglove_feed import foxglove_feed
    from heli_host.ui.page.cockpit import Cockpit
    from heli_host.ui.page.serve import serving

    outline = _outline_of_rig(rig, simulated_board=address is not None)
    name = rig_name(rig, simulated=address is not None)
    with open_board(port, address) as heli, foxglove_feed(heli, foxglove) as feed:
        transport = heli.session.transport
        if note := transport_note(transport):
            say(note)
        if feed is not None:
            say(f"viewers: {feed.address}")
        board_line = board_text(heli)
        say(board_line)
        check_board_rig(heli, rig)

        def new_recorder(flown: Sequence[Plan], duration_s: float) -> Recorder:
            """Return the recorder of a flight in a new folder."""
            return Recorder(
                heli,
                flight_folder() / "flight.mcap",
                rig_name=name,
                plans=flown,
                board_name=transport_board_name(transport),
                duration_s=duration_s,
            )

        def land() -> None:
            if heli.motors_may_run:
                heli.land(wait=False)

        watch = open_watch(heli, twin_maker, land if land_on_alarm else None)
        cockpit = Cockpit(
            heli,
            new_recorder,
            plans=plans,
            board=board_line,
            rig=outline,
            twin=watch,
            laws=laws,
            rig_name=name,
        )
        try:
            with serving(cockpit, host, http_port) as served:
                _say_addresses(served)
                has_ended = threading.Event()
                if first_plans:
                    threading.Thread(
                        target=_fly_plans, args=(cockpit, first_plans, has_ended), name="plans", daemon=True
                    ).start()
                try:
                    with contextlib.suppress(KeyboardInterrupt):
                        heli.session.wait_for(has_ended.is_set)
                    _land_if_flying(heli)
                finally:
                    has_ended.set()  # plans that still wait for a page do not begin any more
        finally:
            if watch is not None:
                watch.close()
            cockpit.close()


def _fly_plans(cockpit: Cockpit, names: Sequence[str], ended: threading.Event) -> None:
    """Fly plans when a page watches, in a thread of its own, and print the outcome."""
    from heli_host.errors import HeliError

    try:
        result = cockpit.fly_when_watched(names, ended.is_set)
    except HeliError as error:
        say(f"not flown: {error}")
    else:
        if result:
            say(f"flown: {', '.join(names)}: {result['outcome']}")


def _land_if_flying(heli: Heli) -> None:
    """Land; a second Ctrl-C stops the motors, which closing the board does."""
    if heli.motors_may_run:
        say("landing; Ctrl-C stops the motors")
        heli.land()
        say("landed")


def _serve_log(log: Path, rig: str | None, host: str, http_port: int) -> None:
    """Serve the page of a log until Ctrl-C, drawn with the `rig` given or else with that of the log."""
    from heli_host.data.log.reader import read_log
    from heli_host.ui.page.replay import Replay
    from heli_host.ui.page.serve import serving

    read = read_log(log)
    name = rig or read.metadata.get("session", {}).get("rig") or None
    with contextlib.ExitStack() as stack:
        replay = Replay(read, _outline_of_log(name))
        stack.callback(replay.close)
        _say_addresses(stack.enter_context(serving(replay, host, http_port)))
        with contextlib.suppress(KeyboardInterrupt):
            replay.run()


def _outline_of_rig(rig: str | None, *, simulated_board: bool) -> dict[str, float]:
    """Return lengths and masses of the rig for the page; empty if the rig is unknown."""
    from heli_host.ui.page.source import outline

    if rig is None and not simulated_board:
        return {}
    return outline(rig if rig is not None else DEFAULT_RIG)


def _outline_of_log(rig: str | None) -> dict[str, float]:
    """Return the lengths with which the page draws a rig; empty without its file."""
    from heli_host.errors import HeliError
    from heli_host.ui.page.source import outline

    # The name of a rig that a log was flown with; its file may be elsewhere, or nowhere any more.
    with contextlib.suppress(HeliError):
        return outline(rig if rig is not None else DEFAULT_RIG)
    return {}


def _say_addresses(served: Address) -> None:
    """Print the addresses of the page, and a warning if other computers can reach it."""
    import sys

    if not served.is_local:
        print(
            "warning: everybody on the network who learns the address can fly this board; "
            "127.0.0.1 keeps it on this machine",
            file=sys.stderr,
        )
    say(f"page: {served.page}", f"programs join {served.program}", "Ctrl-C ends it")


VERB = Verb(dashboard, "Fly", aliases=("page",))
