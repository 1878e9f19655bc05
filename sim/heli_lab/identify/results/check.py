"""Free-run errors of a fit, on its own flights and on others (cross-validation)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_sim.model.parts import AXES

from heli_lab.identify.estimation_problem import Fit, Problem
from heli_lab.identify.estimation_problem.residual_noise import correlation_at, normalised
from heli_lab.identify.free import PER_FLIGHT
from heli_lab.identify.record import Record
from heli_lab.identify.shooting import solve
from heli_lab.identify.thresholds import WHITE_LAG_S


@dataclass(frozen=True)
class Check:
    """Free-run errors of a fit on one flight.

    Parameters
    ----------
    label : str
        The flight.
    window_s : float
        Mean length of the windows, each predicted from its own initial state.
    normalised : float
        Root mean square of all errors, in standard deviations of the quantisation.
    axis_normalised : dict of float
        The same for each axis.
    rms_deg : dict of float
        Root mean square error of each axis, degrees.
    correlation : dict of float
        Autocorrelation of each axis' error over 0.1 s.
    white : dict of bool
        Whether that is within three standard deviations of a white error's.
    seconds_used : float
        Free flight in the windows.
    """

    label: str
    window_s: float
    normalised: float
    axis_normalised: dict[str, float]
    rms_deg: dict[str, float]
    correlation: dict[str, float]
    white: dict[str, bool]
    seconds_used: float


@dataclass(frozen=True)
class Trace:
    """Measured and predicted angles of a flight, window by window.

    Parameters
    ----------
    label : str
        The flight.
    t_s : ndarray (m,)
        Times.
    measured_rad, predicted_rad : ndarray (m, 3)
        Angles.
    residual : ndarray (m, 3)
        Measured minus predicted, in standard deviations of the quantisation.
    windows : tuple of slice
        Rows of each window.
    sigma_rad : ndarray (3,)
        Standard deviation of the quantisation.
    """

    label: str
    t_s: Floats
    measured_rad: Floats
    predicted_rad: Floats
    residual: Floats
    windows: tuple[slice, ...]
    sigma_rad: Floats


def trace(fit: Fit, index: int = 0) -> Trace:
    """Predict flight `index` of a fit at every sample, and return the prediction with the measurement."""
    evaluation = fit.problem.evaluation(index, fit.theta, fit.states[index], fine=True, derivatives=False)
    grid = fit.problem.grid(index, True, fit.theta)
    record = grid.record
    measured = grid.measured_rad
    return Trace(
        record.label,
        record.t_s[grid.rows],
        measured,
        measured - evaluation.residual * record.sigma_rad,
        evaluation.residual,
        tuple(grid.slices),
        record.sigma_rad,
    )


def check(fit: Fit, index: int = 0) -> Check:
    """Measure the free-run errors on flight `index` of a fit."""
    seen = trace(fit, index)
    step_s = fit.problem.records[index].step_s
    correlation, bound = correlation_at(seen.residual, seen.windows, max(1, round(WHITE_LAG_S / step_s)))
    rms = np.sqrt(np.mean(seen.residual**2, axis=0))
    return Check(
        seen.label,
        len(seen.t_s) * step_s / len(seen.windows),
        normalised(seen.residual),
        _by_axis(rms),
        _by_axis(np.rad2deg(rms * seen.sigma_rad)),
        _by_axis(correlation),
        {axis: bool(abs(value) < bound) for axis, value in zip(AXES, correlation, strict=True)},
        len(seen.t_s) * step_s,
    )


def validate(fit: Fit, flights: Sequence[Flight | Record]) -> Fit:
    """Predict flights that a fit has not seen; the result is a fit of the same parameters
    on these flights, for `check` and `trace`. Its standard errors of the zeros leave the effect of
    quantisation out.

    Only what differs from flight to flight is estimated from them: the windows' initial states, and the
    encoders' zeros, which are set each time the board starts.
    """
    problem = fit.problem
    shared = problem.parameter_vector.shared_by_name(fit.theta)
    local = {
        parameter.quantity: parameter.prior for parameter in problem.free if parameter.record is not None
    }
    held_out = Problem(
        problem.model,
        problem.rig,
        flights,
        free=tuple(local),
        per_flight=tuple(local) or PER_FLIGHT,
        window_s=problem.grids.window_s,
        step_s=problem.grids.step_s,
        priors=local,
        values=dict(
            zip((q.name for q in problem.model.parameters), problem.parameter_vector.values, strict=True)
        )
        | shared,
        state_std=problem.state_std_by_name,
    )
    return solve(held_out, robust=False, scatter=False)


def _by_axis(values: Floats) -> dict[str, float]:
    return {axis: float(value) for axis, value in zip(AXES, values, strict=True)}
