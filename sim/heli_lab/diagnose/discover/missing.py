"""The term that a model lacks without a cause, as the flights show it, and the contribution of the cause.

A cause is removed from the model, and every other parameter stays. A smoother then estimates the missing
torque as a disturbance. The equation of the cause has no part in that estimate: if the two agree, the
flights confirm the equation.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Prior

from heli_lab.diagnose.search import (
    KNOTS,
    QUANTITIES,
    Candidate,
    Screening,
    SplineTerm,
    bspline_basis,
    coefficient_std,
    knot_span,
    quantity_values,
    spline_term,
)
from heli_lab.diagnose.thresholds import CURVE_SHARE
from heli_lab.diagnose.wording import SHOWN, quantity_in_words
from heli_lab.estimation import AlongTrajectory, Estimate, LinearisedFlight, Trajectory, smoothed_disturbances
from heli_lab.estimation.estimate import estimate_disturbances
from heli_lab.identify.flight_model import RigParameters, model_functions

TIME: Final = "time of the flight"
"""Quantity over which a term is drawn that follows no single quantity."""
_LAGS_s: Final = (0.03, 0.06, 0.1, 0.15)
"""Time constants of lags that measure how fast a thrust changes: those of rotors."""
_SHOWN_PLACES: Final = 15
"""Points of the curve of an angle: two between knots."""
_WIDE_rad: Final = 0.3
"""Prior standard deviation of that curve's coefficients: wide, so that no prior biases the points to zero."""
_NUMBER: Final = 98
"""A number above those of a model's own spline terms, so that parameter names differ."""


@dataclass(frozen=True)
class MissingTerm:
    """Missing torque or angle on one axis at each measurement of the filter, in display units.

    The mean of a torque is subtracted, because a constant torque is a parameter of every model.

    Parameters
    ----------
    id : str
        The cause: an effect's id, or ``spline:CHANNEL:QUANTITY``.
    what, unit : str
        ``torque`` in mN m, or ``angle`` in degrees.
    axis : str
        ``elevation``, ``pitch`` or ``travel``.
    on, on_unit : str
        Quantity that the cause depends on, in words, and its display unit; `TIME` if the cause depends on
        several quantities.
    quantity : ndarray (n,)
        Values of the quantity.
    missing, std : ndarray (n,)
        Torque or angle that the model lacks without the cause, and its standard error.
    remaining : ndarray (n,)
        Torque or angle that the model lacks with the cause.
    contribution : ndarray (n,)
        Torque or angle by the equation of the cause.
    """

    id: str
    what: str
    unit: str
    axis: str
    on: str
    on_unit: str
    quantity: Floats
    missing: Floats
    std: Floats
    remaining: Floats
    contribution: Floats

    @property
    def share(self) -> float:
        """Share of the variance of what was missing that the contribution explains, at most 1."""
        return 1.0 - float(np.var(self.missing - self.contribution)) / max(
            float(np.var(self.missing)), 1e-300
        )


def missing_term(estimate: Estimate, cause: Candidate) -> MissingTerm:
    """Compute what a model lacks without a cause.

    Parameters
    ----------
    estimate : Estimate
        The model with the cause.
    cause : Candidate
        The effect or spline term that is removed.
    """
    less = _without(estimate, cause.effect.name)
    with_, without = estimate.filtered().linearised_flights, less.filtered().linearised_flights
    torque = [_contributed_torque(*pair) for pair in zip(with_, without, strict=True)]
    all_torques = np.concatenate(torque)
    if not all_torques.any():
        return _missing_angle(estimate, less, cause)
    blocks = [_Blocks(linear) for linear in without]
    equation = np.concatenate([block.mean(values) for block, values in zip(blocks, torque, strict=True)])
    t_s, missing, std = _smoothed_torque(less)
    _, remaining, _ = _smoothed_torque(estimate)
    # With its mean, the elevation torque of a thrust curve hides the pitch torque of its lag.
    axis = int(np.argmax(all_torques.std(axis=0) / ((missing - equation).std(axis=0) + 1e-9)))
    places = [
        {name: block.mean(value) for name, value in _quantities(linear).items()}
        for block, linear in zip(blocks, with_, strict=True)
    ]
    place, on, on_unit = t_s, TIME, "s"
    quantity = _best_quantity(places, equation[:, axis], cause)
    if quantity is not None:
        on_factor, on_unit = SHOWN.get(_unit(quantity), (1.0, _unit(quantity)))
        place = on_factor * np.concatenate([values[quantity] for values in places])
        on = quantity_in_words(quantity)
    factor, unit = SHOWN["N m"]
    return MissingTerm(
        cause.id,
        "torque",
        unit,
        AXES[axis],
        on,
        on_unit,
        place,
        factor * _centred(missing[:, axis]),
        factor * std[:, axis],
        factor * _centred(remaining[:, axis]),
        factor * _centred(equation[:, axis]),
    )


