"""Steps to the maximum of a quadratic posterior: bounded, damped, and for the unknowns of many flights.

Unknowns of different flights are not coupled directly: the matrix is block diagonal except for a border (an
arrowhead matrix). Each block is eliminated separately, so that a solution costs one small system per flight,
not the cube of the number of all unknowns.

`minimise` is the Levenberg-Marquardt method with control of the damping (Nocedal and Wright, section 10.3).
A problem may have further unknowns next to its parameters, such as initial states. It eliminates them from
its normal equations, so that only steps of the parameters are seen here.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Generic, NamedTuple, Protocol, TypeVar

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers

from heli_lab.fit.parameters import ParameterVector

NO_BLOCKS: Final = np.zeros((0, 0), np.int64)
"""Value of `per_flight` if no unknown belongs to a single flight."""


def per_flight_columns(columns: Sequence[Integers], size: int) -> Integers:
    """Find the unknowns that only one flight depends on. Returns shape (flights, k)."""
    flight_count = np.zeros(size, int)
    for unknowns in columns:
        flight_count[unknowns] += 1
    if len(columns) < 2:
        return np.zeros((len(columns), 0), np.int64)
    return np.array([unknowns[flight_count[unknowns] == 1] for unknowns in columns], np.int64)


def solve_arrowhead(matrix: Floats, right: Floats, per_flight: Integers) -> Floats:
    """Solve a positive definite arrowhead system. Shapes: `matrix` (f, f), `right` (f,), `per_flight`
    (flights, k); returns (f,).
    """
    columns = right[:, None] if right.ndim == 1 else right
    reduced = _eliminate_per_flight(matrix, per_flight)
    solution = np.empty(columns.shape)
    flight_columns = columns[per_flight]
    without_shared = np.linalg.solve(reduced.blocks, flight_columns) if per_flight.size else flight_columns
    # Gaussian elimination: the shared unknowns first, then those of each flight.
    reduced_right = columns[reduced.shared] - np.einsum("nks,nkr->sr", reduced.gain, flight_columns)
    solution[reduced.shared] = np.linalg.solve(reduced.complement, reduced_right)
    solution[per_flight] = without_shared - reduced.gain @ solution[reduced.shared]
    return solution[:, 0] if right.ndim == 1 else solution


def invert_arrowhead(matrix: Floats, per_flight: Integers) -> Floats:
    """Invert a positive definite arrowhead matrix; return the full inverse, shape (f, f). Shapes: `matrix`
    (f, f), `per_flight` (flights, k).
    """
    shared, gain, complement, blocks = _eliminate_per_flight(matrix, per_flight)
    inverse = np.empty(matrix.shape)
    # The inverse of the Schur complement is the inverse's block of the shared unknowns.
    shared_inverse = np.linalg.inv(complement)
    inverse[np.ix_(shared, shared)] = shared_inverse
    if per_flight.size:
        # Block inversion, with the unknowns of all flights in one list.
        flight_unknowns, stacked_gain = per_flight.ravel(), gain.reshape(per_flight.size, len(shared))
        product = stacked_gain @ shared_inverse
        inverse[np.ix_(flight_unknowns, shared)] = -product
        inverse[np.ix_(shared, flight_unknowns)] = -product.T
        inverse[np.ix_(flight_unknowns, flight_unknowns)] = product @ stacked_gain.T
        inverse[per_flight[:, :, None], per_flight[:, None, :]] += np.linalg.inv(blocks)
    return 0.5 * (inverse + inverse.T)


class _ReducedMatrix(NamedTuple):
    """An arrowhead matrix from which the unknowns of single flights are eliminated."""

    shared: Integers  # (s,): Unknowns that all flights share
    gain: Floats  # (flights, k, s): Inverse of each flight's block times its border with the shared unknowns
    complement: Floats  # (s, s): Schur complement, the matrix of the shared unknowns alone
    blocks: Floats  # (flights, k, k): Matrix of each flight's unknowns


def _eliminate_per_flight(matrix: Floats, per_flight: Integers) -> _ReducedMatrix:
    """Eliminate the unknowns of single flights. Shapes: `matrix` (f, f), `per_flight` (flights, k)."""
    shared = np.setdiff1d(np.arange(len(matrix)), per_flight.ravel())
    blocks = matrix[per_flight[:, :, None], per_flight[:, None, :]]
    border = matrix[per_flight[:, :, None], shared[None, None, :]]
    gain = border
    if per_flight.size:
        gain = np.asarray(np.linalg.solve(blocks, border), float)
    complement: Floats = matrix[np.ix_(shared, shared)] - np.einsum("nks,nkt->st", border, gain)
    return _ReducedMatrix(shared, gain, complement, blocks)


_ROUNDING: Final = 1e-12
"""Share of the largest gain of any single unknown. If releasing an unknown gains less, the gain is
rounding."""


def bounded_solve(
    matrix: Floats, right: Floats, low: Floats, high: Floats, per_flight: Integers = NO_BLOCKS
) -> Floats:
    """Minimise xᵀ matrix x / 2 - rightᵀ x within bounds, for a positive definite matrix. Shapes: `matrix` (f,
    f), `right` (f,), `low, high` (f,), `per_flight` (flights, k); returns (f,).
    """
    # First, all unknowns that would leave their bounds are fixed on them, until none would leave. Then
    # unknowns whose gradient points inside are released one by one (BVLS: Stark and Parker, Comput. Stat. 10
    # (1995) 129).

    def minimum(x: Floats, free: Booleans) -> Floats:
        """Minimise over the `free` unknowns; the others stay at `x`."""
        reduced_right = np.where(free, right - matrix[:, ~free] @ x[~free], 0.0)
        # Rows and columns of the identity replace those of the fixed unknowns, so that the size stays the
        # same.
        decoupled = np.where(free[:, None] & free, matrix, np.diag(np.where(free, 0.0, 1.0)))
        return np.where(free, solve_arrowhead(decoupled, reduced_right, per_flight), x)

    # First estimate: minimise, clip to the bounds, and fix what was clipped, until nothing is clipped.
    x, free = np.zeros(len(right)), np.ones(len(right), bool)
    while free.any():
        target = minimum(x, free)
        x = np.clip(target, low, high)
        if np.array_equal(x, target):
            break
        free &= x == target
    # Then release fixed unknowns one by one, as long as the quadratic decreases towards the inside.
    curvature = np.diag(matrix)
    # Each release reduces the quadratic, so that few are needed; the limit ends a cycle of rounding errors.
    for _ in range(3 * len(right)):
        descent = right - matrix @ x
        points_inside = np.where(x <= low, descent > 0.0, descent < 0.0)
        releasable = ~free & (low < high) & points_inside
        # Twice the decrease if one unknown moves alone to its minimum.
        gain = np.where(releasable, descent**2 / curvature, 0.0)
        if not np.any(gain > _ROUNDING * np.max(right**2 / curvature)):
            break
        free[gain.argmax()] = True
        target = minimum(x, free)
        while np.any(outside := (target < low) | (target > high)):
            # Move towards the target up to the first bound on the way, and fix the unknowns that reach it.
            bound = np.where(target > high, high, low)
            share = (bound[outside] - x[outside]) / (target[outside] - x[outside])
            reached = np.flatnonzero(outside)[share <= share.min()]
            x = np.where(free, x + share.min() * (target - x), x)
            x[reached] = bound[reached]
            free[reached] = False
            target = minimum(x, free)
        x = target
    return x


@dataclass(frozen=True)
class PosteriorStep:
    """A step of the free parameters."""

    move: Floats  # (f,): The step; within the bounds
    covariance: Floats  # (f, f): Inverse of the damped information, priors included
    promised_nats: float
    """Increase of the log-posterior by the step, less the damping term, if the log-posterior is quadratic."""

    @property
    def std(self) -> Floats:
        """Standard errors of the free parameters, shape (f,)."""
        return np.sqrt(np.diag(self.covariance))


def posterior_step(
    parameter_vector: ParameterVector,
    theta: Floats,
    information: Floats,
    score: Floats,
    *,
    damping: float = 0.0,
    is_fixed: Booleans | None = None,
    per_flight: Integers = NO_BLOCKS,
) -> PosteriorStep:
    """Solve for the step to the maximum of the linearised posterior, within the bounds. Shapes: `theta`
    (f,), `information` (f, f), `score` (f,), `is_fixed` (f,), `per_flight` (flights, k).
    """
    precision = 1.0 / parameter_vector.std**2
    matrix = information + np.diag((1.0 + damping) * precision)
    gradient = score + precision * (parameter_vector.mean - theta)
    limits = [bound - theta for bound in parameter_vector.bounds]
    if is_fixed is not None:
        limits = [np.where(is_fixed, 0.0, limit) for limit in limits]
    low, high = limits
    move = bounded_solve(matrix, gradient, low, high, per_flight)
    promised_nats = float(move @ (gradient - 0.5 * (matrix @ move)))
    return PosteriorStep(move, invert_arrowhead(matrix, per_flight), promised_nats)


SMALL_STEP: Final = 0.02
"""A step is small if no parameter changes by more than this share of its standard error: the remaining error
is then well inside the standard error. An undamped step ends the search if it is predicted to reduce the cost
by less than the square of this."""
_MAX_DAMPING: Final = 1e8
"""Damping beyond which the search ends: steps are then smaller than any printed digit."""
_MIN_DAMPING: Final = 0.05
"""Damping below which it is set to 0, and Gauss-Newton steps are whole."""
_IDLE_GAIN: Final = 1e-3
"""If the cost falls by less than this share in each of two steps, the search has converged, even if the steps
are not small. Set on flights with backlash and dry friction, whose kinks keep steps from becoming small. A
single step that is small and gains less than this ends the search too."""
_CONVERGED_GAIN: Final = 1e-6
"""A lightly damped step that reduces the cost by less than this share ends the search."""


class HasCost(Protocol):
    """Values of all unknowns."""

    @property
    def cost(self) -> float:
        """Weighted sum of squares, priors included: minus twice the log-posterior up to a constant."""


IterateT = TypeVar("IterateT", bound=HasCost)


@dataclass(frozen=True)
class DampedStep(Generic[IterateT]):
    """Levenberg-Marquardt step, and the evaluation of the model after it."""

    move: Floats  # (f,): Step of the free parameters
    std: Floats  # (f,): Standard errors of the free parameters
    promised: float  # Predicted reduction of the cost by the step, as if the cost were quadratic
    evaluate: Callable[[], IterateT]  # Evaluates the model after the step, and returns the iterate there


class LeastSquares(Protocol[IterateT]):
    """A nonlinear least-squares problem."""

    def step(self, iterate: IterateT, damping: float) -> DampedStep[IterateT]:
        """Linearise the problem at an `iterate`, and solve for a step with this `damping`."""

    def with_states_refined(self, iterate: IterateT) -> IterateT | None:
        """Optimise the eliminated unknowns of an `iterate` alone; None if that gains too little."""

    def is_out_of_budget(self) -> bool:
        """Whether the search has used up its limits of time or evaluations."""


@dataclass(frozen=True)
class Minimum(Generic[IterateT]):
    """Result of a search."""

    iterate: IterateT  # The iterate of the lowest cost
    converged: bool
    """Whether a further step would be small, or gain little. False if the steps or the budget ran out first,
    or if the model diverges after every step."""
    damping: float  # Damping that a further step would have


class _Damping:
    """Damping of the next step, in a unit in which 1 is strong damping."""

    def __init__(self, value: float) -> None:
        self.value = value
        self._growth = 2.0

    def increase(self) -> None:
        """Increase the damping after a rejected step, by a larger factor each time."""
        self.value = max(1.0, self._growth * self.value)
        self._growth *= 2.0

    def decrease(self) -> None:
        """Decrease the damping after an accepted step: slowly if the step before it was rejected, because
        otherwise every second step is rejected.
        """
        self.value *= 0.2 if self._growth == 2.0 else 0.5
        self.value = self.value if self.value > _MIN_DAMPING else 0.0
        self._growth = 2.0


def minimise(
    problem: LeastSquares[IterateT],
    start: IterateT,
    *,
    damping: float,
    max_steps: int,
    idle_share: float = 1.0,
    on_step: Callable[[int, float], None] = lambda number, cost: None,
) -> Minimum[IterateT]:
    """Minimise the cost by Levenberg-Marquardt steps, until the steps are small or gain little."""
    iterate, control = start, _Damping(damping)
    has_refined_states, idle_steps = False, 0
    for number in range(max_steps):
        on_step(number, iterate.cost)
        step = problem.step(iterate, control.value)
        if problem.is_out_of_budget():
            break
        # A whole Gauss-Newton step of `SMALL_STEP` standard errors promises the square of it.
        if control.value == 0.0 and step.promised < SMALL_STEP**2:
            return Minimum(iterate, converged=True, damping=control.value)
        trial = step.evaluate()
        is_small = bool(np.all(np.abs(step.move) < SMALL_STEP * step.std))
        # Rounding may raise the cost at the minimum.
        if trial.cost < iterate.cost * (1 + 1e-12):
            gain = (iterate.cost - trial.cost) / max(trial.cost, 1e-300)  # A perfect fit costs 0
            control.decrease()
            iterate, has_refined_states = trial, False
            idle_steps = idle_steps + 1 if gain < idle_share * _IDLE_GAIN else 0
            is_gain_small = gain < _CONVERGED_GAIN or (is_small and gain < _IDLE_GAIN)
            is_lightly_damped = control.value < 1.0
            if idle_steps == 2 or (is_lightly_damped and is_gain_small):
                return Minimum(iterate, converged=True, damping=control.value)
        elif not has_refined_states and (better := problem.with_states_refined(iterate)) is not None:
            iterate, has_refined_states = better, True
        elif control.value > _MAX_DAMPING or (is_small and len(step.move)):
            # The smallest steps gain nothing, unless the model diverges at each of them.
            return Minimum(iterate, converged=bool(np.isfinite(trial.cost)), damping=control.value)
        else:
            control.increase()
            # The iterate stays the same, so that refining its states again would gain nothing.
            has_refined_states = True
    return Minimum(iterate, converged=False, damping=control.value)
