"""``heli-host fly --again LOG``: repeat a simulated flight from its log, and compare the samples."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlencode, urlsplit

from heli_host.data.files import file_digest
from heli_host.errors import HeliError, LogError
from heli_host.ui.cli.flight_command import VERB_NAME, FlightOptions, FlownFlight, fly_plans
from heli_host.ui.cli.say import say

if TYPE_CHECKING:
    from heli_host.data.log.reader import Log
    from heli_host.fly.plan import Plan

_FLY = "fly a plan instead, such as: heli-host fly hover --sil"
_REPEATED = re.compile(r"(.+) \(\d+\)")
_FILE_NAME = re.compile(r"[\w.-]{1,60}")


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
    is_exact = options.get("speed", "max") == "max" and not options.pop("process", "")
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
    if record.get("flown_by") != VERB_NAME:
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
