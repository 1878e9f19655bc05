"""Records a simulation call by call, so that the WebAssembly build can repeat it."""

from __future__ import annotations

import base64
import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from heli_sim.plant import step_function
from heli_sim.sil.flash_pages import saved
from heli_sim.sil.options import DUE
from heli_sim.sil.world import SilWorld
from heli_web.plant import plant_module


def encoded(data: bytes) -> str:
    return base64.b64encode(data).decode()


class RecordedWorld:
    """Stands in for the native world of a simulation; remembers each call, and what the board sent."""

    def __init__(self, world: SilWorld) -> None:
        self.calls: list[list[Any]] = []
        self.sent = bytearray()
        self._native = world.native
        world.native = self  # type: ignore[assignment]
        board = world.board.sim
        for name, call in (("reset", "reset"), ("power_cycle", "power_cycle"), ("set_stop", "set_stop")):
            self._wrap_board(world, board, name, call)

    def _wrap_board(self, world: SilWorld, board: Any, name: str, call: str) -> None:
        class Board:
            def __getattr__(_, attribute: str) -> Any:
                value = getattr(board, attribute)
                if attribute not in ("reset", "power_cycle", "set_stop"):
                    return value

                def recorded(*arguments: Any) -> Any:
                    self.calls.append([attribute, *arguments])
                    return value(*arguments)

                return recorded

        world.board.sim = Board()

    def advance(self, ticks: int, rx: bytes, until_output: bool, least: int = 1) -> tuple[int, bytes]:
        self.calls.append(["advance", ticks, encoded(bytes(rx)), until_output, least])
        passed, sent = self._native.advance(ticks, bytes(rx), until_output, least)
        self.sent += sent
        return passed, sent

    def unplug(self) -> None:
        self.calls.append(["unplug"])
        self._native.unplug()

    def __getattr__(self, name: str) -> Any:
        return getattr(self._native, name)

    def __setattr__(self, name: str, value: Any) -> None:
        if name in ("calls", "sent", "_native"):
            object.__setattr__(self, name, value)
            return
        if name == "supply_on":
            self.calls.append(["set_supply_on", bool(value)])
        elif name == "host_reading":
            if value == self._native.host_reading:
                return
            self.calls.append(["set_host_reading", bool(value)])
        elif name == "encoders_out":
            self.calls += [["set_encoder_out", axis, bool(out)] for axis, out in enumerate(value)]
        else:
            raise AttributeError(f"{name} is not recorded")
        setattr(self._native, name, value)


def setup_of(world: SilWorld) -> dict[str, Any]:
    """Return what the WebAssembly build needs to make the same world."""
    options, plant, rig = world.options, world.plant, world.rig
    model, offsets = plant.model, np.random.default_rng(options.seed).uniform(-50_000.0, 50_000.0, 3)
    parameters = plant.parameters.tolist()
    from heli_sim.rig.encoders import count_rad, directions

    rest = plant.rest_state()
    delayed = [index for index, state in enumerate(plant.extras.states) if state.name.endswith("_ms_ago")]
    count = len(rest) - len(delayed)
    setup: dict[str, Any] = {
        "plant": encoded(plant_module(step_function(model))),
        "state": rest[:count].tolist(),
        "parameters": parameters,
        "supply_V": rig["supply"].value,
        "dead_band": rig["driver_dead_band"].value,
        "counts_per_rad": (directions(rig) / count_rad(rig)).tolist(),
        "offset_count": offsets.tolist(),
        "flash": encoded(saved(world.set_from_rig) if world.set_from_rig else b"\xff" * 2048),
        "seed": options.seed,
        "delay_s": plant.extras.delay_s,
    }
    if options.board == DUE:
        from heli_sim.due.firmware import read_firmware

        image = read_firmware(options.elf)
        setup["elf"] = [{"address": address, "content": encoded(data)} for address, data in image.segments]
    return setup


def replayed(node: str, board: Path, setup: Mapping[str, Any], calls: list[list[Any]]) -> dict[str, Any]:
    """Repeat recorded calls in the WebAssembly build; return what its board sent."""
    script = Path(__file__).with_name("replay.mjs")
    given = json.dumps({"board": str(board), "setup": setup, "calls": calls})
    result = subprocess.run([node, str(script)], input=given, capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(result.stderr)
    answer: dict[str, Any] = json.loads(result.stdout)
    answer["sent"] = base64.b64decode(answer["sent"])
    return answer


class RecordedEngine:
    """Remembers what a session asks of its protocol, and the bytes that this sends."""

    def __init__(self, engine: Any) -> None:
        self.calls: list[list[Any]] = []
        self.sent: list[str] = []
        self._engine = engine
        self._now_s = 0.0
        self._kept: Any = None
        self._ticks = 0
        engine.receive = self._recorded(engine.receive, self._receive)
        engine.outgoing = self._recorded(engine.outgoing, self._outgoing)
        engine.cut = self._recorded(engine.cut, lambda now_s, *_: self.calls.append(["cut", now_s]))
        engine.commands.ask = self._recorded(engine.commands.ask, self._ask)
        engine.streams.put = self._recorded(engine.streams.put, self._put)

    @staticmethod
    def _recorded(call: Any, note: Any) -> Any:
        def recorded(*arguments: Any, **named: Any) -> Any:
            after = note(*arguments, **named)
            result = call(*arguments, **named)
            if callable(after):
                after(result)
            return result

        return recorded

    def _receive(self, data: bytes, now_s: float, _: int) -> None:
        self._now_s = now_s
        self.calls.append(["receive", now_s, encoded(bytes(data))])

    def _outgoing(self, now_s: float) -> Any:
        kept = self._engine.streams.kept
        if kept is not self._kept:
            self._kept = kept
            self.calls.append(["kept", now_s, *([None] if kept is None else [int(kept.ID), encoded(kept.pack())])])
        self.calls.append(["outgoing", now_s])
        return lambda sent: self.sent.append(encoded(sent))

    def _ask(self, command: Any, now_s: float, _: float) -> None:
        from heli_host.declaration import StopMessage

        is_stop = isinstance(command, StopMessage)
        self.calls.append(
            ["preempt", now_s] if is_stop else ["ask", now_s, int(command.ID), encoded(command.pack())]
        )

    def _put(self, message: Any) -> None:
        self.calls.append(["put", self._now_s, int(message.ID), encoded(message.pack())])


def engine_replayed(node: str, calls: list[list[Any]]) -> dict[str, Any]:
    """Play recorded calls into the small host's engine; return what it sent and received."""
    script = Path(__file__).with_name("engine.mjs")
    result = subprocess.run([node, str(script)], input=json.dumps(calls), capture_output=True, text=True, check=False)
    if result.returncode:
        raise RuntimeError(result.stderr)
    answer: dict[str, Any] = json.loads(result.stdout)
    return answer
