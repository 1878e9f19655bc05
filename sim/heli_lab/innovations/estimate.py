"""Maximum likelihood in innovations form: parameters of a model and the weather, estimated together.

The Kalman filter of a linearised model (`linear.py`) under weather (`weather.py`) turns measured angles into
innovations, which are white where the model is right, also in closed loop. It is linear in what drives it:
derivatives by the parameters are filtered beside the measurement, and the parameters follow by weighted least
squares with the rig's priors. The weather's numbers maximise the same likelihood. After Kristensen, Madsen
and Jorgensen, Automatica 40 (2004) 225, and Ljung, System Identification, chapter 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from heli_lab.identify.functions import Floats
from heli_lab.innovations.bordered import inverse_bordered, solve_bordered
from heli_lab.innovations.course import Course
from heli_lab.innovations.filtered import Filtered, Innovations
from heli_lab.innovations.linear import Linear, ModelFunctions
from heli_lab.innovations.unknowns import Unknowns
from heli_lab.innovations.weather import Weather, maximise

_MAX_MOVES: Final = 15
_HALVINGS: Final = 4
_LEAST_GAIN: Final = 0.02
"""Share of the gain that derivatives promise that a move must bring."""
_FIRST_TURNS: Final = 2
_TURN_NATS: Final = 0.1
"""Gain of one more turn of parameters and weather below which the estimate counts as converged."""
_WEATHER_SHARE: Final = 0.05
"""Share of what the parameters' next move promises to which the weather is sought before it."""
_CONVERGED_NATS: Final = 0.02
"""Gain that one more move of the parameters may promise before the estimate counts as converged."""


@dataclass(frozen=True)
class Estimate:
    """Parameters and weather of largest posterior likelihood.

    Parameters
    ----------
    theta : ndarray (f,)
        Free parameters.
    covariance : ndarray (f, f)
        Their covariance.
    log_likelihood : float
        In nats, up to a constant that all models of the same courses share; priors included.
    converged : bool
        Whether the last move promised next to nothing.
    courses : tuple of Course
        The flights.
    functions : ModelFunctions
        The model's equations.
    """

    unknowns: Unknowns
    theta: Floats
    covariance: Floats
    log_likelihood: float
    weather: Weather
    converged: bool
    courses: tuple[Course, ...]
    functions: ModelFunctions

    def filtered(self) -> Filtered:
        """Linearise the model at `theta`; not kept, because of every flight it takes megabytes a minute."""
        return _linearised(self.unknowns, self.courses, self.functions, self.theta)

    def other_weather(self) -> Weather | None:
        """Look for the weather afresh with the parameters as they are; None where it is none that is likelier
        than what was found.
        """
        filtered = self.filtered()
        error = filtered.moved(np.zeros(len(self.theta)))
        other = estimate_weather(filtered, error, Weather.start())
        now, then = filtered.log_likelihoods([self.weather, other], error).sum(axis=1)
        return other if then > now + _TURN_NATS else None


def solve(unknowns: Unknowns, theta: Floats, innovations: Innovations) -> tuple[Floats, Floats, float]:
    """Solve for the move of the parameters that maximises the posterior.

    Parameters
    ----------
    unknowns : Unknowns
        Priors and bounds.
    theta : ndarray (f,)
        Parameters at which the model is linearised.

    Returns
    -------
    move : ndarray (f,)
        Within the bounds.
    covariance : ndarray (f, f)
        Of the parameters.
    value : float
        Logarithm of the posterior at `theta`, nats.
    """
    precision, per_flight = unknowns.std**-2.0, innovations.own
    offset = theta - unknowns.mean
    information = innovations.information() + np.diag(precision)
    gradient = innovations.score() - precision * offset
    value = innovations.log_likelihoods.sum() - 0.5 * (offset @ (precision * offset))
    low, high = unknowns.bounds
    move = np.zeros(len(theta))
    free = np.ones(len(theta), bool)
    for _ in range(len(theta) + 1):
        rest = gradient - information[:, ~free] @ move[~free]
        # What is held meets nothing, and moves by nothing.
        held = np.where(free[:, None] & free, information, np.diag(np.where(free, 0.0, 1.0)))
        move[free] = solve_bordered(held, np.where(free, rest, 0.0), per_flight)[free]
        over = free & ((theta + move < low) | (theta + move > high))
        if not over.any():
            break
        move[over] = (np.clip(theta + move, low, high) - theta)[over]
        free &= ~over
    covariance = inverse_bordered(information, per_flight)
    return move, covariance, float(value)


def estimate_weather(
    filtered: Filtered,
    error: Sequence[Sequence[tuple[Floats, Floats]]],
    start: Weather,
    enough_nats: float = _CONVERGED_NATS,
    known: Floats | None = None,
) -> Weather:
    """Maximise the likelihood of the innovations of an `error`, as `Filtered.moved` gives it, over the
    weather, from `start` on, whose log-likelihoods by axis may be `known`, shape (3,), to `enough_nats`.
    """
    return maximise(lambda weathers: filtered.log_likelihoods(weathers, error), start, enough_nats, known)


