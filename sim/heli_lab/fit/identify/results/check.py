"""Measure the free-run (open-loop simulation) errors of a fit, on its own flights and on held-out ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.model.parts import AXES

from heli_lab.fit.identify.estimation_problem import Fit, Problem
from heli_lab.fit.identify.estimation_problem.residual_noise import correlation_at, normalised
from heli_lab.fit.identify.free import PER_FLIGHT
from heli_lab.fit.identify.record import Record
from heli_lab.fit.identify.shooting import solve
from heli_lab.fit.identify.thresholds import WHITE_LAG_S


@dataclass(frozen=True)
class FreeRunErrors:
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
        The same for each axis, by its name.
    rms_deg : dict of float
        Root mean square error of each axis [deg].
    correlation : dict of float
        Autocorrelation of each axis' error at a lag of 0.1 s.
    white : dict of bool
        Whether the correlation is within three standard errors of that of white noise.
    seconds_used : float
        Free flight in all windows [s].
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
    """Measured and predicted angles of one flight; each window is predicted from its own initial state.

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
    """Predict flight number `index` of a fit at every sample, window by window."""
    residual = fit.problem.residual(index, fit.theta, fit.states[index], fine=True)
    grid = fit.problem.grid(index, fine=True, theta=fit.theta)
    record = grid.record
    measured = grid.measured_rad
    return Trace(
        label=record.label,
        t_s=record.t_s[grid.rows],
        measured_rad=measured,
        predicted_rad=measured - residual * record.sigma_rad,
        residual=residual,
        windows=tuple(grid.slices),
        sigma_rad=record.sigma_rad,
    )


def check(fit: Fit, index: int = 0) -> FreeRunErrors:
    """Measure the free-run errors of a fit on its flight number `index`, and test whether they are white."""
    flight = trace(fit, index)
    step_s = fit.problem.records[index].step_s
    lag_rows = max(1, round(WHITE_LAG_S / step_s))
    correlation, bound = correlation_at(flight.residual, flight.windows, lag_rows)
    rms = np.sqrt(np.mean(flight.residual**2, axis=0))
    used_s = len(flight.t_s) * step_s
    return FreeRunErrors(
        label=flight.label,
        window_s=used_s / len(flight.windows),
        normalised=normalised(flight.residual),
        axis_normalised=_by_axis(rms),
        rms_deg=_by_axis(np.rad2deg(rms * flight.sigma_rad)),
        correlation=_by_axis(correlation),
        white={axis: bool(abs(value) < bound) for axis, value in zip(AXES, correlation, strict=True)},
        seconds_used=used_s,
    )


def validate(fit: Fit, flights: Sequence[Flight | Record]) -> Fit:
    """Apply a fit to held-out flights, with its shared parameters fixed.

    Only the quantities that differ from flight to flight are estimated: the initial states of the windows,
    and the encoders' zeros, which are set each time the board starts.

    Parameters
    ----------
    fit : Fit
        Estimates from other flights.
    flights : sequence of Flight or Record
        The held-out flights.

    Returns
    -------
    Fit
        The held-out flights with these parameters, for `check` and `trace`. The standard errors of the zeros
        do not include the effect of quantisation.
    """
    problem, vector = fit.problem, fit.problem.parameter_vector
    per_flight_priors = {
        parameter.quantity: parameter.prior for parameter in problem.free if parameter.record is not None
    }
    held_out = Problem(
        problem.model,
        problem.rig,
        flights,
        free=tuple(per_flight_priors),
        per_flight=tuple(per_flight_priors) or PER_FLIGHT,
        window_s=problem.grids.window_s,
        step_s=problem.grids.step_s,
        priors=per_flight_priors,
        values=vector.values_by_name | vector.shared_by_name(fit.theta),
        state_std=problem.state_std_by_name,
    )
    return solve(held_out, robust=False, scatter=False)


def _by_axis(values: Floats) -> dict[str, float]:
    """Return `values`, shape (3,), by the names of the axes."""
    return {axis: float(value) for axis, value in zip(AXES, values, strict=True)}
