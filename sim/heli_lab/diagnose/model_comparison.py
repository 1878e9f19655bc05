"""A model with some effects, refitted, and how well it predicts: the flights it saw, and those it did not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.base import Effect, Model
from heli_sim.rig import Rig

from heli_lab.diagnose.candidate import Candidate
from heli_lab.identify import Fit, Problem, Record, solve, validate
from heli_lab.identify.functions import Floats
from heli_lab.identify.residual_noise import autocovariance, floored_mean_square
from heli_lab.identify.thresholds import LEAST_VARIANCE

_CORRELATED_s: Final = 0.5
_RELIEF: Final = 20.0
"""Relief of the rig's numbers that counts as much as a visible drop of the errors."""
_STEP_s: Final = 0.004
"""Steps of 10 ms lose their way in effects that change within a few milliseconds, such as dry friction."""
_RESAMPLED: Final = 400


@dataclass(frozen=True)
class Errors:
    """Errors of a model on some flights, window by window; rows are means over 10 ms.

    Parameters
    ----------
    squares : ndarray (w, 3)
        Sum of squared errors of each window, in units of the rounding's variance.
    rows : ndarray (w,)
        Rows of each window.
    independent : ndarray (3,)
        Share of the rows that count, their errors being correlated.
    tension : float
        Half the sum of squares by which numbers of the rig left what was known of them, in standard
        deviations of their priors: a cost beside that of the errors.
    normalised : float
        Root mean square of every sample's error, in standard deviations of the rounding.
    axis_normalised : ndarray (3,)
        The same of each axis.
    sigma_rad : ndarray (3,)
        Standard deviation of the rounding of each axis.
    """

    squares: Floats
    rows: Floats
    independent: Floats
    tension: float
    normalised: float
    axis_normalised: Floats
    sigma_rad: Floats

    def neg2_log_likelihood_rows(self, squares: Floats, rows: Floats) -> Floats:
        """Twice what each row of an axis takes off the logarithm of the likelihood.

        Axes are judged as in a fit (`noise.judged`): where a model is wrong, how far off it is counts, and
        not which axis shows it most finely.

        Parameters
        ----------
        squares : ndarray (..., 3)
            Sums of squared errors.
        rows : ndarray (...)
            Rows that they are of.

        Returns
        -------
        ndarray (..., 3)
            Logarithm of the variance, and the mean square over it.
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


@dataclass(frozen=True)
class Hypothesis:
    """Some effects, the model refitted with them, and its errors.

    Parameters
    ----------
    candidates : tuple of Candidate
        Where each effect came from, in the order in which they were found.
    fit : Fit
        The refitted model.
    held_fit : Fit or None
        The same model on the validation flights, their initial states and encoder zeros found.
    train, held : Errors
        Errors on the flights fitted and on the others; without validation flights both are the same.
    """

    candidates: tuple[Candidate, ...]
    fit: Fit
    held_fit: Fit | None
    train: Errors
    held: Errors

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
    """What one model has over another.

    Parameters
    ----------
    train, held : float
        Logarithm of the likelihood ratio on the flights fitted and on those held out.
    held_low : float
        The latter's lower bound: 5 % of resamplings of the windows lie below it.
    raw : float
        Sum of both as if all errors were independent: to rank models that leave errors of different colour.
    variance_reduction : float
        Largest share by which it lowers the mean square of an axis on the flights fitted, held out or both.
    """

    train: float
    held: float
    held_low: float
    raw: float
    variance_reduction: float

    @property
    def total(self) -> float:
        """Sum of both."""
        return self.train + self.held


class Comparison:
    """Flights, rig and model on which hypotheses are tried.

    Parameters
    ----------
    model : Model
        The model, with effects that are known beforehand.
    rig : Rig
        Start values and priors.
    train, held : sequence of Record
        Flights to fit and flights to judge on.
    window_s : float
        Length of the windows that are predicted freely.
    seed : int
        Seed of the resampling.
    """

    def __init__(
        self,
        model: Model,
        rig: Rig,
        train: Sequence[Record],
        held: Sequence[Record],
        window_s: float = 2.0,
        seed: int = 0,
    ) -> None:
        self.model, self.rig, self.seed = model, rig, seed
        self.train, self.held = tuple(train), tuple(held)
        self.window_s = window_s
        self.fits = 0

    def refit(
        self,
        candidates: Sequence[Candidate],
        start: Mapping[str, float] | Fit | None = None,
    ) -> Hypothesis:
        """Refit the model with some effects and measure its errors.

        Parameters
        ----------
        candidates : sequence of Candidate
            The effects.
        start : Mapping[str, float] or Fit, optional
            Values to start from.

        Returns
        -------
        Hypothesis
            The result.
        """
        effects: tuple[Effect, ...] = tuple(candidate.effect for candidate in candidates)
        model = type(self.model)((*self.model.effects, *effects))
        problem = Problem(model, self.rig, self.train, window_s=self.window_s, step_s=_STEP_s)
        fit = solve(problem, start=start)
        self.fits += 1
        held_fit = validate(fit, self.held) if self.held else None
        train = errors(fit)
        return Hypothesis(tuple(candidates), fit, held_fit, train, errors(held_fit) if held_fit else train)

    def evidence(self, more: Hypothesis, less: Hypothesis) -> Evidence:
        """Compare two hypotheses.

        Parameters
        ----------
        more, less : Hypothesis
            The one that is asked about, and the one that it is compared with.

        Returns
        -------
        Evidence
            Positive where the first predicts better.
        """
        train = _ratio(more.train, less.train)
        if not self.held:
            return Evidence(
                train, 0.0, 0.0, _raw(more.train, less.train), _variance_reduction(more.train, less.train)
            )
        random = np.random.default_rng(self.seed)
        windows = len(more.held.rows)
        counts = random.multinomial(windows, np.full(windows, 1.0 / windows), _RESAMPLED)
        rows = counts @ more.held.rows
        logs = less.held.neg2_log_likelihood_rows(
            counts @ less.held.squares, rows
        ) - more.held.neg2_log_likelihood_rows(counts @ more.held.squares, rows)
        resampled = 0.5 * rows * (logs @ _shares(more.held, less.held))
        resampled += less.held.tension - more.held.tension
        return Evidence(
            train,
            _ratio(more.held, less.held),
            float(np.quantile(resampled, 0.05)),
            _raw(more.train, less.train) + _raw(more.held, less.held),
            min(_variance_reduction(more.train, less.train), _variance_reduction(more.held, less.held)),
        )


def errors(fit: Fit) -> Errors:
    """Measure the errors of a fit on its flights.

    Parameters
    ----------
    fit : Fit
        The fit.

    Returns
    -------
    Errors
        Window by window.
    """
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
    covariance = autocovariance(together, slices, max(1, round(_CORRELATED_s / step_s)))
    taper = 1.0 - np.arange(len(covariance)) / len(covariance)
    long_run = 2.0 * (taper[:, None] * covariance).sum(axis=0) - covariance[0]
    independent = np.clip(covariance[0] / np.maximum(long_run, 1e-12), 0.0, 1.0)
    samples = np.concatenate(every)
    return Errors(
        np.array(squares),
        np.array(rows, float),
        np.where(long_run > 0.0, independent, 1.0),
        _prior_penalty(fit),
        float(np.sqrt(np.mean(samples**2))),
        np.sqrt(np.mean(samples**2, axis=0)),
        problem.records[0].sigma_rad,
    )


def _shares(more: Errors, less: Errors) -> Floats:
    """Share of the rows that count: by the better model's errors, on each axis."""
    better = more.variance <= less.variance
    result: Floats = np.where(better, more.independent, less.independent)
    return result


def _prior_penalty(fit: Fit) -> float:
    problem = fit.problem
    own = {name for effect in problem.model.effects for name in effect.priors}
    rig = np.array([one.quantity not in own for one in problem.free], bool)
    off = ((fit.theta - problem.prior_mean) / problem.prior_std)[rig]
    return float(0.5 * (off @ off))


def _raw(more: Errors, less: Errors) -> float:
    logs = (less.neg2_log_likelihood - more.neg2_log_likelihood).sum()
    return float(0.5 * more.rows.sum() * logs + less.tension - more.tension)


def _variance_reduction(more: Errors, less: Errors) -> float:
    relieved = 1.0 if less.tension - more.tension > _RELIEF else 0.0
    return max(relieved, float(np.max(1.0 - more.variance / less.variance)))


def _ratio(more: Errors, less: Errors) -> float:
    logs = less.neg2_log_likelihood - more.neg2_log_likelihood
    return float(0.5 * more.rows.sum() * (_shares(more, less) @ logs) + less.tension - more.tension)
