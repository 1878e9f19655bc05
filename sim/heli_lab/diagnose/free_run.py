"""A model judged on another flight: the flight's own constants from its beginning, the rest predicted.

Encoders are zeroed anew and cables lie anew in each flight, so zeros and one constant torque an axis are
estimated from the first seconds, in free runs as `identify` fits them; nothing else is. The rest is predicted
over windows of 2 s and over their halves and quarters: the same samples at each horizon.

Each window starts from the state that fits it best. That is no forecast: rates are not measured, and a state
estimated from the past alone carries the model's error over that past into the horizon. On measured flights
such forecasts, from the second before, are off by two to seventeen times as much before and after an
extension. Fitted, what is left is what the model gets wrong within the horizon.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.rig import Prior, Rig

from heli_lab.diagnose.thresholds import CALIBRATE_SHARE, CALIBRATE_s
from heli_lab.errors import IdentifyError
from heli_lab.identify import Fit, Problem, Record, solve, trace
from heli_lab.identify.free import flight_constants
from heli_lab.identify.thresholds import LEAST_SEGMENT_S

HORIZONS: Final[Mapping[str, int]] = {"0.5": 4, "1": 2, "2": 1}
"""Horizons, s, as the JSON names them, and the parts that a window of 2 s is divided into for each."""

_WINDOW_s: Final = 2.0
_STEP_s: Final = 0.004
"""Longest step: with 10 ms, effects that change within milliseconds, such as dry friction, fail."""


@dataclass(frozen=True)
class WindowErrors:
    """Squared errors of free runs over one horizon, summed over the windows of 2 s, whose parts begin anew.
    The windows are the same at all horizons: a bootstrap resamples what is nearly independent.

    Parameters
    ----------
    squares_rad2 : ndarray (w, 3)
        Sum of squared errors of each axis.
    rows : ndarray (w,)
        Number of samples.
    """

    squares_rad2: Floats
    rows: Floats

    @property
    def rms_deg(self) -> Floats:
        """Root mean square error of each axis, shape (3,)."""
        result: Floats = np.rad2deg(np.sqrt(self.squares_rad2.sum(axis=0) / self.rows.sum()))
        return result


@dataclass(frozen=True)
class FreeRun:
    """What a model predicts of a flight after its beginning.

    Parameters
    ----------
    label : str
        The flight.
    calibrated_s, evaluated_s : float
        Free flight in each part.
    constants : Mapping[str, (float, float)]
        The flight's own constants: value and standard error, in the rig file's units; empty where nothing was
        calibrated.
    priors : Mapping[str, Prior]
        Their priors.
    errors : Mapping[str, WindowErrors]
        By horizon, as in `HORIZONS`.
    fit : Fit
        The judged part in windows of 2 s, for `heli_lab.identify.trace`; only its states were fitted.
    """

    label: str
    calibrated_s: float
    evaluated_s: float
    constants: Mapping[str, tuple[float, float]]
    priors: Mapping[str, Prior]
    errors: Mapping[str, WindowErrors]
    fit: Fit


def free_run(
    model: Model,
    rig: Rig,
    values: Mapping[str, float],
    record: Record,
    calibrate_s: float = CALIBRATE_s,
    threads: int | None = None,
) -> FreeRun:
    """Calibrate a flight's constants on its beginning, and predict the rest.

    Parameters
    ----------
    model : Model
        The model, with its effects.
    rig : Rig
        Numbers that `values` does not name, and the tolerances behind the constants' priors.
    values : Mapping[str, float]
        Parameters of the model by name, as fitted to other flights; those of the constants are the means of
        their priors, see `flight_constants`.
    record : Record
        The flight.
    calibrate_s : float
        Free flight to calibrate on; 0 judges the whole flight with the values as they are.
    threads : int, optional
        Threads of the predictions; see `Problem`.
    """
    names = [quantity.name for quantity in model.parameters]
    known = {**dict(zip(names, map(float, model.parameter_values(rig)), strict=True)), **values}
    first, rest = _split(record, calibrate_s)
    priors = flight_constants(model, rig, known)
    calibrated: dict[str, tuple[float, float]] = {}
    if first.segments:
        fit = solve(
            _problem(model, rig, known, first, priors, threads), robust=False, scatter=False, warm_start=True
        )
        calibrated = {name: (value, fit.std[name]) for name, value in fit.values.items()}
        known |= fit.values
    # Bounds without room between them: with the constants among the free, their kernel serves again.
    held = {name: Prior(known[name], prior.std, known[name], known[name]) for name, prior in priors.items()}
    problem = _problem(model, rig, known, rest, held, threads)
    windows = [rows for _, rows in problem.windows(0)]
    fits = {
        key: solve(problem.with_split_windows(parts), robust=False, scatter=False, warm_start=True)
        for key, parts in HORIZONS.items()
    }
    return FreeRun(
        record.label,
        first.used_s,
        rest.used_s,
        calibrated,
        priors if calibrated else {},
        {key: _errors(fit, windows) for key, fit in fits.items()},
        fits["2"],
    )


def free_runs(
    fit: Fit, validation: Sequence[Record], calibrate_s: float | None = None
) -> tuple[FreeRun, ...]:
    """Predict other flights with the parameters of a `fit`, each calibrated on what `calibration_s` allows of
    `calibrate_s`; without any `validation` flights those that were fitted, with their own constants.
    """
    problem = fit.problem
    names = [quantity.name for quantity in problem.model.parameters]
    parameters = [problem.parameters(fit.theta, index) for index in range(len(problem.records))]
    if not validation:
        return tuple(
            free_run(
                problem.model,
                problem.rig,
                dict(zip(names, map(float, flight_values), strict=True)),
                record,
                0.0,
                problem.threads,
            )
            for flight_values, record in zip(parameters, problem.records, strict=True)
        )
    # What each of several flights has of its own, another one has on average.
    values = dict(zip(names, map(float, np.mean(parameters, axis=0)), strict=True))
    return tuple(
        free_run(
            problem.model, problem.rig, values, record, calibration_s(record, calibrate_s), problem.threads
        )
        for record in validation
    )


def calibration_s(record: Record, asked_s: float | None = None) -> float:
    """Seconds of a flight to calibrate on: what is `asked_s` for, or `CALIBRATE_s`, and at most
    `CALIBRATE_SHARE` of its free flight.

    Raises
    ------
    IdentifyError
        When less than nothing is asked for, or more than the flight leaves.
    """
    most_s = CALIBRATE_SHARE * record.used_s
    if asked_s is None:
        return min(CALIBRATE_s, most_s)
    if not asked_s >= 0.0:
        raise IdentifyError(f"{asked_s:g} s to calibrate on", "give 0 or more to --calibrate")
    if asked_s > record.used_s - LEAST_SEGMENT_S:
        raise IdentifyError(
            f"{asked_s:g} s to calibrate on leave nothing of the {record.used_s:.3g} s of free flight in "
            f"{record.label}",
            f"give {most_s:.2g} or less to --calibrate, or a longer flight to --validate",
        )
    return min(asked_s, most_s)


def _problem(
    model: Model,
    rig: Rig,
    values: Mapping[str, float],
    record: Record,
    priors: Mapping[str, Prior],
    threads: int | None,
) -> Problem:
    return Problem(
        model,
        rig,
        [record],
        free=tuple(priors),
        per_flight=tuple(priors),
        window_s=_WINDOW_s,
        step_s=_STEP_s,
        priors=priors,
        values=values,
        threads=threads,
    )


def _split(record: Record, seconds: float) -> tuple[Record, Record]:
    """The first seconds of free flight, and the rest; scraps beside longer pieces of the rest are dropped."""
    remaining = round(seconds / record.step_s)
    first, rest = [], []
    for start, stop in record.segments:
        cut = min(stop, start + remaining)
        remaining -= cut - start
        first += [(start, cut)] if cut > start else []
        rest += [(cut, stop)] if stop > cut else []
    least = round(LEAST_SEGMENT_S / record.step_s)
    rest = [(start, stop) for start, stop in rest if stop - start >= least] or rest
    return replace(record, segments=tuple(first)), replace(record, segments=tuple(rest))


def _errors(fit: Fit, windows: Sequence[int]) -> WindowErrors:
    """Squared errors, summed over windows of these many rows, whatever parts they were run in."""
    seen = trace(fit)
    squares = (seen.residual * seen.sigma_rad) ** 2
    first = np.concatenate(([0], np.cumsum(windows)[:-1]))
    return WindowErrors(np.add.reduceat(squares, first, axis=0), np.array(windows, float))
