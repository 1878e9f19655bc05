"""Time of an identification, and how often the truth is within its standard errors."""

from __future__ import annotations

import time
from collections.abc import Callable

from heli_lab.fit.identify.run import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.bench.flights import RIG
from tests.bench.result import Measured, repeat
from tests.identify.coverage import Covered, cover, share_within
from tests.identify.made import flown, thinned

REPETITIONS = 3
FLIGHT_S = 60.0
FREE = (
    *("M_w", "L_phi", "L_theta", "thrust_gain", "dead_zone"),
    *(f"{kind}_{axis}" for kind in ("friction", "torque") for axis in ("elevation", "pitch", "travel")),
    *("offset_elevation", "offset_pitch"),
)
RIGS = 50


def identify_flight_s() -> list[float]:
    """Seconds for a minute at 500 Hz with thirteen parameters, checks included, compiled before."""
    rig = load_rig(RIG)
    flight = thinned(flown(rig, 1, FLIGHT_S), 2)
    assert len(FREE) == 13
    identify(MultibodyModel(), rig, [flight], free=FREE)
    passed_s = []
    for _ in range(REPETITIONS):
        start_s = time.perf_counter()
        identify(MultibodyModel(), rig, [flight], free=FREE)
        passed_s.append(time.perf_counter() - start_s)
    return passed_s


def coverage(say: Callable[[str], None] = lambda _: None) -> list[Covered]:
    """Draw fifty rigs, fly each twice, identify each."""
    flights = []
    for seed in range(1, RIGS + 1):
        flights.append(cover(seed))
        if seed % 10 == 0:
            say(f"      {seed} of {RIGS} rigs: {share_within(flights):.1%} within two standard errors")
    return flights


def measure(say: Callable[[str], None] = lambda _: None) -> list[Measured]:
    """Time a fit, then count over fifty rigs."""
    measured = [Measured("identify_60s_flight_s", identify_flight_s())]
    flights = coverage(say)
    return [
        *measured,
        repeat("identify_coverage_2std", 1, lambda: share_within(flights)),
        repeat("identify_heldout_normalised", 1, lambda: max(flight.held_out for flight in flights)),
    ]
