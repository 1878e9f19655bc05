"""A flight of plans from the options of the command line, and its repetition from a log (``--again``)."""

from __future__ import annotations

import json
import re
import secrets
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple
from urllib.parse import parse_qsl, urlencode, urlsplit

import typer

from heli_host.data.files import file_digest
from heli_host.errors import HeliError, LogError
from heli_host.ui.cli.board import board_text, check_board_rig, check_target, clear_latched_fault, open_board
from heli_host.ui.cli.options import (
    DEFAULT_RIG,
    BlindOption,
    BoardOption,
    ClearFaultOption,
    EffectFilesOption,
    EffectOption,
    ElfOption,
    FigureOption,
    FlightSeedOption,
    FoxgloveOption,
    GainsOption,
    JsonOption,
    LogOption,
    ModelOption,
    OnAlarmOption,
    ParamsFileOption,
    PortOption,
    RigOption,
    SilOption,
    SpeedOption,
    TwinOption,
    check_gains,
    check_result_places,
    check_speed,
    chosen_parameters,
    flight_folder,
    lands_on_alarm,
    open_watch,
    read_twin,
    refuse_without_sil,
    rig_name,
    sil_address,
)
from heli_host.ui.cli.say import data_on_stdout, say, say_files, say_progress, summary_lines, write_result

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.data.log.reader import Log
    from heli_host.data.log.summary import FlightSummary
    from heli_host.fly.plan import Plan
    from heli_host.fly.runner import Progress
    from heli_host.ui.cli.live import LiveLine

_DEFAULT_SEED: Final = 1
_VERB_NAME: Final = "heli-host fly"
"""Value of ``flown_by`` in the log of a flight whose commands ``--again`` can repeat."""

_FLY = "fly a plan instead, such as: heli-host fly hover --sil"
_REPEATED = re.compile(r"(.+) \(\d+\)")
_FILE_NAME = re.compile(r"[\w.-]{1,60}")


