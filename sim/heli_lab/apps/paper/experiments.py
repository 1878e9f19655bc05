"""Run the paper's experiments on the simulated rig, with the flight code and the link."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.board.published_gains import load_gains
from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_log
from heli_host.declaration import Axes, State
from heli_host.fly.heli import Heli
from heli_host.fly.plan import Plan, take_off
from heli_host.fly.recorder import Recorder
from heli_host.fly.runner import Progress
from heli_sim.bench.thrust_curve import ThrustCurve
from heli_sim.plant import Plant
from heli_sim.sil.world import SilWorld

from heli_lab.apps.paper.bench_tests import TABLE_DEG, THRUST_V, BenchTest
from heli_lab.apps.paper.figures_flight import PaperFlight, closed_loop_flight
from heli_lab.apps.paper.thrust import ThrustScale
from heli_lab.simulated_board import connected, fly_and_read, world_of

_BOOT_S = 0.5
"""Simulated time after which the board has started [s]."""
_SETTLE_S = 1.0
"""Simulated time after which encoder filters and thrust have settled [s]."""
_MARGIN_TICKS = 20
"""Ticks that are left out after the release and before the end, because locks and voltages change there."""
_ALL_LOCKED = [True, True, True]


_START = """
[start]
elevation_deg = 0
rate_deg_s = 15
settle_s = 4
"""
# The paper's text states neither amplitudes nor times; these stay within the stops of its rig.
PLANS: Final = {
    "hover": f"""
title = "Hover"
{_START}
[[segment]]
kind = "hold"
duration_s = 10
""",
    "irregular": f"""
title = "Irregular travel path, constant elevation"
{_START}
[[segment]]
kind = "waypoints"
path = "smooth"
points = [
  {{ at_s = 4, travel_deg = 20 }}, {{ at_s = 9, travel_deg = 20 }}, {{ at_s = 14, travel_deg = -10 }},
  {{ at_s = 18, travel_deg = 5 }}, {{ at_s = 23, travel_deg = 5 }}, {{ at_s = 30, travel_deg = 40 }},
  {{ at_s = 34, travel_deg = 30 }}, {{ at_s = 42, travel_deg = 0 }},
]
duration_s = 48
""",
    "sine": f"""
title = "Sines on travel and elevation"
{_START}
[[segment]]
kind = "sine"
elevation_amplitude_deg = 5
elevation_period_s = 15
travel_amplitude_deg = 25
travel_period_s = 20
duration_s = 60
""",
}
"""Plans of the flights behind Figs. 21 to 25, as TOML."""


@contextlib.contextmanager
def board_on(plant: Plant, seed: int, elevation_deg: float) -> Iterator[tuple[Heli, SilWorld]]:
    """Start a simulated board on a rig with level pitch, all axes locked, until the block ends."""
    world = world_of(plant, seed)
    state = world.state
    state[0] = np.deg2rad(elevation_deg)
    world.state = state
    world.native.locked = _ALL_LOCKED
    with connected(world) as heli:
        heli.params["elevation_rest_deg"] = elevation_deg
        heli.zero()
        heli.wait(_BOOT_S)
        yield heli, world


def run_bench_test(test: BenchTest, plant: Plant, seed: int = 1) -> Flight:
    """Run a bench test, and return its flight with one row per tick; time 0 is at the release."""
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
            world.native.locked = list(test.locked)
            # Board and simulation count the same milliseconds.
            release_tick = world.tick + _MARGIN_TICKS
            heli.wait(test.duration_s)
            last_tick = world.tick - _MARGIN_TICKS
            if powered:
                heli.stop()
            heli.wait(_BOOT_S)
        log = read_log(path)
    ticks, flight = log.ticks["tick"].astype(np.int64), log.flight()
    first_row, last_row = np.searchsorted(ticks, [release_tick, last_tick])
    test_flight = flight.between(float(flight.t_s[first_row]), float(flight.t_s[last_row]))
    return replace(test_flight, t_s=test_flight.t_s - test_flight.t_s[0])


def read_thrust(plant: Plant, seed: int = 1) -> ThrustCurve:
    """Measure thrust over voltage with scales under the rotors, at the voltages of Fig. 15, with locked
    axes.
    """
    scale = ThrustScale(plant)
    motor_volts_V, thrust_N = [], []
    with board_on(plant, seed, 0.0) as (heli, world):
        heli.params["motor_max_V"] = max(THRUST_V)
        heli.arm()
        for volts in THRUST_V:
            heli.control(Axes(0), volts, volts)
            heli.wait(_SETTLE_S)
            # The voltage that acts on the motors, which may differ from the command.
            motor_volts_V.append(world.native.volts_V)
            thrust_N.append(scale.read_N(world.state, world.native.volts_V))
    return ThrustCurve(np.array(motor_volts_V), np.array(thrust_N))


def fly_plan(
    name: str,
    plant: Plant,
    label: str,
    gains: str | None = None,
    seed: int = 1,
    on_progress: Callable[[float], None] | None = None,
) -> PaperFlight:
    """Fly one of the plans behind Figs. 21 to 25; a flight that ends with a fault is also returned."""
    plan = Plan.parse(PLANS[name], f"plan {name}", name)
    length_s = plan.duration_s + plan.start.settle_s

    with board_on(plant, seed, TABLE_DEG) as (heli, world):

        def report(progress: Progress) -> None:
            """Release the arm when the loops close, and pass on the completed share of the flight."""
            # With the masses of Table 2, the arm without thrust balances above its table, so that it must be
            # locked until then.
            if progress.sample.state is State.CLOSED_LOOP:
                world.native.locked = [False, False, False]
            if on_progress is not None:
                on_progress(min(1.0, progress.t_s / length_s))

        load_gains(heli.params, gains)
        sample = heli.latest
        start_deg = np.array([sample.elevation_deg, sample.pitch_deg, sample.travel_deg])
        route = take_off([plan], dict(heli.params), start_deg)
        flight, summary = fly_and_read(heli, plan, report)
    closed_loop_rows = np.flatnonzero(flight.state == State.CLOSED_LOOP)
    start_s = float(flight.t_s[closed_loop_rows[0]]) if closed_loop_rows.size else 0.0
    # The arm was locked before the take-off, so its angles then are not those of its rest.
    outcome = "completed" if summary.outcome.startswith(ANGLE_SHIFTED) else summary.outcome
    return closed_loop_flight(label, flight, route.evaluate(flight.t_s - start_s), outcome)
