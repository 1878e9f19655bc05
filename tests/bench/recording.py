"""Share of a core that a host needs to record in real time."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import heli_host
from heli_host.fly.recorder import Recorder
from heli_sim.sil.process import SilProcess

from tests.bench.flights import RIG
from tests.bench.result import Measured, repeat

REPETITIONS = 3
HOVER_S = 20.0


def core_share() -> float:
    """Hover in real time over a pseudo-terminal; processor time of this process over wall time."""
    with (
        TemporaryDirectory() as folder,
        SilProcess(rig=RIG, speed=1.0) as board,
        heli_host.connect(board.url) as heli,
    ):
        heli.take_off()
        with Recorder(heli, Path(folder) / "flight.mcap"):
            start_s, busy_s = time.perf_counter(), time.process_time()
            heli.wait(HOVER_S)
            return (time.process_time() - busy_s) / (time.perf_counter() - start_s)


def measure() -> list[Measured]:
    """Record three hovers."""
    return [repeat("host_cpu_at_1khz", REPETITIONS, core_share)]