@dataclass(frozen=True)
class FlightOptions:
    """Options of a verb that flies, as typed; a group for `with_option_groups`."""

    port: PortOption = None
    sil: SilOption = False
    board: BoardOption = None
    elf: ElfOption = None
    rig: RigOption = None
    model: ModelOption = None
    effect: EffectOption = None
    effect_file: EffectFilesOption = None
    speed: SpeedOption = "1"
    seed: FlightSeedOption = None
    blind: BlindOption = False
    clear_fault: ClearFaultOption = False
    gains: GainsOption = None
    params: ParamsFileOption = None
    twin: TwinOption = None
    on_alarm: OnAlarmOption = None
    foxglove: FoxgloveOption = None
    log: LogOption = None
    json: JsonOption = None
    figure: FigureOption = None
    parameters: Mapping[str, float] | None = None
    """Parameters to fly with, instead of a file's; not an option."""
    simulation: str = ""
    """Address of the simulated board, instead of one from the other options; not an option."""

    def address(self) -> str | None:
        """Return the address of the simulated board, None for a real one."""
        if self.simulation:
            return self.simulation
        self._check_board_options()
        if not self.sil:
            return None
        return sil_address(
            rig=self.rig,
            speed=self.speed,
            seed=_DEFAULT_SEED if self.seed is None else self.seed,
            board=self.board,
            elf=self.elf,
            model=self.model,
            effect=self.effect,
            effect_files=self.effect_file,
        )

    def _check_board_options(self) -> None:
        """Refuse an invalid speed, options that contradict each other, and options that name no board."""
        check_speed(self.speed)
        if not self.sil:
            refuse_without_sil(
                board=self.board,
                elf=self.elf,
                model=self.model,
                effect=self.effect,
                effect_file=self.effect_file,
                blind=self.blind,
            )
        check_target(self.port, self.sil)

    def parameters_to_set(self) -> Mapping[str, float]:
        """Return the parameters to fly with: the given ones, or those of the file."""
        return chosen_parameters(self.params, self.gains) if self.parameters is None else self.parameters

    def with_seed(self) -> FlightOptions:
        """Return options that name a seed: a random one for a blind flight."""
        # Otherwise a known seed lets a reader fly the same flight with each effect, and compare byte by byte.
        if self.seed is not None:
            return self
        return replace(self, seed=secrets.randbelow(1 << 31) if self.blind else _DEFAULT_SEED)

    def simulation_settings(self, address: str, plans: Sequence[str]) -> dict[str, object]:
        """Return all settings of a simulated flight, for the truth file of a blind flight."""
        files = [*([Path(self.rig)] if self.rig is not None else []), *(self.effect_file or ())]
        return {
            "rig": self.rig if self.rig is not None else DEFAULT_RIG,
            "model": self.model or "",
            "effects": list(self.effect or ()),
            "seed": self.seed or 0,
            "plans": list(plans),
            "address": address,
            "files": {
                str(file): file.read_text(encoding="utf-8", errors="replace")
                for file in files
                if file.is_file()
            },
        }


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

    def raise_if_not_completed(self) -> None:
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
    from heli_host.data.log.blind import Truth, truth_path
    from heli_host.fly.runner import fly
    from heli_host.link.transport import transport_board_name, transport_note, transport_rig
    from heli_host.ui.cli.live import LiveLine
    from heli_host.ui.foxglove_feed import foxglove_feed

    land_on_alarm = lands_on_alarm(options.twin, options.on_alarm)
    if options.blind and options.twin is not None:
        raise typer.BadParameter("--twin names what has changed; leave it out, or leave out --blind")
    options = options.with_seed()
    address = options.address()  # None for a physical board
    check_gains(options.gains, options.sil)
    parameters = options.parameters_to_set()
    _check_result_files(options)
    truth = None
    if options.blind and address is not None:
        truth = Truth.seal(options.simulation_settings(address, plan_names))
    twin_maker = read_twin(options.twin)
    with (
        open_board(options.port, address) as heli,
        foxglove_feed(heli, options.foxglove, hidden=options.blind) as feed,
    ):
        if feed is not None:
            say_progress(f"viewers: {feed.address}")
        _set_up_board(heli, options, parameters)
        files = _result_files(options)
        board_line, transport = board_text(heli, hidden=options.blind), heli.session.transport
        truth_file = truth_path(files.log)
        if truth is not None:
            truth.write(truth_file)
        if note := transport_note(transport):
            say_progress(note)
        say_progress(board_line, f"flying: {', then '.join(plan.title for plan in plans)}")
        watch = open_watch(heli, twin_maker)
        with LiveLine() as live:
            summary = fly(
                heli,
                plans,
                log_path=files.log,
                figure_path=files.figure,
                on_progress=partial(_show_progress, live),
                # `rig_name` is only written to the log; the finished flight is checked against `rig`.
                rig_name="" if options.blind else rig_name(options.rig, simulated=options.sil),
                rig=options.rig or transport_rig(transport),
                board_name=transport_board_name(transport),
                twin=watch,
                land_on_change=land_on_alarm,
                seal_digest=truth.digest if truth is not None else "",
                # A call after the take-off is not in the log, so that such a flight cannot be repeated.
                setup=_setup_record(options, parameters, plans) if on_taken_off is None else {},
                on_taken_off=(lambda: on_taken_off(heli)) if on_taken_off is not None else None,
            )
    lines = [*summary_lines(summary), f"board: {board_line}"]
    if watch is not None:
        lines.append(f"twin: {watch.words()}")
    if truth is not None:
        lines += [f"sealed: {truth.digest}", f"truth (keep it, share only the other files): {truth_file}"]
    return FlownFlight(summary, files.log, tuple(lines), files.json, files.figure)


def _check_result_files(options: FlightOptions) -> None:
    """Refuse files of results that cannot be written, and keep standard output for JSON if it goes there."""
    from heli_host.data.log.disk import check_new

    check_result_places(options.json, figure=options.figure)
    data_on_stdout(options.json)
    if options.log is not None:
        check_new(options.log)


class _ResultFiles(NamedTuple):
    """Where the results of a flight go; None: that result is not written."""

    log: Path
    json: Path | None
    figure: Path | None


def _result_files(options: FlightOptions) -> _ResultFiles:
    """Return the files that the options name; if they name none, all three in a new folder."""
    if options.log is None and options.json is None and options.figure is None:
        folder = flight_folder()
        return _ResultFiles(folder / "flight.mcap", folder / "summary.json", folder / "figure.png")
    log = options.log if options.log is not None else flight_folder() / "flight.mcap"
    return _ResultFiles(log, options.json, options.figure)


