"""Hypotheses, models refitted with some effects, and their comparison by log-likelihood ratios."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.base import Effect, Model
from heli_sim.rig import Rig

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.thresholds import PRIOR_RELIEF
from heli_lab.identify import Fit, Problem, Record, solve, validate
from heli_lab.identify.functions import Floats
from heli_lab.identify.residual_noise import autocovariance, floored_mean_square
from heli_lab.identify.thresholds import LEAST_VARIANCE

_LONGEST_LAG_s: Final = 0.5
"""Lags of the autocovariance in the long-run variance: a quarter of a window. Longer ones are too noisy."""
_STEP_s: Final = 0.004
"""Step of the fits. With 10 ms, fits of effects that change within milliseconds, such as dry friction,
fail."""
_RESAMPLES: Final = 400
"""Bootstrap samples for a 5 % quantile: 20 lie below it."""
_LOWER_QUANTILE: Final = 0.05


@dataclass(frozen=True)
class Errors:
    """Errors of a model on some flights, window by window; rows are means over 10 ms.

    Parameters
    ----------
    squares : ndarray (w, 3)
        Sum of squared errors of each window, in units of the quantisation's variance.
    rows : ndarray (w,)
        Rows of each window.
    effective_fraction : ndarray (3,)
        Effective over actual number of rows: variance over long-run variance of the errors, 0 to 1.
    prior_penalty : float
        -log prior of the rig's parameters: half the sum of squares of their distances from the prior means,
        in standard deviations of the priors.
    normalised : float
        Root mean square of every sample's error, in standard deviations of the quantisation.
    axis_normalised : ndarray (3,)
        The same of each axis.
    sigma_rad : ndarray (3,)
        Standard deviation of the quantisation of each axis.
    """

    squares: Floats
    rows: Floats
    effective_fraction: Floats
    prior_penalty: float
    normalised: float
    axis_normalised: Floats
    sigma_rad: Floats

    def neg2_log_likelihood_rows(self, squares: Floats, rows: Floats) -> Floats:
        """-2 log likelihood, up to a constant, shape (..., 3), for each of the `rows`, shape (...), of an
        axis with sums of squared errors `squares`, shape (..., 3): the logarithm of the variance, plus the
        mean square over it.

        Variances are those of `residual_noise.floored_mean_square`: where a model is wrong, its error in
        radians counts, and not the resolution of the axis' encoder.
        """
        mean = np.maximum(squares / rows[..., None], LEAST_VARIANCE)
        scale = floored_mean_square(mean, self.sigma_rad)
        result: Floats = np.log(scale) + mean / scale
        return result

    @property
    def neg2_log_likelihood(self) -> Floats:
        """The same of all windows together, shape (3,)."""
        return self.neg2_log_likelihood_rows(self.squares.sum(axis=0), self.rows.sum())

    @property
    def variance(self) -> Floats:
        """Mean square of each axis, shape (3,)."""
        result: Floats = np.maximum(self.squares.sum(axis=0) / self.rows.sum(), LEAST_VARIANCE)
        return result


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Some effects, the model refitted with them, and its errors; compared by identity.

    Parameters
    ----------
    candidates : tuple of Candidate
        Its effects, in the order in which they were found.
    held_out_fit : Fit or None
        The same model on the validation flights, only their initial states and encoder zeros estimated.
    train, held_out : Errors
        Errors on the flights fitted and on those held out; without the latter both are the same.
    """

    candidates: tuple[Candidate, ...]
    fit: Fit
    held_out_fit: Fit | None
    train: Errors
    held_out: Errors

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of its effects."""
        return tuple(candidate.id for candidate in self.candidates)

    @property
    def parameters(self) -> int:
        """Number of free parameters of its effects."""
        return sum(len(candidate.effect.priors) for candidate in self.candidates)


@dataclass(frozen=True)
class Evidence:
    """Log-likelihood ratios of one model over another, nats.

    Parameters
    ----------
    train, held_out : float
        On the flights fitted and on those held out, with the effective number of rows.
    held_out_low : float
        Lower bound of the latter: 5 % of bootstrap samples of the windows lie below it.
    iid : float
        Sum of both as if all errors were independent: ranks models whose errors differ in autocorrelation.
    variance_reduction : float
        Largest share by which it lowers the mean square of an axis; the smaller one of fitted and held out.
    """

    train: float
    held_out: float
    held_out_low: float
    iid: float
    variance_reduction: float

    @property
    def total(self) -> float:
        """Fitted and held out together."""
        return self.train + self.held_out


class Comparison:
    """Flights, rig and model with which hypotheses are fitted and compared.

    Parameters
    ----------
    model : Model
        The model, with effects that are known beforehand.
    window_s : float
        Length of the free-run windows.
    seed : int
        Seed of the bootstrap.
    """

    def __init__(
        self,
        model: Model,
        rig: Rig,
        train: Sequence[Record],
        held_out: Sequence[Record],
        window_s: float = 2.0,
        seed: int = 0,
    ) -> None:
        self.model, self.rig, self.seed = model, rig, seed
        self.train, self.held_out = tuple(train), tuple(held_out)
        self.window_s = window_s
        self.fits = 0

    def refit(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float] | Fit | None = None,
    ) -> Hypothesis:
        """Refit the model with some effects from `start` on, parameter values or a fit, and measure its
        errors; an IdentifyError when that fails.
        """
        effects: tuple[Effect, ...] = tuple(candidate.effect for candidate in candidates)
        model = type(self.model)((*self.model.effects, *effects))
        problem = Problem(model, self.rig, self.train, window_s=self.window_s, step_s=_STEP_s)
        fit = solve(problem, start=start)
        self.fits += 1
        held_out_fit = validate(fit, self.held_out) if self.held_out else None
        train = errors(fit)
        return Hypothesis(
            tuple(candidates), fit, held_out_fit, train, errors(held_out_fit) if held_out_fit else train
        )

    def evidence(self, more: Hypothesis, less: Hypothesis) -> Evidence:
        """Compare two hypotheses; positive ratios are in favour of `more` over `less`."""
        train = _ratio(more.train, less.train)
        if not self.held_out:
            return Evidence(
                train, 0.0, 0.0, _raw(more.train, less.train), _variance_reduction(more.train, less.train)
            )
        random = np.random.default_rng(self.seed)
        windows = len(more.held_out.rows)
        counts = random.multinomial(windows, np.full(windows, 1.0 / windows), _RESAMPLES)
        rows = counts @ more.held_out.rows
        logs = less.held_out.neg2_log_likelihood_rows(
            counts @ less.held_out.squares, rows
        ) - more.held_out.neg2_log_likelihood_rows(counts @ more.held_out.squares, rows)
        resampled = 0.5 * rows * (logs @ _effective_fraction(more.held_out, less.held_out))
        resampled += less.held_out.prior_penalty - more.held_out.prior_penalty
        return Evidence(
            train,
            _ratio(more.held_out, less.held_out),
            float(np.quantile(resampled, _LOWER_QUANTILE)),
            _raw(more.train, less.train) + _raw(more.held_out, less.held_out),
            min(
                _variance_reduction(more.train, less.train), _variance_reduction(more.held_out, less.held_out)
            ),
        )


def errors(fit: Fit) -> Errors:
    """Measure the errors of a fit on its flights, window by window."""
    problem = fit.problem
    squares, rows, means, slices, every = [], [], [], [], []
    place = 0
    for index, states in enumerate(fit.states):
        evaluation = problem.evaluation(index, fit.theta, states, fine=True, derivatives=False)
        grid = problem.block_grid(index, fit.theta)
        mean = evaluation.residual.reshape(grid.inputs.rows, grid.every, 3).mean(axis=1)
        every.append(evaluation.residual)
        means.append(mean)
        for window in grid.slices:
            squares.append((mean[window] ** 2).sum(axis=0))
            rows.append(window.stop - window.start)
            slices.append(slice(place + window.start, place + window.stop))
        place += len(mean)
        step_s = grid.inputs.step_s
    together = np.concatenate(means)
    covariance = autocovariance(together, slices, max(1, round(_LONGEST_LAG_s / step_s)))
    taper = 1.0 - np.arange(len(covariance)) / len(covariance)
    long_run = 2.0 * (taper[:, None] * covariance).sum(axis=0) - covariance[0]
    effective_fraction = np.clip(covariance[0] / np.maximum(long_run, 1e-12), 0.0, 1.0)
    samples = np.concatenate(every)
    return Errors(
        np.array(squares),
        np.array(rows, float),
        np.where(long_run > 0.0, effective_fraction, 1.0),
        _prior_penalty(fit),
        float(np.sqrt(np.mean(samples**2))),
        np.sqrt(np.mean(samples**2, axis=0)),
        problem.records[0].sigma_rad,
    )


def _effective_fraction(more: Errors, less: Errors) -> Floats:
    """Of the better model's errors, on each axis."""
    better = more.variance <= less.variance
    result: Floats = np.where(better, more.effective_fraction, less.effective_fraction)
    return result


def _prior_penalty(fit: Fit) -> float:
    problem = fit.problem
    own = {name for effect in problem.model.effects for name in effect.priors}
    rig = np.array([one.quantity not in own for one in problem.free], bool)
    off = ((fit.theta - problem.prior_mean) / problem.prior_std)[rig]
    return float(0.5 * (off @ off))


def _raw(more: Errors, less: Errors) -> float:
    logs = (less.neg2_log_likelihood - more.neg2_log_likelihood).sum()
    return float(0.5 * more.rows.sum() * logs + less.prior_penalty - more.prior_penalty)


def _variance_reduction(more: Errors, less: Errors) -> float:
    relieved = 1.0 if less.prior_penalty - more.prior_penalty > PRIOR_RELIEF else 0.0
    return max(relieved, float(np.max(1.0 - more.variance / less.variance)))


def _ratio(more: Errors, less: Errors) -> float:
    logs = less.neg2_log_likelihood - more.neg2_log_likelihood
    return float(
        0.5 * more.rows.sum() * (_effective_fraction(more, less) @ logs)
        + less.prior_penalty
        - more.prior_penalty
    )
