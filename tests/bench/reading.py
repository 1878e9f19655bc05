"""How long it takes to read a ten-minute log into numpy."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import heli_host
from heli_host.data.log.reader import read_flight
from heli_host.fly.runner import fly

from tests.bench.flights import RIG, hover
from tests.bench.result import Measured, repeat

REPETITIONS = 5
LOG_TICKS = 600_000


def measure() -> list[Measured]:
    """Record ten minutes in lockstep, then read them."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "flight.mcap"
        with heli_host.connect(f"sil://?rig={RIG}&speed=max") as heli:
            fly(heli, [hover(LOG_TICKS * 1e-3)], log_path=path)

        def read_s() -> float:
            start_s = time.perf_counter()
            flight = read_flight(path)
            elapsed_s = time.perf_counter() - start_s
            assert len(flight) >= LOG_TICKS
            return elapsed_s * LOG_TICKS / len(flight)

        return [repeat("read_600k_ticks_s", REPETITIONS, read_s)]