def _centred(values: Floats) -> Floats:
    centred: Floats = values - values.mean()
    return centred


class _Blocks:
    """Steps of a flight, grouped by measurements of the filter."""

    def __init__(self, linear: LinearisedFlight) -> None:
        firsts = np.concatenate([block.rows for block in linear.blocks])
        self._rows = firsts[:, None] + np.arange(linear.block)

    def mean(self, value: Floats) -> Floats:
        """Mean over each measurement of values (n, ...) of the steps."""
        result: Floats = value[self._rows].mean(axis=1)
        return result


def _without(estimate: Estimate, name: str) -> Estimate:
    """The same model without one of its effects: all other parameters stay, disturbances are estimated
    again.
    """
    full = estimate.parameter_vector
    model = type(full.model)(tuple(effect for effect in full.model.effects if effect.name != name))
    records = [reference.record for reference in estimate.references]
    parameter_vector = RigParameters(model, full.rig, records)
    values = dict(zip(full.names, estimate.theta, strict=True))
    start = zip(parameter_vector.names, parameter_vector.start, strict=True)
    theta = np.array([values.get(parameter, value) for parameter, value in start])
    functions = model_functions(model, parameter_vector.quantities)
    less = replace(
        estimate,
        parameter_vector=parameter_vector,
        theta=theta,
        covariance=np.diag(parameter_vector.std**2),
        functions=functions,
    )
    filtered = less.filtered()
    disturbances = estimate_disturbances(filtered, filtered.perturbed_residual(), estimate.disturbances)
    return replace(less, disturbances=disturbances)


def _held(estimate: Estimate, names: Iterable[str]) -> Estimate:
    """The same estimate with the parameters `names` no longer free."""
    full = estimate.parameter_vector
    values = full.by_name(estimate.theta)
    known = {name: values[name] for name in names if name in values}
    records = [reference.record for reference in estimate.references]
    parameter_vector = RigParameters(full.model, full.rig, records, fixed=known)
    return replace(
        estimate,
        parameter_vector=parameter_vector,
        theta=np.array([values[parameter] for parameter in parameter_vector.names]),
        covariance=np.diag(parameter_vector.std**2),
        functions=model_functions(full.model, parameter_vector.quantities),
    )


def _coefficients(screening: Screening, candidate: Candidate) -> tuple[Floats, Floats]:
    """Coefficients of a spline term by a score test, and their covariance."""
    ((information, score),) = screening.spline_information([candidate])
    precision = np.diag(coefficient_std(candidate) ** -2.0)
    covariance = np.asarray(np.linalg.inv(information + precision), float)
    return covariance @ score, covariance


def _smoothed_torque(estimate: Estimate) -> tuple[Floats, Floats, Floats]:
    """Times (k,) of all flights, smoothed disturbance torques about the three axes, (k, 3), and their
    standard errors.
    """
    smoothed = smoothed_disturbances(estimate.filtered(), estimate.disturbances)
    times, values, errors = (np.concatenate(parts) for parts in zip(*smoothed, strict=True))
    return times, values, errors


def _contributed_torque(with_: LinearisedFlight, without: LinearisedFlight) -> Floats:
    """Torque about each axis that is equivalent to an effect, along the trajectory, shape (n, 3)."""
    change = _accelerations(with_) - _accelerations(without)
    return without.disturbance_for(change)


def _accelerations(linear: LinearisedFlight) -> Floats:
    return _along(linear.model.source, linear.trajectory, lambda *at: linear.model.source.dynamics(*at)[3:6])


def _along(model: Model, trajectory: Trajectory, of: Callable[..., ca.SX]) -> Floats:
    x, u = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2)
    t, p = ca.SX.sym("t"), ca.SX.sym("p", len(model.parameters))
    function = ca.Function("along", [x, u, t, p], [ca.densify(of(x, u, p, t))])
    (values,) = AlongTrajectory(function)(trajectory)
    return np.ascontiguousarray(values[:, :, 0])