def _show_progress(live: LiveLine, progress: Progress) -> None:
    """Show the progress of the flight in the live line."""
    live.show(
        progress.sample, progress.counters, t_s=progress.t_s, phase=progress.phase, left_s=progress.left_s
    )


def _set_up_board(heli: Heli, options: FlightOptions, parameters: Mapping[str, float]) -> None:
    """Bring the board into the state in which the flight begins, and compare it with the rig."""
    from heli_host.board.parameters import load_gains

    if options.clear_fault:
        clear_latched_fault(heli)
    load_gains(heli.params, options.gains)
    if parameters:
        heli.params.restore(parameters)
    check_board_rig(heli, options.rig, blind=bool(options.blind))


def _setup_record(
    options: FlightOptions, parameters: Mapping[str, float], plans: Sequence[Plan]
) -> dict[str, str]:
    """Return what was set on the board before the flight, for `heli_host.ui.cli.flight`."""
    from heli_host.fly.recorder import plan_texts

    return {
        "flown_by": _VERB_NAME,
        "plans": json.dumps(list(plan_texts(plans))),
        "gains": options.gains or "",
        "parameters": json.dumps(dict(parameters)),
        "clear_fault": "1" if options.clear_fault else "0",
        "lands_on_alarm": "1" if lands_on_alarm(options.twin, options.on_alarm) else "0",
    }


@dataclass(frozen=True)
class Repeat:
    """A simulated flight that its log describes completely."""

    options: Mapping[str, str]  # Options of its ``sil://`` address
    rig_name: str  # rig_name, rig: Name of the rig, and its file as text
    rig: str
    plans: tuple[Plan, ...]  # Plans in the order of the flight
    gains: str | None  # Published gains that were set before it
    parameters: Mapping[str, float]  # Other parameters that were set before it
    clear_fault: bool  # Whether a latched fault was cleared first
    firmware: str  # Digest of the firmware of an emulated Due; empty for the native board
    is_exact: bool
    """Whether the flight ran in lockstep. Otherwise the computer's timing decided when commands arrived."""


def read_repeat(log: Log, effect_files: Mapping[str, Path]) -> Repeat:
    """Read from a log what repeats its flight."""
    record = log.metadata.get("simulation", {})
    _check_repeatable(log, record)
    try:
        options = dict(parse_qsl(urlsplit(record["address"]).query))
        stored_effect_files = _json_of_record(record, "effect_files")
        parameters = {name: float(value) for name, value in _json_of_record(record, "parameters").items()}
        plans = tuple(_plans_as_started(log, record))
        rig_name = record["rig_name"]
        rig = record["rig"]
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise LogError(f"{log.path} describes its simulation incompletely: {error}", _FLY) from error
    for file, digest in stored_effect_files.items():
        if digest not in effect_files:
            raise LogError(
                f"{log.path} was flown with the effect file {Path(file).name} (SHA-256 {digest[:12]}), and a "
                "log does not contain such files",
                f"add --effect-file {Path(file).name}",
            )
    options["effects"] = ";".join(
        str(effect_files[digest].absolute()) for digest in stored_effect_files.values()
    )
    # A process of its own has real time; the repetition runs in lockstep, in this process.
    had_process = bool(options.pop("process", ""))
    is_exact = options.get("speed", "max") == "max" and not had_process
    return Repeat(
        options=options,
        rig_name=rig_name if _FILE_NAME.fullmatch(rig_name) else "rig",
        rig=rig,
        plans=plans,
        gains=record.get("gains") or None,
        parameters=parameters,
        clear_fault=record.get("clear_fault") == "1",
        firmware=record.get("firmware", ""),
        is_exact=is_exact,
    )


