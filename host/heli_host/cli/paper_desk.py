"""The paper's experiments flown on the simulated rig, through the flight code and the whole link."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from heli_sim.paper.bench import BenchTest
    from heli_sim.paper.thrust import ThrustCurve
    from heli_sim.plant import Plant
    from heli_sim.sil.world import SilWorld

    from heli_host.flight import Flight
    from heli_host.heli import Heli

_BOOT_S = 0.5
_SETTLE_S = 1.0
_FREE_TICKS = 20
"""Left out after the release and before the end: there a hand and a voltage change at once."""
_ALL_PINNED = [True, True, True]


@contextlib.contextmanager
def board_on(plant: Plant, seed: int, elevation_deg: float) -> Iterator[tuple[Heli, SilWorld]]:
    """Start a simulated board on a rig that a hand holds still, level in pitch.

    Parameters
    ----------
    plant : Plant
        The rig.
    seed : int
        Of the encoders' starting points.
    elevation_deg : float
        Where the arm is held; the board is told that this is its rest.

    Yields
    ------
    Heli
        Connected, idle.
    SilWorld
        The world that it is in.
    """
    from heli_sim.sil.inprocess import InProcessTransport
    from heli_sim.sil.options import SilOptions
    from heli_sim.sil.world import SilWorld

    from heli_host.heli import Heli
    from heli_host.link.session import Session

    world = SilWorld(SilOptions(seed=seed), plant)
    state = world.state
    state[0] = np.deg2rad(elevation_deg)
    world.state = state
    world.native.locked = _ALL_PINNED
    session = Session(InProcessTransport(world))
    session.connect()
    with Heli(session) as heli:
        heli.params["elevation_rest_deg"] = elevation_deg
        heli.zero()
        heli.wait(_BOOT_S)
        yield heli, world


def run_bench_test(test: BenchTest, plant: Plant, seed: int = 1) -> Flight:
    """Do one of the bench tests.

    Parameters
    ----------
    test : BenchTest
        The experiment.
    plant : Plant
        The rig.
    seed : int
        Of the encoders' starting points.

    Returns
    -------
    Flight
        Every tick from the release on, time 0 at the release.
    """
    from heli_host.fly.recorder import Recorder
    from heli_host.link.declaration import Axes
    from heli_host.log.reader import read_log

    powered = test.front_V > 0.0 or test.back_V > 0.0
    with board_on(plant, seed, test.elevation_deg) as (heli, world), tempfile.TemporaryDirectory() as folder:
        if powered:
            heli.arm()
            heli.control(Axes(0))
        state = world.state
        state[1] = np.deg2rad(test.pitch_deg)
        world.state = state
        heli.wait(_SETTLE_S)
        path = Path(folder) / "test.mcap"
        with Recorder(heli, path):
            if powered:
                heli.control(Axes(0), test.front_V, test.back_V)
            world.native.locked = list(test.pinned)
            # The board and the world count the same milliseconds.
            release_tick = world.tick + _FREE_TICKS
            heli.wait(test.duration_s)
            last_tick = world.tick - _FREE_TICKS
            if powered:
                heli.stop()
            heli.wait(_BOOT_S)
        log = read_log(path)
    ticks, flight = log.ticks["tick"].astype(np.int64), log.flight()
    first, last = np.searchsorted(ticks, [release_tick, last_tick])
    cut = flight.between(float(flight.t_s[first]), float(flight.t_s[last]))
    return replace(cut, t_s=cut.t_s - cut.t_s[0])


def read_thrust(plant: Plant, seed: int = 1) -> ThrustCurve:
    """Read thrust against voltage from a scale, every axis pinned.

    Parameters
    ----------
    plant : Plant
        The rig.
    seed : int
        Of the encoders' starting points.

    Returns
    -------
    ThrustCurve
        One point for each of the voltages of Fig. 15.
    """
    from heli_sim.paper.bench import THRUST_V
    from heli_sim.paper.thrust import Scale, ThrustCurve

    from heli_host.link.declaration import Axes

    scale = Scale(plant)
    points = []
    with board_on(plant, seed, 0.0) as (heli, world):
        heli.params["motor_max_V"] = max(THRUST_V)
        heli.arm()
        for volts in THRUST_V:
            heli.control(Axes(0), volts, volts)
            heli.wait(_SETTLE_S)
            acted_V = world.native.volts_V
            points.append((*acted_V, *scale.read_N(world.state, acted_V)))
    columns = np.array(points)
    return ThrustCurve(columns[:, :2], columns[:, 2:])
