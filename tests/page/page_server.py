"""A page's server over a simulated board, or over a source without one, and a page without a browser."""

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import heli_host
from heli_host.board.heli import Heli
from heli_host.board.law_program import LawProgram
from heli_host.fly.plan import Plan, load_plan, plan_names
from heli_host.fly.recorder import Recorder
from heli_host.ui.page.cockpit import Cockpit
from heli_host.ui.page.guard import MESSAGES_PER_S, RateLimit
from heli_host.ui.page.serve import Address, serving
from heli_host.ui.page.source import Action, BoardState, CommandQueue, News, Role, outline
from heli_host.ui.page.telemetry import Rows, TelemetryBuffer, unpack
from heli_lab.law import Command, Law, control_law, if_else, motor_volts, saturated
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from tests.sil.harness import SOON_HOLDING

RIG = "makki2024"
SHORT_PLAN = """
title = "Hover for two seconds"
[start]
elevation_deg = 0
rate_deg_s = 15
settle_s = 1
[[segment]]
kind = "hold"
duration_s = 2
"""
PATIENCE_S = 60.0
STATES = {"integral_V": 0.0, "flown_s": 0.0}


@dataclass(frozen=True)
class Served:
    """A running server: its client, its address and the folder of its logs."""

    heli: Heli
    address: Address
    folder: Path

    def logs(self) -> list[Path]:
        return sorted(self.folder.glob("*.mcap"))


@contextlib.contextmanager
def page_of_a_simulated_board(
    folder: Path, speed: float = 1.0, board: str = "native", laws: Sequence[LawProgram] = ()
) -> Iterator[Served]:
    """Serve a page in this process."""
    short = Plan.parse(SHORT_PLAN, "short")
    url = f"sil://?rig={RIG}&seed=1&speed={speed}&process=1&board={board}"
    with heli_host.connect(url) as heli:

        def new_recorder(plans: Sequence[Plan], duration_s: float) -> Recorder:
            path = folder / f"{len(list(folder.glob('*.mcap')))}.mcap"
            return Recorder(heli, path, rig_name=RIG, plans=plans, duration_s=duration_s)

        plans = [short, *(load_plan(name) for name in plan_names())]
        rig = outline(RIG)
        cockpit = Cockpit(
            heli, new_recorder, plans=plans, board="simulated board", rig=rig, laws=laws, rig_name=RIG
        )
        try:
            with serving(cockpit) as address:
                yield Served(heli, address, folder)
        finally:
            cockpit.close()


@contextlib.contextmanager
def patient_page(folder: Path, laws: Sequence[LawProgram] = ()) -> Iterator[Served]:
    """Serve a page of a board that waits longer for its pilot than it does by default: a machine that stalls
    for a second must not end what a test flies."""
    with page_of_a_simulated_board(folder, laws=laws) as served:
        served.heli.params.restore(SOON_HOLDING)
        yield served


@contextlib.contextmanager
def page_process(*arguments: str, folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run ``heli-host dashboard`` as a person does; yields the process and the page's address."""
    command = [sys.executable, "-c", "from heli_host.ui.cli import main; main()", "dashboard", *arguments]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder, env={**os.environ}
    )
    try:
        assert process.stdout is not None
        lines = []
        for line in process.stdout:
            lines.append(line)
            if line.startswith("page: "):
                yield process, line.split()[1]
                break
        else:
            raise AssertionError("".join(lines))
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()


class SocketPage:
    """One tab. While `answers` is set it acknowledges frames, as a page that lives does."""

    def __init__(self, address: Address, client: str = "", token: str | None = None) -> None:
        base = f"ws://{address.host}:{address.port}"
        token = address.token if token is None else token
        self._opened = contextlib.ExitStack()
        self.socket = self._open(f"{base}/ws?token={token}&client={client}")
        self.stop_socket = self._open(f"{base}/stop?token={token}")
        self.rows: list[Rows] = []
        self.words: list[dict[str, Any]] = []
        self.known: dict[str, Any] = {}
        self.statuses = self.refused_without_number = 0
        self.answers = threading.Event()
        self.answers.set()
        self.number = 0
        self._requests = RateLimit(MESSAGES_PER_S / 2, MESSAGES_PER_S / 2)
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()
        self.until(lambda: "control" in self.known)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._opened.close()
        self._thread.join(5.0)

    def _open(self, address: str) -> ClientConnection:
        return self._opened.enter_context(connect(address, compression=None, proxy=None))

    @property
    def state(self) -> str:
        hello, status = self.known["hello"], self.known["status"]
        return str(hello["states"][str(status["state"])]["name"])

    @property
    def flies(self) -> bool:
        return bool(self.known["control"]["pilot"] == self.known["hello"]["you"])

    def until(self, so: Callable[[], bool]) -> None:
        """Wait for something; how long is nobody's claim, so long as it is not for ever."""
        end_s = time.monotonic() + PATIENCE_S
        while not so():
            assert time.monotonic() < end_s, f"waited in vain; last words: {self.words[-3:]}"
            time.sleep(0.01)

    def until_or(self, so: Callable[[], bool], longest_s: float) -> bool:
        """Wait for something, but not longer than that."""
        end_s = time.monotonic() + longest_s
        while not so():
            if time.monotonic() >= end_s:
                return False
            time.sleep(0.02)
        return True

    def until_state(self, *names: str) -> str:
        self.until(lambda: self.state in names)
        return self.state

    def send(self, name: str, /, **arguments: Any) -> int:
        self.wait_for_turn()
        self.number += 1
        self.socket.send(json.dumps({"do": name, "id": self.number, **arguments}))
        return self.number

    def wait_for_turn(self) -> None:
        """Wait until the server's limit permits one more request, as a hand does without thinking of it."""
        while not self._requests.take():
            time.sleep(self._requests.wait_s())

    def ask(self, name: str, /, **arguments: Any) -> dict[str, Any]:
        return self.answer(self.send(name, **arguments))

    def answer(self, number: int) -> dict[str, Any]:
        def matching() -> list[dict[str, Any]]:
            return [words for words in list(self.words) if words.get("answer") == number]

        self.until(lambda: bool(matching()))
        return matching()[0]

    def stop(self) -> str:
        self.stop_socket.send("stop")
        return str(self.stop_socket.recv(PATIENCE_S))

    def events(self, kind: str) -> list[str]:
        reported = [
            *self.known["hello"]["events"],
            *(message["event"] for message in list(self.words) if "event" in message),
        ]
        return [event["text"] for event in reported if event["kind"] == kind]

    def _read(self) -> None:
        with contextlib.suppress(WebSocketException, OSError):
            for message in self.socket:
                if isinstance(message, bytes):
                    rows = unpack(message)
                    self.rows.append(rows)
                    if self.answers.is_set():
                        self.socket.send(rows.number.to_bytes(4, "little"))
                else:
                    self.take_words(json.loads(message))

    def take_words(self, words: dict[str, Any]) -> None:
        """Take a message that is no telemetry, in the reading thread."""
        self.words.append(words)
        self.statuses += "status" in words
        self.refused_without_number += "error" in words and words.get("answer") is None
        self.known.update({name: words[name] for name in ("hello", "status", "control") if name in words})


