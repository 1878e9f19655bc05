"""``python -m tests.pool.coverage``: standard errors of a rig's parameters from several flights together.

Prints how they fall with the root of the number of flights, for parameters that one flight identifies, and
how often the true value is within two of them.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.apps.pool import ParameterEstimate, without_prior
from heli_lab.fit.estimator import estimate
from heli_lab.fit.flight_model import RigParameters, filter_record, model_functions
from heli_lab.fit.innovations import refiltered
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import Rig, load_rig

from tests.identify import made
from tests.identify.made import flown, perturbed, thinned
from tests.running.kept import FLOWN, KEPT

SECONDS = 14.0
FLIGHTS = 4
"""Number of flights in a joint estimate, to compare with one flight."""
BY_FLIGHTS = ("rotor_lag_s", "friction_pitch", "friction_travel", "dead_zone")
"""Parameters that one flight identifies alone. It identifies only combinations of masses and lengths, so
that the rig file's tolerances are needed too."""
GUST_Nm = {"elevation": 0.012, "pitch": 0.004, "travel": 0.008}
MADE_BY = (Path(__file__), Path(made.__file__))


@dataclass(frozen=True)
class Pooled:
    """Parameters of a rig from several flights together."""

    # `off`: Estimate minus true value, in standard errors, by name.
    # `alone`: Estimates without the prior, by name, if the flights are informative.

    off: dict[str, float]
    alone: dict[str, ParameterEstimate]


def true_rig(rig: int) -> tuple[Rig, float]:
    """Return a rig drawn within the tolerances of its file, and the lag of its rotors [s]."""
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
    """Estimate a rig's parameters from its first `count` flights together."""
    nominal, (true, lag_s) = load_rig("makki2024"), true_rig(rig)
    records = [record(rig, seed) for seed in range(count)]
    model = MultibodyModel(parse_effects(["rotor_lag=0.06"]))
    parameter_vector = RigParameters(model, nominal, records)
    functions = model_functions(model, parameter_vector.quantities)
    references, theta, disturbances = (
        [filter_record(item) for item in records],
        parameter_vector.start,
        None,
    )
    for _ in range(2):
        fit = estimate(parameter_vector, references, functions, theta, disturbances)
        theta, disturbances = fit.theta, fit.disturbances
        references = refiltered(fit.filtered(), disturbances)
    std = np.sqrt(np.diag(fit.covariance))
    truth = {**{name: number.value for name, number in true.items()}, "rotor_lag_s": lag_s}
    shared = [(i, item) for i, item in enumerate(parameter_vector.free) if item.is_shared]
    one_flight = {
        item.name: without_prior(
            float(theta[i]), float(std[i]), ParameterEstimate(item.prior.mean, item.prior.std, item.unit)
        )
        for i, item in shared
    }
    return Pooled(
        {item.name: float((theta[i] - truth[item.quantity]) / std[i]) for i, item in shared},
        {name: item for name, item in one_flight.items() if item is not None},
    )


def shares_of_one(name: str, rigs: Iterable[int]) -> list[float]:
    """Return, for each rig, the ratio of standard errors from `FLIGHTS` flights and one, times their root."""
    return [
        math.sqrt(FLIGHTS) * pooled(rig, FLIGHTS).alone[name].std / pooled(rig, 1).alone[name].std
        for rig in rigs
    ]


def normalised_errors(count: int, rigs: Iterable[int]) -> Floats:
    """Return all estimates of each rig from `count` flights minus the true values, in standard errors."""
    return np.array([value for rig in rigs for value in pooled(rig, count).off.values()])


RIGS = range(1, 13)


def main() -> None:
    """Print ratios and coverage."""
    for name in BY_FLIGHTS:
        shares = shares_of_one(name, RIGS)
        print(
            f"{name}: {FLIGHTS} flights over one, times the root of {FLIGHTS}: mean {np.mean(shares):.2f}, "
            f"{min(shares):.2f} to {max(shares):.2f} on {len(shares)} rigs",
            flush=True,
        )
    for count in (1, FLIGHTS):
        every = normalised_errors(count, RIGS)
        print(
            f"{count} flights: {np.mean(np.abs(every) < 2.0):.1%} of {len(every)} numbers within 2 standard "
            f"errors, rms {np.sqrt(np.mean(every**2)):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
