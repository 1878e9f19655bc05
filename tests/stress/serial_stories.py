"""Random stories of serial trouble: what happens to a flight over a port, and what must be true then.

``python -m tests.stress.serial_stories --first 0 --count 1000`` lives through so many and prints a table. A
number is always the same story; the computer's own timing differs from run to run, and so may its course.
"""

import argparse
import contextlib
import json
import os
import random
import re
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.log.reader import read_log
from heli_host.errors import HeliError

from tests.stress.serial_board import (
    CHANGES_SETTINGS,
    COMPETES,
    CUT_WRITE,
    LAND_AFTER_TICKS,
    READ_FAILS,
    SLOW,
    TAKES_BYTES,
    WRITE_FAILS,
    WRITES,
    Host,
    PortTrouble,
    SecondProgram,
    SerialBoard,
    Truth,
    start_host,
)

SPEED: Final = 4.0
PLAN: Final = """
title = "Short"
[start]
settle_s = 1
[[segment]]
kind = "ramp"
travel_deg = 5
duration_s = 2
[[segment]]
kind = "hold"
duration_s = 2
"""
SUSPENDED, UNPLUGGED = "suspended", "unplugged"
PROGRAMS: Final = (TAKES_BYTES, WRITES, CHANGES_SETTINGS, COMPETES)
KINDS: Final = (
    *(SUSPENDED,) * 4, SLOW, SLOW, READ_FAILS, WRITE_FAILS, CUT_WRITE, CUT_WRITE, UNPLUGGED, *PROGRAMS,
)  # fmt: skip
# The whole flight takes 11 s of the board's time.
_LATEST_S: Final = 11.0
# docs/reference/failures.md, rounded to 0.1 s: setpoints that end. A turn of the server is 16 ms.
LANDED_AFTER_S: Final = 5.7 + 0.05 + 0.016
# The same, from the landing's beginning.
LANDING_S: Final = LANDED_AFTER_S - 2.0
# Arrival at the port and acceptance by the board differ by a turn and by the wire.
_UNSURE_TICKS: Final = 40
_PATIENCE_S: Final = 90.0
_LEFT_ALONE_S: Final = 8.0


@dataclass(frozen=True)
class Trouble:
    """Something that happens to the port or to its host, in seconds of the board."""

    kind: str
    at_s: float
    duration_s: float


@dataclass(frozen=True)
class Story:
    """A flight's troubles."""

    number: int
    troubles: tuple[Trouble, ...]

    def __str__(self) -> str:
        troubles = ", ".join(
            f"{trouble.kind} at {trouble.at_s:.2f} s for {trouble.duration_s:.2f} s"
            for trouble in self.troubles
        )
        return f"story {self.number} ({troubles})"


def story(number: int) -> Story:
    """One of the stories; the same number is always the same story."""
    chance = random.Random(number)
    troubles = []
    for _ in range(chance.choice((1, 1, 2, 3))):
        kind, at_s = chance.choice(KINDS), chance.uniform(0.0, _LATEST_S)
        # One suspension in eight is longer than any failsafe waits.
        longest_s = 20.0 if chance.random() < 0.125 else 3.0
        duration_s = 0.2 * (longest_s / 0.2) ** chance.random()
        troubles.append(Trouble(kind, round(at_s, 3), round(duration_s, 3)))
    return Story(number, tuple(sorted(troubles, key=lambda trouble: trouble.at_s)))


@dataclass
class Lived:
    """How a story went."""

    number: int
    code: int = -1
    outcome: str = ""
    landed_s: float = 0.0
    kinds: list[str] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)
    happened: str = ""


def live(which: Story, folder: Path, speed: float = SPEED) -> Lived:
    """Fly a story and compare what the host reports with the truth."""
    (folder / "short.toml").write_text(PLAN)
    board = SerialBoard(folder / "due", which.number, speed)
    try:
        return _live(which, folder, board, speed)
    finally:
        board.close()


class _Ending(NamedTuple):
    """When something outside of the host ends: a second program, or without one the host's suspension."""

    at_s: float
    program: SecondProgram | None