def _check_repeatable(log: Log, record: Mapping[str, str]) -> None:
    """Raise a LogError if a log lacks something that a repetition needs; the message names it."""
    from heli_host.data.log.blind import SEALED

    session = log.metadata.get("session", {})
    if session.get(SEALED):
        raise LogError(f"{log.path} is a blind flight, so it does not contain rig, effects and seed", _FLY)
    if not record:
        is_simulated = session.get("url", "").startswith("sil:") or session.get("board") == "native"
        if is_simulated:
            raise LogError(
                f"{log.path} lacks rig, effects and seed, because an older heli-host wrote it", _FLY
            )
        raise LogError(f"{log.path} is a flight of a real board; --again repeats simulations only", _FLY)
    if record.get("flown_by") != _VERB_NAME:
        raise LogError(
            f"{log.path} lacks the commands before the flight, because another command than heli-host fly "
            "wrote it",
            "repeat the flight with that command",
        )
    if record.get("lands_on_alarm") == "1":
        raise LogError(
            f"{log.path} lacks the twin whose alarm could land the rig",
            "fly the plan again with --twin and --on-alarm",
        )
    if record.get("flash"):
        raise LogError(f"{log.path} lacks the flash memory {record['flash']} of its board", _FLY)


def _json_of_record(record: Mapping[str, str], name: str) -> dict[str, Any]:
    """Return a mapping that the record has as JSON under a name."""
    content = json.loads(record[name])
    if not isinstance(content, dict):
        raise ValueError(f"{name} is not a table")
    return content


def _plans_as_started(log: Log, record: Mapping[str, str]) -> Iterator[Plan]:
    """Yield the plans of a flight in the order in which they were flown."""
    from heli_host.fly.plan import Plan

    texts = log.metadata["plan"]
    for key in json.loads(record["plans"]):
        repeated = _REPEATED.fullmatch(key)
        # A plan that was flown twice has a number behind its name.
        name = repeated[1] if repeated is not None and repeated[1] in texts else key
        yield Plan.parse(texts[key], name)


def fly_again(path: Path, options: FlightOptions) -> FlownFlight:
    """Repeat the simulated flight of a log, print whether its samples are the same, and return it."""
    from heli_host.data.log.reader import read_log

    log = read_log(path)
    files = {file_digest(file): file for file in options.effect_file or ()}
    repeat = read_repeat(log, files)
    with tempfile.TemporaryDirectory(prefix="heli-again-") as folder:
        rig = Path(folder) / f"{repeat.rig_name}.toml"
        rig.write_text(repeat.rig, encoding="utf-8")
        address_options = {**repeat.options, "rig": str(rig), "speed": "max"}
        address = "sil://?" + urlencode({key: value for key, value in address_options.items() if value})
        flown = fly_plans(
            replace(
                options,
                sil=True,
                rig=str(rig),
                effect_file=None,
                gains=repeat.gains,
                parameters=repeat.parameters,
                clear_fault=repeat.clear_fault,
                simulation=address,
            ),
            repeat.plans,
        )
    return replace(flown, lines=(*flown.lines, _comparison_sentence(log, read_log(flown.log), repeat)))


def _comparison_sentence(before: Log, after: Log, repeat: Repeat) -> str:
    """Return a line that states whether the samples are the same; raise if they differ without a reason."""
    import numpy as np

    count = min(len(before.ticks), len(after.ticks))
    is_same = (before.ticks["tick"][:count] == after.ticks["tick"][:count]) & np.all(
        before.raw[:count] == after.raw[:count], axis=1
    )
    if len(before.ticks) == len(after.ticks) and is_same.all():
        return f"again: all {count} samples are the same"
    first_difference = count if is_same.all() else int(np.argmin(is_same))
    from_s = float((before if first_difference < len(before.ticks) else after).ticks["t_s"][first_difference])
    difference = f"the samples differ from {from_s:.3f} s on"
    if not repeat.is_exact:
        return f"again: {difference}; the first flight ran in real time, where the computer's timing counts"
    if not before.complete or before.metadata.get("result", {}).get("outcome", "").startswith("aborted"):
        return f"again: {difference}, because the first flight was ended from outside"
    say(f"log: {after.path}")
    remedy = "use the version of heli-host that wrote the log"
    raise HeliError(f"{difference} ({_first_difference(before, after)})", remedy)


def _first_difference(before: Log, after: Log) -> str:
    """Return the first difference of two logs that may explain different samples."""
    for record, name in (("session", "link_hash"), ("simulation", "firmware"), ("session", "host")):
        values = [log.metadata.get(record, {}).get(name, "") for log in (before, after)]
        if values[0] != values[1]:
            return f"{name} is {values[0] or 'none'} in the log and {values[1] or 'none'} now"
    changed = [name for name, value in before.parameters.items() if after.parameters.get(name) != value]
    return f"parameters: {', '.join(changed[:5])}" if changed else "other flight code or simulation"
