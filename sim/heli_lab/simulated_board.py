"""Fly the flight code on a simulated rig, in lockstep in this process: connect, fly, read the log."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from heli_host.board.heli import Heli
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.summary import FlightSummary
from heli_host.fly.plan import Plan
from heli_host.fly.runner import Progress, fly
from heli_host.link.session import Session
from heli_sim.model.base import Model
from heli_sim.model.linear import trim
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

WITHOUT_TRAVEL_CHECKS: Final[Mapping[str, float]] = {"travel_silence_s": 0.0}
"""Parameters with which the board does not tilt the arm to check a silent travel encoder. In a flight that
measures gains, such a tilt is an error of travel that no gain causes."""


def world_of(plant: Plant, seed: int) -> SilWorld:
    """Return the simulation of a board that is connected to a plant."""
    return SilWorld(SilOptions(seed=seed), plant)


@contextmanager
def connected(world: SilWorld) -> Iterator[Heli]:
    """Connect to the simulated board of a `world`, until the block ends; then the motors are off."""
    session = Session(InProcessTransport(world), session_number=1)
    session.connect()
    with Heli(session) as heli:
        yield heli


def set_hover(heli: Heli, model: Model, rig: Rig) -> None:
    """Set the parameters that an operator must set for a rig: the hover voltage, and the rest tolerance."""
    hover_V = float(sum(trim(type(model)(), rig).volts_V)) - 2.0 * rig["dead_zone"].value
    heli.params["hover_V"] = hover_V
    heli.params["arm_elevation_tolerance_deg"] = 20.0


def fly_and_read(
    heli: Heli, plans: Plan | str | Sequence[Plan], on_progress: Callable[[Progress], None] | None = None
) -> tuple[Flight, FlightSummary]:
    """Fly plans with a connected board, and return the flight of the log with its summary."""
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "flight.mcap"
        summary = fly(heli, plans, log_path=log, on_progress=on_progress)
        return read_flight(log), summary