class _Outside:
    """What happens to host and cable from outside, at its time: suspensions, unplugging, second programs."""

    def __init__(self, troubles: Iterable[Trouble], host: Host, board: SerialBoard) -> None:
        self.programs: list[SecondProgram] = []
        self._to_come = [trouble for trouble in troubles if trouble.kind in (SUSPENDED, UNPLUGGED, *PROGRAMS)]
        self._endings: list[_Ending] = []
        self._host, self._board = host, board

    def turn(self) -> None:
        """Begin and end what is due."""
        now_s = self._board.time_s
        while self._to_come and self._to_come[0].at_s <= now_s:
            self._begin(self._to_come.pop(0))
        for ending in [ending for ending in self._endings if ending.at_s <= now_s]:
            self._endings.remove(ending)
            if ending.program is not None:
                ending.program.close()
            elif not any(other.program is None for other in self._endings):
                os.kill(self._host.pid, signal.SIGCONT)
        for program in self.programs:
            program.turn()

    def _begin(self, trouble: Trouble) -> None:
        end_s = self._board.time_s + trouble.duration_s
        if trouble.kind == SUSPENDED:
            os.kill(self._host.pid, signal.SIGSTOP)
            self._endings.append(_Ending(end_s, program=None))
        elif trouble.kind == UNPLUGGED:
            self._board.unplug(trouble.duration_s)
        else:
            self.programs.append(SecondProgram(trouble.kind, self._board))
            self._endings.append(_Ending(end_s, self.programs[-1]))


def _live(which: Story, folder: Path, board: SerialBoard, speed: float) -> Lived:
    in_the_host = [
        PortTrouble(trouble.kind, trouble.at_s / speed, (trouble.at_s + trouble.duration_s) / speed)
        for trouble in which.troubles
        if trouble.kind in (SLOW, READ_FAILS, WRITE_FAILS, CUT_WRITE)
    ]
    cuts_s = [trouble.duration_s for trouble in which.troubles if trouble.kind == CUT_WRITE]
    words = ["fly", "short.toml", "--port", "due", "--log", "a.mcap", "--json", "a.json"]
    host = start_host(words, folder, in_the_host)
    outside = _Outside(which.troubles, host, board)
    lived = Lived(which.number, kinds=[trouble.kind for trouble in which.troubles])
    give_up_s = time.monotonic() + _PATIENCE_S
    try:
        while (code := _ended(host)) is None:
            board.turn()
            # A write that is cut asks for the cable to be taken out, and waits for the answer.
            with contextlib.suppress(BlockingIOError):
                if os.read(host.asks, 1):
                    board.unplug(cuts_s.pop(0))
                    os.write(host.answers, b"x")
            outside.turn()
            if time.monotonic() > give_up_s:
                break
        else:
            lived.code = code
    finally:
        for program in outside.programs:
            program.close()
        _end(host, lived.code)
    if board.truth.last_on_tick >= board.world.tick - 50:
        board.alone(_LEFT_ALONE_S)
    _judge(which, lived, board, outside.programs, folder)
    return lived


def _ended(host: Host) -> int | None:
    pid, status = os.waitpid(host.pid, os.WNOHANG)
    return os.waitstatus_to_exitcode(status) if pid else None


def _end(host: Host, code: int) -> None:
    if code < 0:
        with contextlib.suppress(ProcessLookupError, ChildProcessError):
            os.kill(host.pid, signal.SIGKILL)
            os.waitpid(host.pid, 0)
    os.close(host.asks)
    os.close(host.answers)


def _judge(which: Story, lived: Lived, board: SerialBoard, second: list[SecondProgram], folder: Path) -> None:
    complain = lived.complaints.append
    errors = (folder / "stderr").read_text(errors="replace").strip()
    summary = _summary(folder)
    lived.outcome = str(summary["outcome"]) if summary else errors.splitlines()[-1] if errors else ""
    truth = board.truth
    lived.happened = _happened(board)
    if lived.code not in (0, 3, 4):
        complain(f"exit code {lived.code}: {errors[-300:]}" if lived.code >= 0 else "the host does not end")
    if "Traceback" in errors or "unexpected" in errors or "report it" in errors:
        complain(f"an error of the program: {errors[-300:]}")
    if untrue := _untrue(which, lived, board):
        complain(f"untrue: {lived.outcome!r}; {untrue}; {lived.happened}")
    if late := late_text(truth, board.world.tick):
        complain(late)
    lived.landed_s = 1e-3 * (truth.last_on_tick - truth.fresh_tick) if _landed_itself(truth) else 0.0
    if summary:
        lived.complaints += _wrong_log(folder / "a.mcap", board, summary)
    broken = any(
        trouble.kind not in PROGRAMS and trouble.kind not in (SUSPENDED, SLOW) for trouble in which.troubles
    )
    for program in second:
        refused = "in use by another program" in program.reply
        # Before the host has opened the port, and after its end, it is free.
        free = program.reply == "opened" and not program.in_flight
        if program.reply and not (refused or free or broken):
            complain(f"a second heli-host got the reply {program.reply!r}")


