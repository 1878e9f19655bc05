"""Errors with uninformed parameters at their priors: ``python -m tests.measured.uninformed [PAIR...]``.

A parameter counts as uninformed if its standard error is above 0.9 of its prior's standard deviation. Three
ways to leave it at its prior are compared with the fit itself, 1 s ahead on the pair's other flight:

- ``reset``: it gets the prior's mean; all other parameters stay.
- ``conditional``: it gets the prior's mean; the others get their means under that condition.
- ``directions``: combinations of parameters that the flights do not inform get the prior's mean.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from heli_host.data.arrays import Floats
from heli_lab.explain.prediction import compare_free_runs, free_runs
from heli_lab.fit.problem import Fit
from heli_lab.fit.thresholds import UNINFORMED
from heli_sim.model.effect import AXES

from tests.field.cases import NO_DATA
from tests.measured.pairs import MEASURED, PAIRS, add_pairs, fitted, flights

EFFECTS = ("rotor_speed_lag",)


def alternatives(fit: Fit) -> dict[str, Floats]:
    """Parameters of a fit with what the flights do not inform at its prior, by the way it is done."""
    vector, covariance, theta = fit.problem.parameter_vector, fit.covariance, fit.theta
    none = np.sqrt(np.diag(covariance)) > UNINFORMED * vector.std
    reset = np.where(none, vector.mean, theta)
    conditional = reset.copy()
    gain = covariance[np.ix_(~none, none)] @ np.linalg.inv(covariance[np.ix_(none, none)])
    conditional[~none] += gain @ (reset - theta)[none]
    shares, directions = np.linalg.eigh(covariance / np.outer(vector.std, vector.std))
    along = directions.T @ ((theta - vector.mean) / vector.std)
    informed = np.where(shares > UNINFORMED**2, 0.0, along)
    every = {
        "reset": reset,
        "conditional": conditional,
        "directions": vector.mean + vector.std * (directions @ informed),
    }
    low = [parameter.prior.low for parameter in fit.problem.free]
    high = [parameter.prior.high for parameter in fit.problem.free]
    return {name: np.clip(values, low, high) for name, values in every.items()}


def main(arguments: Sequence[str] | None = None) -> int:
    """Print ratios of the errors to those of the fit; exit status 2 without the flights."""
    parser = argparse.ArgumentParser(prog="python -m tests.measured.uninformed", description=__doc__)
    add_pairs(parser)
    given = parser.parse_args(arguments)
    if not MEASURED.exists():
        print(NO_DATA)
        return 2
    print(f"1 s ahead, error over that of the fit: {', '.join(AXES)}")
    for pair in given.pairs or list(PAIRS):
        for back in (False, True):
            teaches, judges = flights(pair, back)
            fit = fitted(EFFECTS, teaches)
            runs = free_runs(fit, [judges])
            cells = [f"{pair}{', reversed' if back else ''}"]
            for name, theta in alternatives(fit).items():
                other = free_runs(replace(fit, theta=theta), [judges])
                ratios = compare_free_runs(runs, other).horizons["1"]
                cells.append(f"{name} " + ", ".join(f"{ratios[axis].ratio:.2f}" for axis in AXES))
            print("; ".join(cells), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
