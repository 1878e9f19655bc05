"""How likely a fit makes its flights when torques may wander by chance: errors that go together count once.

Errors of a free run are all of one piece: what pushes the arm shows for seconds. Taken as independent they
make a gust look like whatever cause imitates its course. Here each axis gets a random torque that forgets
within `correlation_time_s`; a Kalman filter over each window turns the errors into innovations, which are
independent where the model is right but for such torques, and stay so in a closed loop, where the voltages
answer to the torques. Sizes and memory are those that make the flights likeliest. A cause is believed when it
makes the flights likelier than chance does. After Kristensen, Madsen and Jorgensen (2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize

from heli_lab.diagnose.disturbance_torque import FREE_ANGLE_rad, FREE_RATE_rad_s
from heli_lab.diagnose.linearisation import Linearisation
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.identify import Fit, Problem
from heli_lab.identify.functions import Floats

_BLOCK: Final = 4
"""Steps that are taken together: 40 ms, short beside the memory of any gust."""
_NOISE: Final = 0.3
"""Variance of a block's mean residual that rounding leaves, in units of the rounding's variance."""
_LEAST_Nm: Final = 1e-5
_MOST_Nm: Final = 1.0
_LEAST_START_Nm: Final = 1e-4
_START_s: Final = 0.4
_LONGEST_s: Final = 10.0
_EVALUATIONS: Final = 75
_FIRST_STEP: Final = 0.7
_NEXT_STEP: Final = 0.3
_TOLERANCE_NATS: Final = 0.5
_RIDGE: Final = 1e-3
MOST_ROUNDS: Final = 4
_SMALL_MOVE: Final = 0.7
"""Standard errors by which numbers may move without another round."""


@dataclass(frozen=True)
class DisturbanceModel:
    """Random torques that make a fit's flights likeliest.

    Parameters
    ----------
    likelihood : float
        Logarithm of the likelihood, up to what all fits of these flights share, priors included.
    sigma_Nm : ndarray (3,)
        Standard deviation of the torque about each axis.
    correlation_time_s : float
        Time over which it falls to 1/e.
    """

    likelihood: float
    sigma_Nm: Floats
    correlation_time_s: float


class InnovationsFilter:
    """Turns errors into innovations, for all flights of a fit.

    Parameters
    ----------
    fit : Fit
        A fit; `pooled` gives one of all flights.
    """

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        problem = fit.problem
        self.tangents = tuple(Linearisation(fit, index) for index in range(len(problem.records)))
        steps = np.concatenate([t.steps for t in self.tangents]) // _BLOCK
        self.alive = np.arange(steps.max())[:, None] < steps[None, :]
        self.step_s = _BLOCK * self.tangents[0].path.step_s
        known = []
        for index, tangent in enumerate(self.tangents):
            own = np.zeros((tangent.rows, 3, len(problem.free) + 1))
            own[:, :, [*problem.columns[index]]] = tangent.free()
            own[:, :, -1] = tangent.residual
            known.append(own)
        self._known = self._blocks(known).mean(axis=2)
        """Answers to the free parameters, and the residual; mean of each block."""
        self._weight: Floats = problem.prior_std**-2.0
        self._off: Floats = fit.theta - problem.prior_mean
        self.over, self.see = self._joined()

    def _blocks(self, arrays: Sequence[Floats]) -> Floats:
        """Rows of all flights as (blocks, windows, steps of a block, ...), zeros after a window's end."""
        out = np.zeros((*self.alive.shape, _BLOCK, *arrays[0].shape[1:]))
        place = 0
        for tangent, array in zip(self.tangents, arrays, strict=True):
            for window in tangent.windows:
                count = (window.stop - window.start) // _BLOCK
                rows = array[window.start : window.start + count * _BLOCK]
                out[:count, place] = rows.reshape(count, _BLOCK, *array.shape[1:])
                place += 1
        return out

    def _joined(self) -> tuple[Floats, Floats]:
        """State and torque over a block, and the mean of what is seen in it, by those at its beginning."""
        over = self._blocks([t.over for t in self.tangents])
        push = self._blocks([t.push @ t.by_torque for t in self.tangents])
        see = self._blocks([t.see / t.record.sigma_rad[:, None] for t in self.tangents])
        nx = over.shape[-1]
        reached = np.zeros((*self.alive.shape, nx, nx + 3))
        reached[..., range(nx), range(nx)] = 1.0
        seen = np.zeros((*self.alive.shape, 3, nx + 3))
        for k in range(_BLOCK):
            seen += see[:, :, k] @ reached / _BLOCK
            reached = over[:, :, k] @ reached
            reached[..., nx:] += push[:, :, k]
        return reached, seen

    def innovations(
        self, sigma_Nm: Floats, correlation_time_s: float, columns: Sequence[Floats] = ()
    ) -> tuple[Floats, float]:
        """Filter the errors, what free parameters change in them, and more columns.

        Parameters
        ----------
        sigma_Nm : ndarray (3,)
            Standard deviation of the random torque about each axis.
        correlation_time_s : float
            Its memory.
        columns : sequence of ndarray (n, 3, s), optional
            For each flight, as `Linearisation.answer` gives them.

        Returns
        -------
        innovations : ndarray (m, f + 1 + s)
            Of all flights, in standard deviations: free parameters, error, columns.
        logarithm : float
            Logarithm of the determinant of their covariance.
        """
        given = self._known
        if columns:
            given = np.concatenate((given, self._blocks(columns).mean(axis=2)), axis=3)
        longest, count, nx, order = self.over.shape
        keep = float(np.exp(-self.step_s / correlation_time_s))
        noise = np.zeros((order, order))
        noise[nx:, nx:] = np.diag((1.0 - keep**2) * sigma_Nm**2)
        first = np.concatenate((np.full(3, FREE_ANGLE_rad), np.full(nx - 3, FREE_RATE_rad_s), sigma_Nm))
        spread = np.broadcast_to(np.diag(first**2), (count, order, order)).copy()
        mean = np.zeros((count, order, given.shape[3]))
        out = np.empty_like(given)
        logarithm = 0.0
        over = np.zeros((count, order, order))
        over[:, range(nx, order), range(nx, order)] = keep
        for k in range(longest):
            see = self.see[k]
            cross = spread @ see.transpose(0, 2, 1)
            root = np.linalg.cholesky(see @ cross + _NOISE * np.eye(3))
            inverse = np.linalg.inv(root)
            out[k] = inverse @ (given[k] - see @ mean)
            gain = cross @ inverse.transpose(0, 2, 1)
            diagonal = np.diagonal(root, axis1=1, axis2=2)[self.alive[k]]
            logarithm += 2.0 * float(np.log(diagonal).sum())
            mean = mean + gain @ out[k]
            spread = spread - gain @ gain.transpose(0, 2, 1)
            over[:, :nx] = self.over[k]
            mean = over @ mean
            spread = over @ spread @ over.transpose(0, 2, 1) + noise
        return out[self.alive].reshape(-1, given.shape[3]), logarithm

    def likelihood(self, sigma_Nm: Floats, correlation_time_s: float) -> tuple[float, Floats, Floats]:
        """Logarithm of the likelihood, the free parameters moved to where it is largest, to first order.

        Parameters
        ----------
        sigma_Nm : ndarray (3,)
            Standard deviation of the random torque about each axis.
        correlation_time_s : float
            Its memory.

        Returns
        -------
        likelihood : float
            Its logarithm, up to a constant, and with what the priors say.
        move, std : ndarray (f,)
            Change of the free parameters, and their standard errors.
        """
        filtered, logarithm = self.innovations(sigma_Nm, correlation_time_s)
        left, right = filtered[:, :-1], filtered[:, -1]
        matrix = left.T @ left + np.diag(self._weight)
        inverse = np.linalg.inv(matrix)
        move: Floats = inverse @ (left.T @ right - self._weight * self._off)
        error = right - left @ move
        off = self._off + move
        return (
            float(-0.5 * (error @ error + off @ (self._weight * off) + logarithm)),
            move,
            np.sqrt(np.diag(inverse)),
        )

    def gains(
        self,
        disturbance: DisturbanceModel,
        columns: Sequence[Floats],
        sizes: Sequence[int],
        priors: Sequence[Floats] | None = None,
    ) -> list[float]:
        """Score candidates beside random torques, to first order.

        Parameters
        ----------
        disturbance : DisturbanceModel
            The random torques.
        columns : sequence of ndarray (n, 3, s)
            For each flight the columns of all candidates side by side, as `Linearisation.answer` gives them.
        sizes : sequence of int
            Number of columns of each candidate.
        priors : sequence of ndarray, optional
            For each candidate standard deviations of its coefficients about 0; without them these are held
            to what its columns can measure.

        Returns
        -------
        list of float
            Logarithm of the likelihood ratio that each adds.
        """
        filtered, _ = self.innovations(disturbance.sigma_Nm, disturbance.correlation_time_s, columns)
        free = len(self._weight)
        left, error, rest = filtered[:, :free], filtered[:, free], filtered[:, free + 1 :]
        inverse = np.linalg.inv(left.T @ left + np.diag(self._weight))
        error = error - left @ (inverse @ (left.T @ error - self._weight * self._off))
        rest = rest - left @ (inverse @ (left.T @ rest))
        found = []
        low = 0
        for number, size in enumerate(sizes):
            own = rest[:, low : low + size]
            low += size
            normal_matrix, cross = own.T @ own, own.T @ error
            known = _RIDGE * np.diag(normal_matrix).mean() if priors is None else priors[number] ** -2.0
            normal_matrix[range(size), range(size)] += known
            found.append(float(0.5 * cross @ np.linalg.pinv(normal_matrix, hermitian=True) @ cross))
        return found

    def likeliest(self, start: DisturbanceModel | None = None) -> DisturbanceModel:
        """Find the random torques that make the flights likeliest.

        Parameters
        ----------
        start : DisturbanceModel, optional
            Where to start.

        Returns
        -------
        DisturbanceModel
            The torques.
        """
        sigma_Nm = np.array([3e-3, 1e-3, 3e-3]) if start is None else start.sigma_Nm
        correlation_time_s = _START_s if start is None else start.correlation_time_s

        low = np.log([_LEAST_Nm, _LEAST_Nm, _LEAST_Nm, self.step_s])
        high = np.log([_MOST_Nm, _MOST_Nm, _MOST_Nm, _LONGEST_s])

        def cost(point: Floats) -> float:
            return -self.likelihood(np.exp(point[:3]), float(np.exp(point[3])))[0]

        first = np.log([*np.maximum(sigma_Nm, _LEAST_START_Nm), correlation_time_s])
        spread = _FIRST_STEP if start is None else _NEXT_STEP
        options = {
            "maxfev": _EVALUATIONS if start is None else _EVALUATIONS // 3,
            "initial_simplex": np.clip(np.vstack([first, *(first + spread * np.eye(4))]), low, high),
            "fatol": _TOLERANCE_NATS,
            "xatol": np.inf,
        }
        bounds = list(zip(low, high, strict=True))
        found = minimize(cost, first, method="Nelder-Mead", bounds=bounds, options=options)
        best = np.exp(found.x)
        return DisturbanceModel(-float(found.fun), best[:3], float(best[3]))


