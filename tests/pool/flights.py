"""Flights of one rig in weather, and its numbers from some of them together."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_lab.estimation import estimate
from heli_lab.identify import Record, prepare
from heli_lab.identify.flight_model import RigParameters, kinematic_filter, model_functions
from heli_lab.pool.machine import Estimate, by_flights_alone
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import Rig, load_rig

from tests.identify import made
from tests.identify.made import flown, perturbed, thinned
from tests.running.kept import FLOWN, KEPT

SECONDS = 14.0
FLIGHTS = 4
"""Together, to be held against one."""
BY_FLIGHTS = ("rotor_lag_s", "friction_pitch", "friction_travel", "dead_zone")
"""Numbers that one flight tells by itself; masses and lengths are told in combinations only, whose other
members a file's tolerances hold."""
GUST_Nm = {"elevation": 0.012, "pitch": 0.004, "travel": 0.008}
MADE_BY = (Path(__file__), Path(made.__file__))


@dataclass(frozen=True)
class Pooled:
    """Numbers of a rig from some flights together.

    Parameters
    ----------
    off : dict of float
        By name, estimate minus truth in standard errors.
    alone : dict of Estimate
        By name, what the flights alone say, where they say more than the rig's file.
    """

    off: dict[str, float]
    alone: dict[str, Estimate]


def true_rig(rig: int) -> tuple[Rig, float]:
    """Numbers of a rig, drawn from what the file says of them, and the lag of its rotors in s."""
    return perturbed(rig), float(np.random.default_rng([rig, 8]).uniform(0.04, 0.12))


def _flown(rig: int, seed: int) -> Flight:
    true, lag_s = true_rig(rig)
    gusts = [f"random_torque.{axis}={size}" for axis, size in GUST_Nm.items()]
    model = MultibodyModel(parse_effects([f"rotor_lag={lag_s}", *gusts]))
    return thinned(flown(true, 1000 * rig + seed, SECONDS, model), 4)


@cache
def record(rig: int, seed: int) -> Record:
    name = f"pooled {rig} {seed} {SECONDS} {GUST_Nm}"
    flight = KEPT(name, lambda: _flown(rig, seed), made_by=MADE_BY, rooms=FLOWN)
    return prepare(flight, load_rig("makki2024"), f"flight {seed}")


@cache
def pooled(rig: int, count: int) -> Pooled:
    """Estimate a rig's numbers from its first flights together."""
    nominal, (true, lag_s) = load_rig("makki2024"), true_rig(rig)
    records = [record(rig, seed) for seed in range(count)]
    model = MultibodyModel(parse_effects(["rotor_lag=0.06"]))
    parameter_vector = RigParameters(model, nominal, records)
    functions = model_functions(model, parameter_vector.quantities)
    references, theta, disturbances = [kinematic_filter(one) for one in records], parameter_vector.start, None
    for _ in range(2):
        found = estimate(parameter_vector, references, functions, theta, disturbances)
        theta, disturbances = found.theta, found.disturbances
        references = found.filtered().refiltered(disturbances)
    std = np.sqrt(np.diag(found.covariance))
    truth = {**{name: number.value for name, number in true.items()}, "rotor_lag_s": lag_s}
    shared = [(i, one) for i, one in enumerate(parameter_vector.free) if one.record is None]
    alone = {
        one.name: by_flights_alone(
            float(theta[i]), float(std[i]), Estimate(one.prior.mean, one.prior.std, one.unit)
        )
        for i, one in shared
    }
    return Pooled(
        {one.name: float((theta[i] - truth[one.quantity]) / std[i]) for i, one in shared},
        {name: one for name, one in alone.items() if one is not None},
    )


def shares_of_one(name: str, rigs: Iterable[int]) -> list[float]:
    """Standard error of a number from `FLIGHTS` flights over that from one, times the root of `FLIGHTS`, of
    each rig."""
    return [
        math.sqrt(FLIGHTS) * pooled(rig, FLIGHTS).alone[name].std / pooled(rig, 1).alone[name].std
        for rig in rigs
    ]


def off(count: int, rigs: Iterable[int]) -> Floats:
    """Every number of each rig from `count` flights, minus the truth, in standard errors."""
    return np.array([value for rig in rigs for value in pooled(rig, count).off.values()])
