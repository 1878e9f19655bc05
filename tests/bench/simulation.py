"""How much faster than real time the simulated board flies."""

from __future__ import annotations

import time
from pathlib import Path
from tempfile import TemporaryDirectory

import heli_host
from heli_host.fly.runner import fly
from heli_sim.sil.process import SilProcess

from tests.bench.due import build, has_cross_compiler
from tests.bench.flights import RIG, demonstration
from tests.bench.result import Measured, repeat

REPETITIONS = 5
DUE_REPETITIONS = 3
HOVER_S = 60.0
SLICE_ms = 100
"""Simulated time in one read; the host's bytes reach the line at the beginning of each."""
SPEEDS = (200.0, 150.0, 120.0, 100.0, 80.0, 70.0, 60.0, 50.0)
LARGEST_ERROR_DEG = {"elevation": 0.5, "travel": 2.0}
"""Beyond this a flight was not flown. A host that is 1 ms late is 0.1 s late at 100 times real time."""


def lockstep_hover() -> float:
    """Hover in process: board, plant, bytes and a whole session, which decodes every tick."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max&slice_ms={SLICE_ms}") as heli:
        heli.take_off()
        start_s = time.perf_counter()
        heli.wait(HOVER_S)
        return HOVER_S / (time.perf_counter() - start_s)


def lockstep_flight() -> float:
    """Fly hover and sine in process, with setpoints at 50 Hz, a log, and the summary read from it."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max") as heli:
        start_s = time.perf_counter()
        return fly(heli, demonstration()).duration_s / (time.perf_counter() - start_s)


def due_flight(elf: Path) -> float:
    """The same with the flight code's ELF on the emulated Due.

    Parameters
    ----------
    elf : Path
        The ELF.
    """
    with heli_host.connect(f"sil://?board=due&elf={elf}&rig={RIG}&speed=max") as heli:
        start_s = time.perf_counter()
        return fly(heli, demonstration()).duration_s / (time.perf_counter() - start_s)


def measure_due() -> list[Measured]:
    """Fly the emulated Due; nothing without the cross-compiler."""
    if not has_cross_compiler():
        return []
    with TemporaryDirectory() as folder:
        elf = build(Path(folder))
        return [repeat("sil_due_x_realtime", DUE_REPETITIONS, lambda: due_flight(elf))]


def over_a_pty() -> float:
    """Fly hover and sine over a pseudo-terminal, at the highest speed that loses and spoils nothing."""
    for speed in SPEEDS:
        with (
            TemporaryDirectory() as folder,
            SilProcess(rig=RIG, speed=speed) as board,
            heli_host.connect(board.url) as heli,
        ):
            start_s, start_tick = time.perf_counter(), heli.latest.tick
            summary = fly(heli, demonstration(), log_path=Path(folder) / "flight.mcap")
            passed_s = (heli.latest.tick - start_tick) * 1e-3
            elapsed_s = time.perf_counter() - start_s
        errors_deg = summary.rms_error_deg
        steered = all((errors_deg[axis] or 0.0) <= most for axis, most in LARGEST_ERROR_DEG.items())
        if summary.completed and summary.ticks_lost == 0 and steered:
            return passed_s / elapsed_s
    return 0.0


def measure() -> list[Measured]:
    """Fly in process, over a pseudo-terminal, and on the emulated Due."""
    return [
        repeat("sil_native_lockstep_x_realtime", REPETITIONS, lockstep_hover),
        repeat("sil_native_flight_x_realtime", REPETITIONS, lockstep_flight),
        repeat("sil_native_pty_x_realtime", REPETITIONS, over_a_pty),
        *measure_due(),
    ]