def _linearised(
    unknowns: Unknowns, courses: Sequence[Course], functions: ModelFunctions, theta: Floats
) -> Filtered:
    linears = [
        Linear(course, functions, unknowns.parameters(theta, index)) for index, course in enumerate(courses)
    ]
    return Filtered(linears, unknowns.columns, len(theta))


@dataclass
class _Point:
    """Parameters and weather, and the model linearised there, unless it was let go: of ten minutes it takes
    100 MB.
    """

    theta: Floats
    weather: Weather
    filtered: Filtered | None
    move: Floats
    covariance: Floats
    value: float
    promised: float
    by_axis: Floats
    """Log-likelihood of each axis' innovations, nats."""


class _Ascent:
    """Parameters by Gauss-Newton steps and weather by Newton steps in turn, neither ever downhill."""

    def __init__(self, unknowns: Unknowns, courses: Sequence[Course], functions: ModelFunctions) -> None:
        self.unknowns, self.courses, self.functions = unknowns, courses, functions

    def linearised(self, theta: Floats) -> Filtered:
        return _linearised(self.unknowns, self.courses, self.functions, theta)

    def at(self, theta: Floats, weather: Weather, filtered: Filtered) -> _Point:
        innovations = filtered.innovations_by_flight(weather)
        move, covariance, value = solve(self.unknowns, theta, innovations)
        squares = sum(float(residual @ residual) for residual in innovations.left(move))
        offset = theta + move - self.unknowns.mean
        prior = offset @ (self.unknowns.std**-2.0 * offset)
        after = -0.5 * (squares + prior + innovations.log_variances.sum())
        promised = float(after) - value
        return _Point(
            theta, weather, filtered, move, covariance, value, promised, innovations.log_likelihoods
        )

    def begun(self, theta: Floats, weather: Weather | None) -> _Point:
        """Where to begin; without weather it is estimated at once, parameters following to first order."""
        filtered = self.linearised(theta)
        point = self.at(theta, weather or Weather.start(), filtered)
        if weather is None:
            for _ in range(_FIRST_TURNS):
                weather_ = estimate_weather(filtered, filtered.moved(point.move), point.weather)
                point = self.at(theta, weather_, filtered)
        return point

    def moved(self, point: _Point) -> _Point | None:
        """Move the parameters, half as far where that leads down; None where nothing leads up. The point lets
        go of the model linearised there: two at once are hardly ever needed.
        """
        point.filtered = None
        share = 1.0
        for _ in range(_HALVINGS):
            theta = point.theta + share * point.move
            after = self.at(theta, point.weather, self.linearised(theta))
            if after.value > point.value + _LEAST_GAIN * share * point.promised:
                return after
            after.filtered = None
            share *= 0.3
        return None

    def weathered(self, point: _Point, enough_nats: float) -> _Point:
        """The weather as likely as it can be, to `enough_nats`."""
        filtered = point.filtered or self.linearised(point.theta)
        error = filtered.moved(np.zeros(len(point.theta)))
        weather = estimate_weather(filtered, error, point.weather, enough_nats, point.by_axis)
        return self.at(point.theta, weather, filtered)

    def run(self, point: _Point) -> tuple[_Point, bool]:
        last = -np.inf
        for _ in range(_MAX_MOVES):
            if point.promised > _CONVERGED_NATS:
                after = self.moved(point)
                if after is None:
                    return self.weathered(point, _CONVERGED_NATS), False
                point = after
            # While parameters still move far the weather follows roughly; then to the end.
            point = self.weathered(point, max(_CONVERGED_NATS, _WEATHER_SHARE * point.promised))
            if point.promised < _CONVERGED_NATS and point.value - last < _TURN_NATS:
                return point, True
            last = point.value
        return point, False


def estimate(
    unknowns: Unknowns,
    courses: Sequence[Course],
    functions: ModelFunctions,
    theta: Floats,
    weather: Weather | None = None,
) -> Estimate:
    """Estimate parameters and weather.

    Parameters
    ----------
    unknowns : Unknowns
        Free parameters of the model in these flights.
    courses : sequence of Course
        The flights.
    functions : ModelFunctions
        The model's equations, with derivatives by `unknowns.quantities`.
    theta : ndarray (f,)
        Parameters to start from.
    weather : Weather, optional
        Weather to start from; what comes out is never less likely than this and `theta`.
    """
    ascent = _Ascent(unknowns, courses, functions)
    point, converged = ascent.run(ascent.begun(theta, weather))
    return Estimate(
        unknowns,
        point.theta,
        point.covariance,
        point.value,
        point.weather,
        converged,
        tuple(courses),
        functions,
    )
