"""Cost of one more flight in a diagnosis of many flights of a rig."""

from __future__ import annotations

import time
from dataclasses import replace

from heli_lab.diagnose import diagnose
from heli_lab.fit.identify import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.bench.flights import RIG
from tests.bench.result import Measured
from tests.identify.made import flown, thinned

FEW, MANY = 10, 100
FLIGHT_S = 8.0
REFITS = 1
"""Refits of each search. Their number depends on the causes, and this measures the cost of one refit."""
HIDDEN = ("rotor_lag=0.08", *(f"random_torque.{axis}=0.006" for axis in ("elevation", "pitch", "travel")))


def records() -> list[Record]:
    """Return ten flights of one rig, repeated: what a flight costs does not depend on its numbers."""
    rig = load_rig(RIG)
    model = MultibodyModel(parse_effects(HIDDEN))
    few = [thinned(flown(rig, seed, FLIGHT_S, model), 4) for seed in range(1, FEW + 1)]
    prepared = [prepare(flight, rig, f"flight {number}") for number, flight in enumerate(few)]
    return [replace(prepared[n % FEW], label=f"flight {n}") for n in range(MANY)]


def cost_s(flights: list[Record]) -> float:
    """CPU time for each of some flights."""
    start_s = time.process_time()
    diagnose(MultibodyModel(), load_rig(RIG), flights, refits=REFITS, threads=1)
    return (time.process_time() - start_s) / len(flights)


def measure() -> list[Measured]:
    """Diagnose ten flights, then a hundred."""
    every = records()
    few_s = cost_s(every[:FEW])
    return [Measured("diagnose_growth_100_flights", [cost_s(every) / few_s])]


if __name__ == "__main__":
    import resource
    import sys

    every = records()
    for count in map(int, sys.argv[1:]):
        peak_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        print(count, cost_s(every[:count]), "s a flight;", f"{peak_MB:.0f} MB before", flush=True)
    print(f"{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB at most")
