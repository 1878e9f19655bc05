"""The parts of the bench: what each measures, how long that takes and what it cannot do without."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from tests.bench import (
    campaign,
    decoding,
    diagnosis,
    due,
    foxglove,
    identification,
    line,
    many_flights,
    page,
    plant,
    reading,
    recording,
    simulation,
)
from tests.bench.due import has_cross_compiler
from tests.bench.result import Measured

Say = Callable[[str], None]


def nothing() -> str:
    """Say that nothing is lacking."""
    return ""


def module(name: str) -> Callable[[], str]:
    """Say whether a package is lacking."""
    return lambda: "" if importlib.util.find_spec(name) else f"{name} is not installed; make bench does that"


def cross_compiler() -> str:
    """Say whether the Due's compiler is lacking."""
    return "" if has_cross_compiler() else "no cross-compiler for the Due; make firmware says how to get it"


@cache
def sent() -> tuple[bytes, float]:
    """Bytes of the board during a flight, and its duration; two parts use them."""
    return line.flight_bytes()


@dataclass(frozen=True)
class Part:
    """One part of the bench."""

    name: str  # Name on the command line
    what: str  # What is measured, for the line before it begins
    usual_s: float  # Usual time on two cores
    measure: Callable[[Say], list[Measured]]  # Measures; its argument shows the next step
    # Says what is not installed without which it cannot measure; empty where nothing is lacking
    lack: Callable[[], str] = nothing

    def usual_time(self) -> str:
        return f"{self.usual_s:.0f} s" if self.usual_s < 200.0 else f"{self.usual_s / 60.0:.0f} minutes"


PARTS = (
    Part("simulation", "flying in simulation as fast as possible", 60, lambda _: simulation.measure()),
    Part(
        "decoding",
        "decoding, against pymavlink",
        10,
        lambda _: decoding.measure(sent()[0]),
        module("pymavlink"),
    ),
    Part("line", "counting bytes on the line", 5, lambda _: line.measure(*sent())),
    Part("reading", "reading a ten-minute log", 10, lambda _: reading.measure()),
    Part("recording", "recording in real time", 85, lambda _: recording.measure()),
    Part("page", "stopping from the live page, and what it costs", 150, lambda _: page.measure()),
    Part(
        "foxglove",
        "stopping while a viewer takes every tick, and what the viewer costs",
        300,
        lambda _: foxglove.measure(),
        module("foxglove"),
    ),
    Part(
        "due",
        "counting instructions of the Due's firmware",
        40,
        lambda _: due.measure(),
        cross_compiler,
    ),
    Part(
        "plant",
        "stepping and linearising the rig, against MuJoCo",
        10,
        lambda _: plant.measure(),
        module("mujoco"),
    ),
    Part(
        "campaign",
        "a campaign of two hundred short cases, with one worker and with two",
        35,
        lambda _: campaign.measure(),
    ),
    Part("diagnosis", "diagnosing, against an earlier commit", 630, diagnosis.ratios),
    Part("memory", "diagnosing ten minutes of flight", 120, lambda _: [diagnosis.peak()]),
    Part(
        "many-flights",
        "diagnosing ten flights of a rig, and a hundred",
        60,
        lambda _: many_flights.measure(),
    ),
    Part("identification", "identifying fifty simulated rigs", 300, identification.measure),
)
