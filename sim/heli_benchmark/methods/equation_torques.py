"""Torques of an unlisted cause along the validation flights, as keys of an answer."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model import MultibodyModel
from heli_sim.model.parts import AXES

from heli_benchmark.methods.motion import AccelerationModel, SmoothedFlight
from heli_benchmark.methods.terms import ResidualRegression, Term, shapes_of
from heli_benchmark.task import AxisSeries, BenchmarkCase
from heli_benchmark.task.axis_series import flight_name, series_content

_STEP_s: Final = 0.02
"""Step of the torques; the smoothing leaves nothing that is faster."""


def torques_of_terms(
    case: BenchmarkCase, regression: ResidualRegression, terms: Sequence[Term]
) -> dict[str, Any]:
    """Return the equation of the terms of unlisted causes in a fit, and its torques."""
    coefficients = regression.fit(terms).coefficients
    # A term of an unlisted cause has one column, the last of its slice; other terms may have several.
    ends = np.cumsum([term.columns.shape[1] for term in terms])
    unlisted = [
        (term, float(coefficients[end - 1])) for term, end in zip(terms, ends, strict=True) if term.shape
    ]
    if not unlisted:
        return {}

    def torque_Nm(motion: SmoothedFlight) -> Floats:
        """Sum the unlisted terms along a flight, shape (n, 3)."""
        shapes = shapes_of(motion)
        torques = np.zeros((len(motion.t_s), 3))
        for term, size in unlisted:
            torques[:, AXES.index(term.axis)] += size * shapes[term.shape]
        return torques

    text = "; ".join(f"{term.axis} torque: {size:.3g} {term.shape}" for term, size in unlisted)
    return {"equation": text, "equation_torques": _torques_along_flights(case, torque_Nm)}


def torques_of_accelerations(
    case: BenchmarkCase, regression: ResidualRegression, equations: Mapping[int, Callable[[Floats], Floats]]
) -> dict[str, Any]:
    """Return the torques of equations that predict the residual accelerations of a regression."""
    scales, model = regression.standardisation, AccelerationModel(MultibodyModel(), case.rig)

    def torque_Nm(motion: SmoothedFlight) -> Floats:
        """Convert the predicted accelerations to torques by the inertia of the model, shape (n, 3)."""
        features = (motion.signals - scales.feature_mean) / scales.feature_std
        accelerations = np.zeros((len(motion.t_s), 3))
        for axis, equation in equations.items():
            accelerations[:, axis] = scales.residual_std[axis] * np.asarray(equation(features)).ravel()
        return np.asarray(np.linalg.solve(model.by_torques(motion), accelerations[:, :, None])[:, :, 0])

    return {"equation_torques": _torques_along_flights(case, torque_Nm)} if equations else {}


def _torques_along_flights(
    case: BenchmarkCase, torque_Nm: Callable[[SmoothedFlight], Floats]
) -> dict[str, Any]:
    """Return the torques along each validation flight as the content of an answer file."""
    series = {}
    for number, flight in enumerate(case.validation):
        motion = SmoothedFlight(flight)
        step_s = float(motion.t_s[-1] - motion.t_s[0]) / (len(motion.t_s) - 1)
        rows = slice(None, None, max(1, round(_STEP_s / step_s)))
        torques = AxisSeries(flight.t_s[0] + motion.t_s[rows], torque_Nm(motion)[rows])
        # Outside of the training motions, an equation can overflow.
        if np.isfinite(torques.values).all():
            series[flight_name(number)] = torques
    return series_content(series, "Nm")