def _summary(folder: Path) -> dict[str, Any]:
    try:
        content: dict[str, Any] = json.loads((folder / "a.json").read_text())
    except (OSError, ValueError):
        return {}
    return content


def _landed_itself(truth: Truth) -> bool:
    return truth.longest_ticks > LAND_AFTER_TICKS


def _happened(board: SerialBoard) -> str:
    truth = board.truth
    fault = board.heard.fault()
    parts = [
        f"closed at {1e-3 * truth.closed_tick:.2f} s" if truth.closed_tick >= 0 else "never closed",
        f"longest gap {1e-3 * truth.longest_ticks:.2f} s",
        f"land at {1e-3 * truth.land_tick:.2f} s" if truth.land_tick >= 0 else "no request to land",
        f"off at {1e-3 * truth.last_on_tick:.2f} s" if truth.last_on_tick >= 0 else "never on",
        f"fault {fault.name.lower()}" if fault else "no fault",
    ]
    return ", ".join(parts)


_BREAKS: Final = (READ_FAILS, WRITE_FAILS, CUT_WRITE, UNPLUGGED, *PROGRAMS)


def _untrue(which: Story, lived: Lived, board: SerialBoard) -> str:
    """Why the reported reason is untrue, empty if it is true."""
    truth, outcome = board.truth, lived.outcome
    kinds = set(lived.kinds)
    fault = board.heard.fault()
    landed_itself = _landed_itself(truth)
    must_have_landed = truth.longest_ticks > LAND_AFTER_TICKS + _UNSURE_TICKS
    may_have_landed = truth.longest_ticks > LAND_AFTER_TICKS - _UNSURE_TICKS
    if fault:
        return "" if f"fault {fault.name.lower()}" in outcome else f"true is fault {fault.name.lower()}"
    if "fault " in outcome:
        return "the board had no fault"
    if "because of touchdown" in outcome or "arm first" in outcome:
        return "that follows from what ended the flight"
    if "restarted" in outcome:
        return "the board did not restart"
    if "stale_land" in outcome:
        return "" if may_have_landed else "setpoints came all the time"
    if outcome == "completed":
        if truth.closed_tick < 0 or truth.land_tick < 0:
            return "nothing was flown to its end"
        return "the board landed by itself" if must_have_landed else ""
    if "while landing: the board did not answer" in outcome:
        # Whether the board answered is not seen here; its answers may have been taken away.
        answers_lost = kinds & {TAKES_BYTES, CHANGES_SETTINGS}
        return "the board heard it" if truth.land_tick >= 0 and not answers_lost else ""
    if truth.closed_tick >= 0 and landed_itself and "link lost" not in outcome and "lost" not in outcome:
        return "the board landed by itself"
    if "lost" in outcome and "setpoint" not in outcome:
        return "" if kinds & set(_BREAKS) else "nothing touched the port"
    if outcome.startswith("not_tracked"):
        return "" if kinds else "nothing happened"
    if outcome.startswith("error:") and truth.closed_tick < 0:
        return "" if kinds else "nothing happened"
    return (
        "" if re.search("no answer|did not answer|not answered|in use|state", outcome) else "no rule knows it"
    )


