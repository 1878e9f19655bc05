"""Flights of the flight code on the MuJoCo rig, as logs."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from heli_host.board.heli import Heli
from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.declaration import Fault
from heli_host.errors import FlightAborted
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_host.fly.tracking import NOT_TRACKED
from heli_host.link.session import Session
from heli_sim.rig import Rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

from heli_benchmark.engine.plant import HiddenEffect, MujocoPlant

_TEXT = """
title = "Blind {name}"
[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 3
[[segment]]
kind = "sine"
travel_amplitude_deg = {travel}
travel_period_s = {travel_s}
elevation_amplitude_deg = {elevation}
elevation_period_s = {elevation_s}
duration_s = {sines_s}
excite = {{ signal = "multisine", front_V = 0.25, back_V = 0.25, start_Hz = 0.1, stop_Hz = 4 }}
[[segment]]
kind = "waypoints"
path = "straight"
points = [
  {{ at_s = 6, elevation_deg = 10, travel_deg = {corner} }},
  {{ at_s = 11, elevation_deg = -10, travel_deg = 0 }},
  {{ at_s = 16, elevation_deg = 4, travel_deg = -{corner} }},
  {{ at_s = 20, elevation_deg = -4, travel_deg = -20 }},
]
duration_s = {corners_s}
excite = {{ signal = "prbs", front_V = 0.25, back_V = 0.25, stop_Hz = 8, seed = {seed} }}
[[segment]]
kind = "hold"
duration_s = 1
"""


_TRAVEL_CHECKS_OFF = {"travel_motion_deg": 90.0, "travel_motion_s": 30.0, "travel_silence_s": 0.0}
"""With these parameters, the board does not take an arm that a hidden effect holds for an unplugged travel
encoder."""
# Shortest period per degree of amplitude, for which the sine stays below the board's 20 deg/s.
_MIN_PERIOD_s_per_deg = 0.605
_MAX_RATE_deg_s = 19.9


def plan(name: str, duration_s: float, rng: np.random.Generator) -> Plan:
    """Write a plan that excites each axis, different in each case."""
    corners_s = 22.0
    sines_s = duration_s - corners_s - 6.0
    travel_deg = rng.uniform(25, 45)
    travel_s = max(round(rng.uniform(0.6, 0.75) * travel_deg, 1), _MIN_PERIOD_s_per_deg * round(travel_deg))
    # A sine that is shorter than its period fades in within half the segment, which adds to its rate.
    fade_s = 0.5 * sines_s
    max_travel_deg = (_MAX_RATE_deg_s - 2.0 * np.pi * round(travel_deg) / travel_s) * fade_s / 1.5
    if fade_s >= 0.5 * travel_s:
        max_travel_deg = np.inf
    return Plan.parse(
        _TEXT.format(
            name=name,
            travel=min(round(travel_deg), max_travel_deg),
            travel_s=travel_s,
            elevation=round(rng.uniform(6, 10), 1),
            elevation_s=round(rng.uniform(7, 12), 1),
            sines_s=sines_s,
            corner=round(rng.uniform(25, 45)),
            corners_s=corners_s,
            seed=int(rng.integers(1, 1000)),
        ),
        f"{name}.toml",
    )


def flown(rig: Rig, hidden: Sequence[HiddenEffect], course: Plan, seed: int) -> Flight:
    """Fly a plan with the flight code behind the simulated line."""
    # MujocoPlant has the members of a Plant that SilWorld uses, no others.
    world = SilWorld(SilOptions(seed=seed), MujocoPlant(rig, hidden))  # type: ignore[arg-type]
    session = Session(InProcessTransport(world), session_number=1)
    session.connect()
    with tempfile.TemporaryDirectory() as folder, Heli(session) as heli:
        for name, value in _TRAVEL_CHECKS_OFF.items():
            heli.params[name] = value
        log = Path(folder) / "flight.mcap"
        summary = fly(heli, course, log_path=log)
        flight = read_flight(log)
    # The masses of Table 2 balance at -22 degrees and never touch the table: the flight is complete.
    # Plans are drawn by chance, and the voltages are recorded: an axis that did not follow is no loss. The
    # encoders are healthy: a hidden effect has moved an angle at rest.
    is_complete = (
        summary.completed
        or summary.outcome.startswith((NOT_TRACKED, ANGLE_SHIFTED))
        or Fault.LANDING_TIMEOUT.name.lower() in summary.outcome
    )
    if not is_complete:
        raise FlightAborted(f"{course.title}: {summary.outcome}", "draw another seed")
    return flight
