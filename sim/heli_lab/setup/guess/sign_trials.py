"""Simulate the baseline model of the rig with each choice of signs."""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.fit.problem import Budget, Problem
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.shooting import solve
from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.regression.scales import AXES
from heli_lab.setup.guess.result import SignChoice

PIECE_S: Final = 2.0
"""Length of the pieces into which a flight is cut [s]; the most strongly excited ones are simulated."""
TRIAL_WINDOW_S: Final = 1.0
"""Length of the open-loop simulations [s]: long enough for travel to follow pitch, short enough that a wrong
choice does not diverge."""
EVALUATIONS: Final = 8
"""Number of evaluations of the model with derivatives per choice: enough for trim and gains to converge, and
a wrong sign stays wrong."""


def try_sign_choices(flight: Flight, rig: Rig) -> tuple[SignChoice, ...]:
    """Fit and simulate a flight with each of the eight choices of the three angles' signs.

    Exchanging the motors needs no choice of its own: it equals inverting pitch and travel.
    """
    try:
        record = _most_excited_part(prepare(flight, rig))
    except IdentifyError:
        return ()
    errors_deg = {}
    for signs in itertools.product((1.0, -1.0), repeat=3):
        angles = record.angles_rad * np.array(signs)
        errors_deg[signs] = _fitted_error_deg(replace(record, angles_rad=angles, label=f"{signs}"), rig)
    unchanged_deg = errors_deg[1.0, 1.0, 1.0]
    choices = []
    for signs, error_deg in errors_deg.items():
        inverted_axes = [axis for axis, sign in zip(AXES, signs, strict=True) if sign < 0.0]
        # Product of the ratios of the three axes; the bound keeps a perfect fit from dividing by 0.
        log_ratios = np.log(np.maximum(error_deg, 1e-6) / np.maximum(unchanged_deg, 1e-6))
        elevation_deg, pitch_deg, travel_deg = (float(error) for error in error_deg)
        choices.append(
            SignChoice(
                " and ".join(inverted_axes),
                (elevation_deg, pitch_deg, travel_deg),
                error_ratio=float(np.exp(np.sum(log_ratios))),
            )
        )
    return tuple(choices)


def _most_excited_part(record: Record) -> Record:
    """Keep the pieces of a record in which elevation and pitch move most, `SIMULATED_S` in total."""
    rows = max(2, round(PIECE_S / record.step_s))
    pieces = [
        (first, first + rows)
        for start, stop in record.segments
        for first in range(start, stop - rows + 1, rows)
    ]
    if not pieces:
        return record
    # Standard deviations of elevation and pitch in each piece, shape (pieces, 2).
    motion = np.array([record.angles_rad[first:stop, :2].std(axis=0) for first, stop in pieces])
    relative_motion = (motion / np.maximum(motion.mean(axis=0), 1e-9)).sum(axis=1)
    most_excited_first = np.argsort(-relative_motion)
    max_pieces = max(1, round(thresholds.SIMULATED_S / PIECE_S))
    chosen = sorted(pieces[i] for i in most_excited_first[:max_pieces])
    return replace(record, segments=tuple(chosen))


def _fitted_error_deg(record: Record, rig: Rig) -> Floats:
    """Fit the baseline model to a record, and return the rms error of its open-loop simulations. Returns
    shape (3,).
    """
    problem = Problem(MultibodyModel(), rig, [record], window_s=TRIAL_WINDOW_S, step_s=0.02)
    try:
        fit = solve(problem, budget=Budget(max_evaluations=EVALUATIONS), fine=False, scatter=False)
    except IdentifyError:
        return np.full(3, 180.0)
    with np.errstate(all="ignore"):
        residual = problem.residual(0, fit.theta, fit.states[0])
        error_deg = np.degrees(np.sqrt(np.mean(residual**2, axis=0)) * record.sigma_rad)
    finite_error_deg: Floats = np.nan_to_num(error_deg, nan=180.0, posinf=180.0)
    return finite_error_deg