def late_text(truth: Truth, tick: int) -> str:
    """What is said of motors that ran too long; empty where they did not."""
    if truth.last_on_tick < 0:
        return ""
    if truth.last_on_tick >= tick - 10:
        return f"the motors still run after {1e-3 * tick:.1f} s"
    if truth.closed_tick < 0:
        return ""
    off_s = 1e-3 * (truth.last_on_tick - truth.fresh_tick)
    if _landed_itself(truth):
        return f"motors off {off_s:.2f} s after the newest setpoint" if off_s > LANDED_AFTER_S else ""
    if truth.land_tick >= 0:
        off_s = 1e-3 * (truth.last_on_tick - truth.land_tick)
        return f"motors off {off_s:.2f} s after the request to land" if off_s > LANDING_S else ""
    return f"motors off {off_s:.2f} s after the newest setpoint" if off_s > LANDED_AFTER_S else ""


def _wrong_log(path: Path, board: SerialBoard, summary: dict[str, Any]) -> list[str]:
    """What is wrong with the log's samples."""
    try:
        log = read_log(path)
    except HeliError as error:
        return [f"the log cannot be read: {error}"]
    mistakes = []
    tick = log.ticks["tick"].astype(np.int64)
    known = board.heard.rows
    invented = [t for t, raw in zip(tick.tolist(), log.raw, strict=True) if (t, raw.tobytes()) not in known]
    if invented:
        mistakes.append(f"{len(invented)} wrong samples, the first at tick {invented[0]}")
    gaps = int((np.diff(tick) - 1).sum())
    if (np.diff(tick) <= 0).any():
        mistakes.append("ticks go backwards")
    elif summary["ticks_lost"] != gaps:
        mistakes.append(f"{gaps} samples are missing, {summary['ticks_lost']} counted")
    if not log.complete:
        mistakes.append("the log is not complete")
    return mistakes


def preload() -> None:
    """Import what flies, so that forked hosts need not."""
    from heli_host.ui.cli.entry import command_line

    command_line()


def table(every: list[Lived]) -> list[str]:
    """Return lines about stories: by the kind of trouble, and by what the hosts reported."""
    lines = ["| trouble in a story | stories | untrue or damaged |", "|---|---|---|"]
    for kind in dict.fromkeys(KINDS):
        with_it = [lived for lived in every if kind in lived.kinds]
        lines.append(f"| {kind} | {len(with_it)} | {sum(bool(lived.complaints) for lived in with_it)} |")
    lines += ["", "| the host reports | stories |", "|---|---|"]
    outcomes = Counter(re.sub(r"[-0-9.]+", "N", lived.outcome)[:110] for lived in every)
    lines += [f"| {outcome} | {count} |" for outcome, count in outcomes.most_common(40)]
    worst_s = max((lived.landed_s for lived in every), default=0.0)
    lines += [
        "",
        f"motors off at most {worst_s:.2f} s after the newest setpoint, where the board landed by itself",
    ]
    return lines


def main(words: list[str] | None = None) -> int:
    """Live through stories; 1 if a reason was untrue, motors ran too long, or data was wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.stress.serial_stories", description=__doc__)
    parser.add_argument("--first", type=int, default=0, help="number of the first story [default: 0]")
    parser.add_argument("--count", type=int, default=1000, help="how many [default: 1000]")
    parser.add_argument(
        "--speed", type=float, default=SPEED, help="simulated seconds per second [default: 4]"
    )
    parser.add_argument("--keep", type=Path, help="folder for the files of stories with complaints")
    parser.add_argument("--lines", type=Path, help="file for one line of JSON per story")
    options = parser.parse_args(words)
    preload()
    every = []
    for number in range(options.first, options.first + options.count):
        which = story(number)
        with tempfile.TemporaryDirectory(prefix="heli-story-") as name:
            lived = live(which, Path(name), options.speed)
            if lived.complaints and options.keep is not None:
                shutil.copytree(name, options.keep / str(number), symlinks=True, dirs_exist_ok=True)
        every.append(lived)
        for complaint in lived.complaints:
            print(f"{which}: {complaint}", flush=True)
        if options.lines is not None:
            with options.lines.open("a") as file:
                file.write(json.dumps(asdict(lived)) + "\n")
    print("\n".join(table(every)))
    bad = sum(bool(lived.complaints) for lived in every)
    print(f"{len(every)} stories from number {options.first} on, {bad} with complaints")
    return int(bad > 0)


if __name__ == "__main__":
    raise SystemExit(main())
