"""The coloured-noise model: likelihood of flights under quantisation and disturbance torques.

Simulation errors are strongly autocorrelated: a disturbance torque affects the output for seconds. Taken as
independent they let a gust imitate any effect of a similar time course. Here each axis has a first-order
Gauss-Markov torque; a Kalman filter over each window turns the simulation errors into innovations, which are
white where the model is right but for such torques, also in closed loop, where the voltages answer to them.
Standard deviations and correlation time are the maximum-likelihood estimates. A cause is accepted when its
log-likelihood ratio under this model exceeds its penalty. After Kristensen, Madsen and Jorgensen (2004).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.optimize import minimize

from heli_lab.diagnose.kalman import StateSpace, filter_outputs
from heli_lab.diagnose.linearisation import Linearisation, stack_steps
from heli_lab.diagnose.model_comparison import Comparison, Hypothesis
from heli_lab.identify import Fit, Problem
from heli_lab.identify.functions import Floats

BLOCK_STEPS: Final = 4
"""Steps of 10 ms that make one measurement: 40 ms, short beside the correlation times of the blind cases'
gusts (0.2 to 0.8 s), and a quarter of the work. Longer blocks blur the response to voltages."""
QUANTISATION_VARIANCE: Final = 0.3
"""Variance that quantisation leaves in the mean residual of a block, in units of a sample's: samples within
40 ms are not independent, as counts stay for several of them. Smaller: quantisation is taken for a torque."""
INITIAL_ANGLE_STD_rad: Final = 0.02
INITIAL_RATE_STD_rad_s: Final = 0.3
"""What is left open of a window's initial state, about the fitted one: it was fitted to errors taken as white
and is off by as much as a torque moves it in a window's first tenths of a second. By judgement. Smaller: the
torque must explain the start. Larger: the start of each window says nothing."""
MAX_RELINEARISATIONS: Final = 4
"""Moves of the parameters to where the likelihood is largest; each is a new linearisation."""
_SMALL_MOVE: Final = 0.7
"""Standard errors by which parameters may move without another linearisation."""

# Bounds and start of the search for the disturbance, far outside of and within what flights show.
_MIN_SIGMA_Nm: Final = 1e-5
_MAX_SIGMA_Nm: Final = 1.0
_START_SIGMA_Nm: Final = (3e-3, 1e-3, 3e-3)
_MIN_START_SIGMA_Nm: Final = 1e-4
_START_CORRELATION_s: Final = 0.4
_MAX_CORRELATION_s: Final = 10.0
# The simplex search in logarithms of four parameters. From the optimum of a similar model a third is enough.
_EVALUATIONS: Final = 75
_FIRST_SIMPLEX: Final = 0.7
_NEXT_SIMPLEX: Final = 0.3
_TOLERANCE_NATS: Final = 0.5
_RIDGE: Final = 1e-3
"""Share of a regressor block's mean square that is added where no prior holds its coefficients: collinear
columns stay solvable and measurable ones lose a thousandth."""


@dataclass(frozen=True)
class DisturbanceModel:
    """Maximum-likelihood Gauss-Markov torques of a fit's flights.

    Parameters
    ----------
    log_likelihood : float
        In nats, up to what all fits of these flights share, priors included.
    sigma_Nm : ndarray (3,)
        Standard deviation of the torque about each axis.
    correlation_time_s : float
        Time over which the torques' autocorrelation falls to 1/e.
    """

    log_likelihood: float
    sigma_Nm: Floats
    correlation_time_s: float


class InnovationsFilter:
    """The Kalman filter of the coloured-noise model over all flights of a `fit`; `pooled` gives one of all
    flights.
    """

    def __init__(self, fit: Fit) -> None:
        self.fit = fit
        problem = fit.problem
        self.linearisations = tuple(Linearisation(fit, index) for index in range(len(problem.records)))
        steps = np.concatenate([one.steps for one in self.linearisations]) // BLOCK_STEPS
        self.alive = np.arange(steps.max())[:, None] < steps[None, :]
        self.step_s = BLOCK_STEPS * self.linearisations[0].trajectory.step_s
        sensitivities = []
        for index, linearisation in enumerate(self.linearisations):
            own = np.zeros((linearisation.rows, 3, len(problem.free) + 1))
            own[:, :, [*problem.columns[index]]] = linearisation.parameter_response()
            own[:, :, -1] = linearisation.residual
            sensitivities.append(own)
        self._outputs = self._blocks(sensitivities).mean(axis=2)
        """Sensitivities to the free parameters, and the residual as last column; mean of each block."""
        self._prior_precision: Floats = problem.prior_std**-2.0
        self._prior_offset: Floats = fit.theta - problem.prior_mean
        self.Phi, self.Gamma, self.C = self._over_blocks()

    def _blocks(self, arrays: Sequence[Floats]) -> Floats:
        return stack_steps(self.linearisations, arrays, BLOCK_STEPS)

    def _over_blocks(self) -> tuple[Floats, Floats, Floats]:
        """Transition, torque input and mean measurement of a block, by state and torque at its beginning."""
        Phi = self._blocks([one.Phi for one in self.linearisations])
        Gamma = self._blocks([one.Gamma @ one.rates_by_torque for one in self.linearisations])
        C = self._blocks([one.C / one.record.sigma_rad[:, None] for one in self.linearisations])
        nx = Phi.shape[-1]
        state = np.zeros((*self.alive.shape, nx, nx + 3))
        state[..., range(nx), range(nx)] = 1.0
        measured = np.zeros((*self.alive.shape, 3, nx + 3))
        for k in range(BLOCK_STEPS):
            measured += C[:, :, k] @ state / BLOCK_STEPS
            state = Phi[:, :, k] @ state
            state[..., nx:] += Gamma[:, :, k]
        return state[..., :nx], state[..., nx:], measured

    def system(self, sigma_Nm: Floats, correlation_time_s: float) -> StateSpace:
        """State space of the simulation errors, one step a block, the torques about the three axes last, with
        `sigma_Nm` and `correlation_time_s` as in `DisturbanceModel`.
        """
        return StateSpace.with_disturbance(
            self.Phi,
            self.Gamma,
            self.C,
            self.alive,
            rho=float(np.exp(-self.step_s / correlation_time_s)),
            sigma=sigma_Nm,
            state_std=initial_state_std(self.Phi.shape[-1]),
            measurement_variance=QUANTISATION_VARIANCE,
        )

    def innovations(
        self, sigma_Nm: Floats, correlation_time_s: float, regressors: Sequence[Floats] = ()
    ) -> tuple[Floats, float]:
        """Filter the simulation errors, their sensitivities to the free parameters, and further regressors.

        Parameters
        ----------
        sigma_Nm : ndarray (3,)
            Standard deviation of the torque about each axis.
        correlation_time_s : float
            Time over which the torques' autocorrelation falls to 1/e.
        regressors : sequence of ndarray (n, 3, s), optional
            For each flight, as `Linearisation.response` gives them.

        Returns
        -------
        innovations : ndarray (m, f + 1 + s)
            Of all flights, in their standard deviations: free parameters, error, regressors.
        log_determinant : float
            Sum of log det of the innovations' covariances.
        """
        outputs = self._outputs
        if regressors:
            outputs = np.concatenate((outputs, self._blocks(regressors).mean(axis=2)), axis=3)
        filtered = filter_outputs(self.system(sigma_Nm, correlation_time_s), outputs)
        return filtered.value[self.alive].reshape(-1, outputs.shape[3]), filtered.log_determinant

    def log_likelihood(self, sigma_Nm: Floats, correlation_time_s: float) -> tuple[float, Floats, Floats]:
        """Log-likelihood, maximised over the free parameters to first order (profile likelihood).

        Parameters
        ----------
        sigma_Nm : ndarray (3,)
            Standard deviation of the torque about each axis.
        correlation_time_s : float
            Time over which the torques' autocorrelation falls to 1/e.

        Returns
        -------
        log_likelihood : float
            In nats, up to a constant, the priors of the free parameters included.
        move, std : ndarray (f,)
            Change of the free parameters that maximises it, and their standard errors.
        """
        filtered, log_determinant = self.innovations(sigma_Nm, correlation_time_s)
        sensitivity, innovation = filtered[:, :-1], filtered[:, -1]
        information = sensitivity.T @ sensitivity + np.diag(self._prior_precision)
        covariance = np.linalg.inv(information)
        move: Floats = covariance @ (sensitivity.T @ innovation - self._prior_precision * self._prior_offset)
        error = innovation - sensitivity @ move
        offset = self._prior_offset + move
        neg2_log_likelihood = error @ error + offset @ (self._prior_precision * offset) + log_determinant
        return float(-0.5 * neg2_log_likelihood), move, np.sqrt(np.diag(covariance))

    def score(
        self,
        disturbance: DisturbanceModel,
        regressors: Sequence[Floats],
        sizes: Sequence[int],
        priors: Sequence[Floats] | None = None,
    ) -> list[float]:
        """Score test under the coloured-noise model, the free parameters projected out: the log-likelihood
        ratio [nats] that each candidate would add, to first order.

        Parameters
        ----------
        regressors : sequence of ndarray (n, 3, s)
            For each flight those of all candidates side by side, as `Linearisation.response` gives them.
        sizes : sequence of int
            Number of regressors of each candidate.
        priors : sequence of ndarray, optional
            For each candidate standard deviations of its coefficients about 0; without them a ridge.
        """
        filtered, _ = self.innovations(disturbance.sigma_Nm, disturbance.correlation_time_s, regressors)
        free = len(self._prior_precision)
        nuisance, error, rest = filtered[:, :free], filtered[:, free], filtered[:, free + 1 :]
        covariance = np.linalg.inv(nuisance.T @ nuisance + np.diag(self._prior_precision))
        error = error - nuisance @ (
            covariance @ (nuisance.T @ error - self._prior_precision * self._prior_offset)
        )
        rest = rest - nuisance @ (covariance @ (nuisance.T @ rest))
        found = []
        low = 0
        for number, size in enumerate(sizes):
            own = rest[:, low : low + size]
            low += size
            information, score = own.T @ own, own.T @ error
            prior = _RIDGE * np.diag(information).mean() if priors is None else priors[number] ** -2.0
            information[range(size), range(size)] += prior
            found.append(float(0.5 * score @ np.linalg.pinv(information, hermitian=True) @ score))
        return found

    def estimate(self, start: DisturbanceModel | None = None) -> DisturbanceModel:
        """Estimate the torques' standard deviations and correlation time by maximum likelihood from `start`
        on, such as the estimate of a similar model.
        """
        sigma_Nm = np.array(_START_SIGMA_Nm) if start is None else start.sigma_Nm
        correlation_time_s = _START_CORRELATION_s if start is None else start.correlation_time_s

        low = np.log([_MIN_SIGMA_Nm, _MIN_SIGMA_Nm, _MIN_SIGMA_Nm, self.step_s])
        high = np.log([_MAX_SIGMA_Nm, _MAX_SIGMA_Nm, _MAX_SIGMA_Nm, _MAX_CORRELATION_s])

        def cost(point: Floats) -> float:
            return -self.log_likelihood(np.exp(point[:3]), float(np.exp(point[3])))[0]

        first = np.log([*np.maximum(sigma_Nm, _MIN_START_SIGMA_Nm), correlation_time_s])
        size = _FIRST_SIMPLEX if start is None else _NEXT_SIMPLEX
        options = {
            "maxfev": _EVALUATIONS if start is None else _EVALUATIONS // 3,
            "initial_simplex": np.clip(np.vstack([first, *(first + size * np.eye(4))]), low, high),
            "fatol": _TOLERANCE_NATS,
            "xatol": np.inf,
        }
        bounds = list(zip(low, high, strict=True))
        found = minimize(cost, first, method="Nelder-Mead", bounds=bounds, options=options)
        best = np.exp(found.x)
        return DisturbanceModel(-float(found.fun), best[:3], float(best[3]))


@dataclass(frozen=True)
class DisturbanceFit:
    """The coloured-noise model of a hypothesis, and the filter about the parameters that it was reached at,
    which moved `relinearisations` times at most.
    """

    model: DisturbanceModel
    innovations_filter: InnovationsFilter
    relinearisations: int


def initial_state_std(states: int) -> Floats:
    """Standard deviations of the initial state of a window, of at least 3 `states`, about the fitted one,
    angles first, then all others.
    """
    return np.array([INITIAL_ANGLE_STD_rad] * 3 + [INITIAL_RATE_STD_rad_s] * (states - 3))


def pooled(comparison: Comparison, hypothesis: Hypothesis) -> Fit:
    """Take the flights fitted and those held out as one fit of the same parameters, without refitting."""
    fit, held_out = hypothesis.fit, hypothesis.held_out_fit
    if held_out is None:
        return fit
    old = fit.problem
    problem = Problem(
        old.model,
        old.rig,
        (*comparison.train, *comparison.held_out),
        window_s=old.window_s,
        step_s=old.step_s,
        state_std=old.state_std_by_name,
    )
    known = {(one.quantity, one.record): v for one, v in zip(old.free, fit.theta, strict=True)}
    for one, value in zip(held_out.problem.free, held_out.theta, strict=True):
        known[one.quantity, None if one.record is None else one.record + len(comparison.train)] = value
    theta = [
        known.get((one.quantity, one.record), v) for one, v in zip(problem.free, problem.start, strict=True)
    ]
    states = (*fit.states, *held_out.states)
    return replace(fit, problem=problem, theta=np.array(theta), states=states)


def fit_disturbance(
    comparison: Comparison,
    hypothesis: Hypothesis,
    start: DisturbanceModel | None = None,
    relinearisations: int = MAX_RELINEARISATIONS,
) -> DisturbanceFit:
    """Estimate the coloured-noise model of a hypothesis on all flights; its parameters are moved to where the
    likelihood is largest, at most `relinearisations` times.
    """
    reached = InnovationsFilter(pooled(comparison, hypothesis))
    disturbance = reached.estimate(start)
    best = disturbance, reached
    # The free-run fit is biased by the torque: linearise again about the parameters that the filter
    # estimates.
    for _ in range(relinearisations):
        _, move, std = reached.log_likelihood(disturbance.sigma_Nm, disturbance.correlation_time_s)
        if np.all(np.abs(move) < _SMALL_MOVE * std):
            break
        theta = np.clip(reached.fit.theta + move, *reached.fit.problem.bounds)
        reached = InnovationsFilter(replace(reached.fit, theta=theta))
        disturbance = reached.estimate(disturbance)
        best = max(best, (disturbance, reached), key=lambda one: one[0].log_likelihood)
    return DisturbanceFit(*best, relinearisations)
