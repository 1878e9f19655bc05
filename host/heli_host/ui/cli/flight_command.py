"""A flight of plans from the options of the command line, for `fly` and for verbs that fly a control law."""

from __future__ import annotations

import json as json_text
import secrets
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import typer

from heli_host.ui.cli import simulated
from heli_host.ui.cli.gains import GainsOption, ParamsFileOption, check_gains, chosen_parameters
from heli_host.ui.cli.options import (
    ClearFaultOption,
    FigureOption,
    FoxgloveOption,
    JsonOption,
    LogOption,
    PortOption,
    flight_folder,
)
from heli_host.ui.cli.say import data_on_stdout, say, say_files, say_progress, write_result
from heli_host.ui.cli.twin_options import OnAlarmOption, TwinOption, lands_on_alarm, open_watch, read_twin

if TYPE_CHECKING:
    from heli_host.data.log.summary import FlightSummary
    from heli_host.fly.heli import Heli
    from heli_host.fly.plan import Plan
    from heli_host.fly.runner import Progress

DEFAULT_SEED: Final = 1
VERB_NAME: Final = "heli-host fly"
"""Value of ``flown_by`` in the log of a flight whose commands ``--again`` can repeat."""


@dataclass(frozen=True)
class FlightOptions:
    """Options of a verb that flies, as typed; see ``heli-host fly --help``. A group for
    `with_option_groups`.
    """

    port: PortOption = None  # port, sil: The board: ``--port`` or ``HELI_PORT``, or ``--sil``
    sil: simulated.SilOption = False
    board: simulated.BoardOption = None
    """board, elf, rig, model, effect, effect_file, speed, seed: The simulation. A `rig` also names the rig of
    a real board."""
    elf: simulated.ElfOption = None
    rig: simulated.RigOption = None
    model: simulated.ModelOption = None
    effect: simulated.EffectOption = None
    effect_file: simulated.EffectFilesOption = None
    speed: simulated.SpeedOption = "1"
    seed: simulated.FlightSeedOption = None
    blind: simulated.BlindOption = False  # Whether files hide what flew
    clear_fault: ClearFaultOption = False  # Whether a latched fault is cleared first
    gains: GainsOption = None  # gains, params: Parameters to fly with
    params: ParamsFileOption = None
    twin: TwinOption = None  # twin, on_alarm: Twin that flies along, and what its alarm does
    on_alarm: OnAlarmOption = None
    foxglove: FoxgloveOption = None  # TCP port on this computer for live viewers
    log: LogOption = None  # log, json, figure: Files to write
    json: JsonOption = None
    figure: FigureOption = None
    parameters: Mapping[str, float] | None = None
    """Parameters to fly with, instead of a file's; not an option."""
    simulation: str = ""
    """Address of the simulated board, instead of one from the other options; not an option."""

    def address(self) -> str | None:
        """Return the address of the simulated board, None for a real one."""
        from heli_host.ui.cli.board import check_target

        if self.simulation:
            return self.simulation
        simulated.parse_speed(self.speed)
        if not self.sil:
            simulated.refuse_without_sil(
                board=self.board,
                elf=self.elf,
                model=self.model,
                effect=self.effect,
                effect_file=self.effect_file,
                blind=self.blind,
            )
        check_target(self.port, self.sil)
        if not self.sil:
            return None
        return simulated.sil_address(
            rig=self.rig,
            speed=self.speed,
            seed=DEFAULT_SEED if self.seed is None else self.seed,
            board=self.board,
            elf=self.elf,
            model=self.model,
            effect=self.effect,
            effect_files=self.effect_file,
        )


@dataclass(frozen=True)
class FlownFlight:
    """A flight that was flown."""

    summary: FlightSummary  # Outcome, tracking errors and losses
    log: Path  # The file with every tick
    lines: tuple[str, ...]  # Lines about it for the user
    json: Path | None  # The file for the summary, which `write` writes
    figure: Path | None  # The picture of angles and voltages; None if the user wants none

    def write(self, **more: object) -> None:
        """Write the summary as JSON, with `more` results in it."""
        write_result(self.json, {**self.summary.as_dict(), **more})

    def report(self) -> None:
        """Print the lines and the names of the files."""
        say(*self.lines)
        say_files([self.log, self.json, self.figure])

    def end(self) -> None:
        """Raise FlightAborted after a flight that was not completed."""
        from heli_host.errors import FlightAborted

        if not self.summary.completed:
            # A fault's text says what to do already.
            explained = ";" in self.summary.outcome
            events = f"look at its events: heli-host info {self.log} --events"
            raise FlightAborted(self.summary.outcome, "" if explained else events)


