"""Records a simulation, or the protocol of a session, call by call, so that JavaScript can repeat it."""

import base64
import json
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from heli_host.declaration import StopMessage
from heli_sim.model.plant import step_function
from heli_sim.rig.rig import count_rad, directions
from heli_sim.sil.options import DUE
from heli_sim.sil.world import SilWorld, saved
from heli_web.plant import plant_module

Calls = list[list[Any]]


def encoded(data: bytes) -> str:
    """Return bytes as text for JSON."""
    return base64.b64encode(data).decode()


def run_piece(node: str, name: str, given: Any) -> Any:
    """Run a function of `pieces.mjs`, and return its result."""
    path = Path(__file__).with_name("pieces.mjs")
    result = subprocess.run(
        [node, str(path), name], input=json.dumps(given), capture_output=True, text=True, check=False
    )
    assert not result.returncode, result.stderr
    return json.loads(result.stdout)


class _RecordedBoard:
    """Takes the place of a simulated board; notes what a fault does to it."""

    def __init__(self, board: Any, calls: Calls) -> None:
        self._board, self._calls = board, calls

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._board, name)
        if name not in ("reset", "power_cycle", "set_stop"):
            return method

        def noted(*arguments: Any) -> Any:
            self._calls.append([name, *arguments])
            return method(*arguments)

        return noted


class RecordedWorld:
    """Takes the place of the native world of a simulation; notes each call, and what the board sent."""

    def __init__(self, world: SilWorld) -> None:
        self.__dict__.update(calls=[], sent=bytearray(), _native=world.native)
        world.native = self  # type: ignore[assignment]
        world.board.sim = _RecordedBoard(world.board.sim, self.calls)  # type: ignore[assignment]

    def advance(self, ticks: int, rx: bytes, until_output: bool, least: int = 1) -> tuple[int, bytes]:
        """Let time pass."""
        self.calls.append(["advance", ticks, encoded(bytes(rx)), until_output, least])
        passed, sent = self._native.advance(ticks, bytes(rx), until_output, least)
        self.sent.extend(sent)
        return int(passed), sent

    def unplug(self) -> None:
        """Lose what is under way."""
        self.calls.append(["unplug"])
        self._native.unplug()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._native, name)

    def __setattr__(self, name: str, value: Any) -> None:
        noted: Mapping[str, Callable[[], Calls]] = {
            "supply_on": lambda: [["set_supply_on", bool(value)]],
            "host_reading": lambda: [["set_host_reading", bool(value)]],
            "encoders_out": lambda: [["set_encoder_out", axis, bool(out)] for axis, out in enumerate(value)],
        }
        if getattr(self._native, name) != value:
            self.calls.extend(noted[name]())
            setattr(self._native, name, value)


def setup_of(world: SilWorld) -> dict[str, Any]:
    """Return what the WebAssembly build needs to make the same world."""
    options, plant, rig = world.options, world.plant, world.rig
    rest = plant.rest_state()
    # The WebAssembly build keeps the voltages of a delay outside the plant.
    kept = len(rest) - sum(state.name.endswith("_ms_ago") for state in plant.extras.states)
    setup: dict[str, Any] = {
        "plant": encoded(plant_module(step_function(plant.model))),
        "state": rest[:kept].tolist(),
        "parameters": plant.parameters.tolist(),
        "supply_V": rig["supply"].value,
        "dead_band": rig["driver_dead_band"].value,
        "counts_per_rad": (directions(rig) / count_rad(rig)).tolist(),
        "offset_count": np.random.default_rng(options.seed).uniform(-50_000.0, 50_000.0, 3).tolist(),
        "flash": encoded(saved(world.set_from_rig) if world.set_from_rig else b"\xff" * 2048),
        "seed": options.seed,
        "delay_s": plant.extras.delay_s,
    }
    if options.board == DUE:
        from heli_sim.due.firmware import read_firmware

        segments = read_firmware(options.elf).segments
        setup["elf"] = [{"address": address, "content": encoded(data)} for address, data in segments]
    return setup


def replayed(node: str, board: Path, setup: Mapping[str, Any], calls: Calls) -> dict[str, Any]:
    """Repeat recorded calls in the WebAssembly build; return what its board sent."""
    answer: dict[str, Any] = run_piece(node, "replay", {"board": str(board), "setup": setup, "calls": calls})
    answer["sent"] = base64.b64decode(answer["sent"])
    return answer


class RecordedEngine:
    """Notes what a session asks of its protocol, and the bytes that this sends."""

    def __init__(self, engine: Any) -> None:
        self.calls: Calls = []
        self.sent: list[str] = []
        self._engine = engine
        self._now_s = 0.0
        self._kept: Any = None
        engine.receive = _noting(engine.receive, self._receive)
        engine.outgoing = _noting(
            engine.outgoing, self._outgoing, lambda sent: self.sent.append(encoded(sent))
        )
        engine.cut = _noting(engine.cut, lambda now_s, *_: self.calls.append(["cut", now_s]))
        engine.commands.ask = _noting(engine.commands.ask, self._ask)
        engine.streams.put = _noting(engine.streams.put, self._put)

    def _receive(self, data: bytes, now_s: float, _: int) -> None:
        self._now_s = now_s
        self.calls.append(["receive", now_s, encoded(bytes(data))])

    def _outgoing(self, now_s: float) -> None:
        kept = self._engine.streams.kept
        if kept is not self._kept:
            self._kept = kept
            values = [None] if kept is None else [int(kept.ID), encoded(kept.pack())]
            self.calls.append(["kept", now_s, *values])
        self.calls.append(["outgoing", now_s])

    def _ask(self, command: Any, now_s: float, _: float) -> None:
        is_stop = isinstance(command, StopMessage)
        values = ["preempt", now_s] if is_stop else ["ask", now_s, int(command.ID), encoded(command.pack())]
        self.calls.append(values)

    def _put(self, message: Any) -> None:
        self.calls.append(["put", self._now_s, int(message.ID), encoded(message.pack())])


def _noting(
    call: Callable[..., Any], before: Callable[..., None], after: Callable[[Any], None] = lambda _: None
) -> Callable[..., Any]:
    """Return a function that notes its arguments, and what it returns."""

    def noted(*arguments: Any, **named: Any) -> Any:
        before(*arguments, **named)
        result = call(*arguments, **named)
        after(result)
        return result

    return noted