def pooled(comparison: Comparison, hypothesis: Hypothesis) -> Fit:
    """See all flights as one fit, those held out too.

    Parameters
    ----------
    comparison : Comparison
        The flights.
    hypothesis : Hypothesis
        Its fits.

    Returns
    -------
    Fit
        The same numbers and windows; nothing is fitted.
    """
    fit, held = hypothesis.fit, hypothesis.held_fit
    if held is None:
        return fit
    old = fit.problem
    problem = Problem(
        old.model,
        old.rig,
        (*comparison.train, *comparison.held),
        window_s=old.window_s,
        step_s=old.step_s,
        state_std=old.state_std_by_name,
    )
    known = {(one.quantity, one.record): v for one, v in zip(old.free, fit.theta, strict=True)}
    for one, value in zip(held.problem.free, held.theta, strict=True):
        known[one.quantity, None if one.record is None else one.record + len(comparison.train)] = value
    theta = [
        known.get((one.quantity, one.record), v) for one, v in zip(problem.free, problem.start, strict=True)
    ]
    states = (*fit.states, *held.states)
    return replace(fit, problem=problem, theta=np.array(theta), states=states)


def fit_disturbance(
    comparison: Comparison,
    hypothesis: Hypothesis,
    start: DisturbanceModel | None = None,
    rounds: int = MOST_ROUNDS,
) -> tuple[DisturbanceModel, InnovationsFilter]:
    """Find how likely a hypothesis makes all flights.

    Parameters
    ----------
    comparison : Comparison
        The flights.
    hypothesis : Hypothesis
        The model with its numbers, which are moved to where the flights are likeliest.
    start : DisturbanceModel, optional
        Where to start.
    rounds : int
        How often the numbers may be moved, at most.

    Returns
    -------
    disturbance : DisturbanceModel
        Its random torques, and the likelihood.
    filter : InnovationsFilter
        The filter around the numbers that were reached.
    """
    reached = InnovationsFilter(pooled(comparison, hypothesis))
    disturbance = reached.likeliest(start)
    best = disturbance, reached
    # A free run that misses a torque pulls the numbers along: again around where the filter says they are.
    for _ in range(rounds):
        _, move, std = reached.likelihood(disturbance.sigma_Nm, disturbance.correlation_time_s)
        if np.all(np.abs(move) < _SMALL_MOVE * std):
            break
        theta = np.clip(reached.fit.theta + move, *reached.fit.problem.bounds)
        reached = InnovationsFilter(replace(reached.fit, theta=theta))
        disturbance = reached.likeliest(disturbance)
        best = max(best, (disturbance, reached), key=lambda one: one[0].likelihood)
    return best