def _quantities(linear: LinearisedFlight) -> dict[str, Floats]:
    """Quantities that a cause may depend on, shape (n,), by name: those of spline terms, and how fast the
    thrust changes, on which lags and delays depend.
    """
    values = quantity_values(linear.model.source, linear.trajectory)
    for name, time_s in itertools.product(("thrust", "thrust_difference"), _LAGS_s):
        late = _lagged(values[name], linear.trajectory.step_s / time_s)
        values[f"change of {name} within {time_s:g} s"] = values[name] - late
    return values


def _lagged(values: Floats, step: float) -> Floats:
    """Values (n,) behind a first-order lag that starts at rest; `step` is a share of its time constant.
    In plain Python, because the import of scipy.signal takes longer than this for an hour of flight.
    """
    share = -math.expm1(-step)
    lagged = itertools.accumulate(values.tolist(), lambda held, value: held + share * (value - held))
    return np.fromiter(lagged, float)


def _best_quantity(places: Sequence[Mapping[str, Floats]], equation: Floats, cause: Candidate) -> str | None:
    """Name of the quantity over which a contribution is best drawn; None if it follows no single quantity."""
    if isinstance(cause.effect, SplineTerm):
        return cause.effect.on
    together = {name: np.concatenate([place[name] for place in places]) for name in places[0]}
    followed = {name: _followed(value, equation) for name, value in together.items()}
    name = max(followed, key=lambda candidate: followed[candidate])
    return name if followed[name] >= CURVE_SHARE else None


def _unit(name: str) -> str:
    return "N" if name.startswith("change of ") else QUANTITIES[name][1]


def _followed(place: Floats, equation: Floats) -> float:
    """Share of a contribution's variance that a smooth curve of one quantity follows."""
    low, step = knot_span(place)
    weights = bspline_basis(place, low, step)
    fitted = weights @ np.linalg.lstsq(weights, equation, rcond=None)[0]
    return 1.0 - float(np.var(equation - fitted)) / max(float(np.var(equation)), 1e-300)


def _missing_angle(estimate: Estimate, less: Estimate, cause: Candidate) -> MissingTerm:
    """The same for an effect on a measured angle, in whose place a smooth curve is estimated."""
    # The effect's parameters are held: free, they would replace what the curve is to show.
    screenings = Screening(less), Screening(_held(estimate, cause.effect.values))
    linearised_flights = screenings[1].filtered.linearised_flights
    equations = [
        _along(linear.model.source, linear.nodes, linear.model.source.measurement)
        - _along(other.model.source, other.nodes, other.model.source.measurement)
        for linear, other in zip(linearised_flights, screenings[0].filtered.linearised_flights, strict=True)
    ]
    equation = np.concatenate(equations)
    axis = int(np.argmax(equation.std(axis=0)))
    places = [quantity_values(linear.model.source, linear.nodes) for linear in linearised_flights]
    name = _best_quantity(places, equation[:, axis], cause) or AXES[axis]
    place = np.concatenate([quantities[name] for quantities in places])
    low, step = knot_span(place)
    term = spline_term(f"measurement.{AXES[axis]}", name, low, step, _NUMBER)
    term = replace(term, priors={prior_name: Prior(0.0, _WIDE_rad) for prior_name in term.priors})
    candidate = Candidate(f"spline:{term.channel}:{name}", term, tuple(term.priors))
    shown = np.linspace(low, low + step * (KNOTS - 3), _SHOWN_PLACES)
    weights = bspline_basis(shown, low, step)
    weights -= weights.mean(axis=0)
    (without, covariance), (remaining, _) = (_coefficients(screening, candidate) for screening in screenings)
    std = np.sqrt(np.einsum("ni,ij,nj->n", weights, covariance, weights))
    drawn = weights @ np.linalg.lstsq(bspline_basis(place, low, step), equation[:, axis], rcond=None)[0]
    factor, unit = SHOWN["rad"]
    on_factor, on_unit = SHOWN.get(QUANTITIES[name][1], (1.0, QUANTITIES[name][1]))
    return MissingTerm(
        cause.id,
        "angle",
        unit,
        AXES[axis],
        quantity_in_words(name),
        on_unit,
        on_factor * shown,
        factor * (weights @ without),
        factor * std,
        factor * (weights @ remaining),
        factor * drawn,
    )
