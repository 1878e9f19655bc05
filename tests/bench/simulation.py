"""How much faster than real time the simulated board flies."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import heli_host
from heli_host.fly.runner import fly
from heli_host.heli import Heli
from heli_sim.sil.process import SilProcess

from tests.bench.flights import RIG, demonstration
from tests.bench.result import Measured, repeat

REPETITIONS = 5


def _device_s_a_second(heli: Heli, log: Path | None) -> float:
    start_s, start_tick = time.perf_counter(), heli.latest.tick
    fly(heli, demonstration(), log_path=log)
    return (heli.latest.tick - start_tick) * 1e-3 / (time.perf_counter() - start_s)


def lockstep() -> float:
    """In process, nothing written."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max") as heli:
        return _device_s_a_second(heli, None)


def over_a_pty() -> float:
    """The board in a process of its own behind a pseudo-terminal, the log written."""
    with (
        TemporaryDirectory() as folder,
        SilProcess(rig=RIG, speed=None) as board,
        heli_host.connect(board.url) as heli,
    ):
        return _device_s_a_second(heli, Path(folder) / "flight.mcap")


def measure() -> list[Measured]:
    """Fly hover and sine both ways."""
    return [
        repeat("sil_native_lockstep_x_realtime", REPETITIONS, lockstep),
        repeat("sil_native_pty_x_realtime", REPETITIONS, over_a_pty),
    ]