class Desk:
    """Source of a page."""

    # While `status_may_return` is cleared, `status` does not return, and with it the event loop that serves
    # all clients. While `action_may_return` is cleared, no request is answered.

    def __init__(self) -> None:
        self.buffer = TelemetryBuffer(100)
        self.actions: Mapping[str, Action] = {"count": Action(self._count, CommandQueue.QUICK, Role.OBSERVER)}
        self.stops = self.counted = 0
        self.status_may_return = threading.Event()
        self.status_may_return.set()
        self.status_is_called = threading.Event()
        self.action_may_return = threading.Event()
        self.action_may_return.set()

    def _count(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        self.action_may_return.wait()
        self.counted += 1
        return {}

    def describe(self) -> dict[str, Any]:
        return {"states": {"0": {"name": "idle"}}}

    def status(self) -> dict[str, Any]:
        self.status_is_called.set()
        self.status_may_return.wait()
        return {"state": 0}

    def state(self) -> BoardState:
        return BoardState(state=0, fault=0)

    def listen(self, news: News) -> None:
        pass

    def stop(self) -> None:
        self.stops += 1

    def stop_epoch(self) -> int:
        return self.stops

    def clear_stop(self, epoch: int) -> bool:
        return epoch == self.stops

    def watch_pilot(self, present: Callable[[], bool], absence: Callable[[], str] = lambda: "") -> None:
        pass


class _Lines(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.lines: list[str] = []
        self.setFormatter(logging.Formatter("%(message)s"))

    def emit(self, record: logging.LogRecord) -> None:
        # With its trace, where there is one.
        self.lines.append(self.format(record))


@contextmanager
def log_lines() -> Iterator[list[str]]:
    """Collect what is logged in a block; the server must run before it begins."""
    lines = _Lines()
    # The logger of uvicorn hands nothing on to the root.
    loggers = [logging.getLogger(name) for name in ("", "uvicorn")]
    for logger in loggers:
        logger.addHandler(lines)
    try:
        yield lines.lines
    finally:
        for logger in loggers:
            logger.removeHandler(lines)


def traces(lines: list[str]) -> list[str]:
    """Lines that look like a crash: several for one cause, or words of asyncio."""
    return [line for line in lines if "\n" in line or "never retrieved" in line]


def _command(now: Any, state: Any, kp: Any, more_V: Any = 0.0) -> Command:
    error_rad = now.elevation_setpoint_rad - now.elevation_rad
    collective_V = 1.4 + kp * error_rad - 12.0 * now.elevation_rad_s + state.integral_V + more_V
    pitch_rad = saturated(
        0.5 * (now.travel_setpoint_rad - now.travel_rad) - 2.5 * now.travel_rad_s, -0.4, 0.4
    )
    differential_V = 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s
    return Command(
        *motor_volts(collective_V, saturated(differential_V, -1.4, 1.4)),
        states={
            "integral_V": saturated(state.integral_V + 0.02 * error_rad, -2.0, 2.0),
            "flown_s": state.flown_s + 1e-3,
        },
        signals={"wanted_pitch": pitch_rad, "kp": kp},
        pitch_setpoint_rad=pitch_rad,
    )


def steady() -> Law:
    """A law that flies."""

    @control_law(rate_Hz=1000, name="steady", states=STATES, parameters={"kp": 16.0})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return _command(now, state, parameter.kp)

    return law


def tired() -> Law:
    """A law that wants 8 V more after a second: a jump that the board does not let through."""

    @control_law(rate_Hz=1000, name="tired", states=STATES, parameters={"kp": 16.0})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return _command(now, state, parameter.kp, if_else(state.flown_s > 1.0, 8.0, 0.0))

    return law
