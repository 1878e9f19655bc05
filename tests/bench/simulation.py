"""How much faster than real time the simulated board flies."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Speed:
    """How much faster than real time something flew."""

    # By the clock on the wall, and by the time that this process had a core: on a machine with other work
    # only the second says what the code costs
    elapsed_x: float
    # By the clock on the wall, and by the time that this process had a core: on a machine with other work
    # only the second says what the code costs
    cpu_x: float


class Stopwatch:
    """Starts when it is made."""

    def __init__(self) -> None:
        self._elapsed_s, self._cpu_s = time.perf_counter(), time.process_time()

    def speed(self, simulated_s: float) -> Speed:
        """Speed at which so much simulated time passed since the start [s]."""
        return Speed(
            simulated_s / (time.perf_counter() - self._elapsed_s),
            simulated_s / (time.process_time() - self._cpu_s),
        )


def lockstep_hover() -> Speed:
    """Hover in process: board, plant, bytes and a whole session, which decodes every tick."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max&slice_ms={SLICE_ms}") as heli:
        heli.take_off()
        watch = Stopwatch()
        heli.wait(HOVER_S)
        return watch.speed(HOVER_S)


def lockstep_flight() -> Speed:
    """Fly hover and sine in process, with setpoints at 50 Hz, a log, and the summary read from it."""
    with heli_host.connect(f"sil://?rig={RIG}&speed=max") as heli:
        watch = Stopwatch()
        return watch.speed(fly(heli, demonstration()).duration_s)


def due_flight(elf: Path) -> Speed:
    """The same with the flight code's ELF on the emulated Due."""
    with heli_host.connect(f"sil://?board=due&elf={elf}&rig={RIG}&speed=max") as heli:
        watch = Stopwatch()
        return watch.speed(fly(heli, demonstration()).duration_s)


def measure_due() -> list[Measured]:
    """Fly the emulated Due; nothing without the cross-compiler."""
    if not has_cross_compiler():
        return []
    with TemporaryDirectory() as folder:
        elf = build(Path(folder))
        return repeat_speed("sil_due", DUE_REPETITIONS, lambda: due_flight(elf))


def repeat_speed(name: str, count: int, fly_once: Callable[[], Speed]) -> list[Measured]:
    """Measure a speed several times, by both clocks."""
    speeds = [fly_once() for _ in range(count)]
    return [
        Measured(f"{name}_x_realtime", [speed.elapsed_x for speed in speeds]),
        Measured(f"{name}_x_cpu", [speed.cpu_x for speed in speeds]),
    ]


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
        *repeat_speed("sil_native_lockstep", REPETITIONS, lockstep_hover),
        *repeat_speed("sil_native_flight", REPETITIONS, lockstep_flight),
        repeat("sil_native_pty_x_realtime", REPETITIONS, over_a_pty),
        *measure_due(),
    ]
