"""What share of a core a host takes that records in real time."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import heli_host
from heli_host.fly.runner import fly
from heli_sim.sil.process import SilProcess

from tests.bench.flights import RIG, hover
from tests.bench.result import Measured, repeat

REPETITIONS = 3
FLIGHT_S = 12.0
"""Take-off and landing come on top: about 22 s in all."""


def core_share() -> float:
    """Fly in real time over a pseudo-terminal; processor time of this process over wall time."""
    with (
        TemporaryDirectory() as folder,
        SilProcess(rig=RIG, speed=1.0) as board,
        heli_host.connect(board.url) as heli,
    ):
        start_s, busy_s = time.perf_counter(), time.process_time()
        fly(heli, [hover(FLIGHT_S)], log_path=Path(folder) / "flight.mcap")
        return (time.process_time() - busy_s) / (time.perf_counter() - start_s)


def measure() -> list[Measured]:
    """Record three flights."""
    return [repeat("host_cpu_at_1khz", REPETITIONS, core_share)]