def fly_plans(
    options: FlightOptions,
    plans: Sequence[Plan],
    *,
    plan_names: Sequence[str] = (),
    on_taken_off: Callable[[Heli], object] | None = None,
) -> FlownFlight:
    """Fly plans on the board that the options name; write log and figure. The caller writes the summary."""
    from heli_host.board.parameters import load_gains
    from heli_host.data.log.blind import Truth, truth_path
    from heli_host.data.log.disk import check_new
    from heli_host.fly.runner import fly
    from heli_host.link.transport import transport_label, transport_note, transport_rig
    from heli_host.ui.cli.board import board_text, check_board_rig, clear_latched_fault, open_board
    from heli_host.ui.cli.outputs import check_result_places
    from heli_host.ui.cli.progress import LiveLine
    from heli_host.ui.cli.report import summary_lines
    from heli_host.ui.foxglove_feed import foxglove_feed

    land_on_alarm = lands_on_alarm(options.twin, options.on_alarm)
    if options.blind and options.twin is not None:
        raise typer.BadParameter("--twin names what has changed; leave it out, or leave out --blind")
    if options.seed is None:
        # A known seed lets a reader fly the same flight with each effect, and compare byte by byte.
        options = replace(options, seed=secrets.randbelow(1 << 31) if options.blind else DEFAULT_SEED)
    address = options.address()
    check_gains(options.gains, options.sil)
    parameters = (
        chosen_parameters(options.params, options.gains) if options.parameters is None else options.parameters
    )
    log, json, figure = options.log, options.json, options.figure
    check_result_places(json, figure=figure)
    data_on_stdout(json)
    if log is not None:
        check_new(log)
    truth = None
    if options.blind and address is not None:
        truth = Truth.seal(
            simulated.flown(
                address,
                rig=options.rig,
                model=options.model,
                effect=options.effect,
                effect_files=options.effect_file,
                seed=options.seed or 0,
                plans=plan_names,
            )
        )
    maker = read_twin(options.twin)
    with (
        open_board(options.port, address) as heli,
        foxglove_feed(heli, options.foxglove, hidden=options.blind) as feed,
    ):
        if feed is not None:
            say_progress(f"viewers: {feed.address}")
        if options.clear_fault:
            clear_latched_fault(heli)
        load_gains(heli.params, options.gains)
        if parameters:
            heli.params.restore(parameters)
        check_board_rig(heli, options.rig)
        everything = log is None and json is None and figure is None
        folder = flight_folder() if log is None else log.parent
        log = log if log is not None else folder / "flight.mcap"
        json, figure = (folder / "summary.json", folder / "figure.png") if everything else (json, figure)
        text, transport = board_text(heli, hidden=options.blind), heli.session.transport
        key = truth_path(log)
        if truth is not None:
            truth.write(key)
        if note := transport_note(transport):
            say_progress(note)
        say_progress(text, f"flying: {', then '.join(plan.title for plan in plans)}")
        watch = open_watch(heli, maker)
        with LiveLine() as live:

            def show(progress: Progress) -> None:
                """Show the progress of the flight in the live line."""
                live.show(
                    progress.sample,
                    progress.counters,
                    t_s=progress.t_s,
                    phase=progress.phase,
                    left_s=progress.left_s,
                )

            summary = fly(
                heli,
                plans,
                log_path=log,
                figure_path=figure,
                on_progress=show,
                rig_name="" if options.blind else simulated.rig_name(options.rig, simulated=options.sil),
                rig=options.rig or transport_rig(transport),
                board_name=transport_label(transport).partition(",")[0].removesuffix(" board"),
                twin=watch,
                land_on_change=land_on_alarm,
                sealed=truth.digest if truth is not None else "",
                setup=_setup_record(options, parameters, plans) if on_taken_off is None else {},
                on_taken_off=(lambda: on_taken_off(heli)) if on_taken_off is not None else None,
            )
    lines = [*summary_lines(summary), f"board: {text}"]
    if watch is not None:
        lines.append(f"twin: {watch.words()}")
    if truth is not None:
        lines += [f"sealed: {truth.digest}", f"truth (keep it, share only the other files): {key}"]
    return FlownFlight(summary, log, tuple(lines), json, figure)


def _setup_record(
    options: FlightOptions, parameters: Mapping[str, float], plans: Sequence[Plan]
) -> dict[str, str]:
    """Return what was set on the board before the flight, for `heli_host.ui.cli.again`."""
    from heli_host.fly.recorder import plan_texts

    return {
        "flown_by": VERB_NAME,
        "plans": json_text.dumps(list(plan_texts(plans))),
        "gains": options.gains or "",
        "parameters": json_text.dumps(dict(parameters)),
        "clear_fault": "1" if options.clear_fault else "0",
        "lands_on_alarm": "1" if lands_on_alarm(options.twin, options.on_alarm) else "0",
    }
