"""What was measured, and what was promised."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Promise:
    """A bound on one number of bench.json.

    Parameters
    ----------
    key : str
        Its key.
    meaning : str
        What it is, for the table.
    bound : float or None
        What was promised; None for a number that is only reported.
    at_least : bool
        Whether the bound is a lower one.
    """

    key: str
    meaning: str
    bound: float | None
    at_least: bool = True

    def holds(self, value: float) -> bool:
        if self.bound is None:
            return True
        return value >= self.bound if self.at_least else value <= self.bound


PROMISES = (
    Promise("sil_native_lockstep_x_realtime", "in process: board, plant, bytes, session", 200.0),
    Promise("sil_native_flight_x_realtime", "the same, steered at 50 Hz and logged", None),
    Promise("sil_native_pty_x_realtime", "pseudo-terminal, steered and logged", 50.0),
    Promise("host_decode_ticks_per_s", "bytes to arrays", 1e6),
    Promise("host_decode_ratio_to_pymavlink", "against a MAVLink message a tick", 4.0),
    Promise("telemetry_line_use", "share of 250 kbaud, hover and sine", 0.60, at_least=False),
    Promise("telemetry_line_use_worst", "with every voltage random", 1.0, at_least=False),
    Promise("host_cpu_at_1khz", "share of a core, recording", 0.05, at_least=False),
    Promise("read_600k_ticks_s", "seconds to read a ten-minute log", 2.0, at_least=False),
)


@dataclass(frozen=True)
class Measured:
    """One number, measured several times.

    Parameters
    ----------
    key : str
        Its key in bench.json.
    repetitions : sequence of float
        Every measurement.
    """

    key: str
    repetitions: Sequence[float]

    @property
    def value(self) -> float:
        return statistics.median(self.repetitions)


def repeat(key: str, count: int, measure: Callable[[], float]) -> Measured:
    """Measure several times.

    Parameters
    ----------
    key : str
        Key in bench.json.
    count : int
        How often.
    measure : callable
        Returns the number.
    """
    return Measured(key, [measure() for _ in range(count)])
