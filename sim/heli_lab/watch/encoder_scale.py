"""Estimate the scale of each encoder from one flight: measured counts per count that the rig's model
predicts.

An encoder with the scale s measures the angle m = r + s (q - r), where q is the true angle and r the angle at
which the encoder was zeroed. Let f be the acceleration of the model, u the voltages and p the rig parameters.
For a smooth test function w that is 0 outside of an interval,

    integral w'' m dt = s integral w f(q, dq/dt, u; p) dt + disturbances.

This contains no second derivative of a measured angle. Each axis has a separate scale, because its
acceleration depends on the true angles: that of elevation by gravity and thrust, that of travel by the sine
of pitch. The rig parameters p are estimated together with s, with the rig file's tolerances as their priors.
The standard error of s therefore includes their uncertainty.

`check_flight` is an entry point ``heli_host.flight_checks``. It warns after a flight if an encoder seems to
have wrong counts per turn, or if the flight does not fit its rig for another reason that looks the same.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.summary import FlightFinding
from heli_sim.model import model_named
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import EffectSpec, catalogue, effects_of
from heli_sim.rig import Rig, load_rig

from heli_lab.fit.normal_equations import DampedStep, minimise
from heli_lab.watch.weak_form import SCALES_AND_FACTOR, VOLTAGE_FACTOR, FlightInWeakForm

_WRONG_SUPPLY: Final = "supply_V"
"""Name of a wrong supply among the explanations: the board's parameter."""
_MIN_s: Final = 5.0
"""Shortest free flight that gives an estimate [s]: almost twice the longest test function."""
_NOISE_ROUNDS: Final = 3
"""Number of fits from whose residuals the noise is estimated."""
_FIRST_rad_s2: Final = 0.03
"""Standard deviation of the residuals in the first of these fits [rad/s^2]: that of strong gusts."""
_MIN_rad_s2: Final = 1e-3
"""Smallest standard deviation of the residuals [rad/s^2]: that of smoothing and rounding alone."""
_MAX_CORRELATION: Final = 0.9
"""Largest correlation of neighbouring residuals in the noise model. If it is larger, an equation term is
missing."""
_FEEDBACK: Final = 2.0
"""Error of a scale because the control law responds to disturbances, see `_noise_of_axes`, in units of the
ratio r there. On 24 rigs in strong disturbances, the scales were up to 3 r too small. Smaller: false
warnings. Larger: an encoder with half the counts is not noticed."""
_FIRST_DAMPING: Final = 1.0
"""Damping of the first step of a search: no scale then changes by more than its prior allows."""
_MAX_STEPS: Final = 60
"""Largest number of steps of a search."""
_EFFECT_STEPS: Final = 15
"""The same for an effect in the place of a scale: even a search that ends early shows that it explains the
flight."""
_FITTED_EFFECTS: Final = 6
"""Number of effects that are fitted in the place of a scale, of those that a first step predicts to be most
likely. Fewer: the effect that explains the flight is not fitted. More: time, 0.2 s for each."""
_MOMENTS: Final = (0.25, 0.5, 0.75)
"""Moments from which a search for an effect with a moment starts, as shares of the free flight."""


@dataclass(frozen=True)
class ScaleEstimate:
    """Estimated scale of one encoder; all other parameters of the rig vary within their tolerances."""

    axis: str  # Axis of the encoder: ``elevation``, ``pitch`` or ``travel``
    scale: float  # Counts that the encoder shows per count that the model predicts; 1 for a correct encoder
    standard_error: float  # Standard error of the scale
    nats: float  # Log-likelihood ratio of this scale to a scale of 1, nats (6 nats: 400 times as likely)
    converged: bool = True  # Whether the search for it has converged; otherwise its value means nothing

    @property
    def sigmas(self) -> float:
        """Distance of the scale from 1, in standard errors."""
        return abs(self.scale - 1.0) / self.standard_error


@dataclass(frozen=True)
class _Iterate:
    """One point of the search for the scales."""

    free: Floats  # (f,): Free unknowns
    residuals: list[Floats]  # (k,): Residuals of each axis [rad/s^2]
    errors: Floats  # (3 k,): Residuals of all axes in standard deviations
    jacobian: Floats
    """(3 k, f): Derivatives of the residuals by the free unknowns, in standard deviations of the residuals.
    """
    cost: float  # Sum of squares of the errors, plus that of the priors


class _ScaleProblem:
    """Least-squares problem of some encoder scales together with all other unknowns and their priors.
    `noise` has shape (3,). `start` has shape (unknowns,).
    """

    def __init__(
        self, weak_form: FlightInWeakForm, noise: Floats, axes: Sequence[int], start: Floats
    ) -> None:
        self._weak_form, self._noise, self._start = weak_form, noise, start
        self._free = np.array([*axes, *range(SCALES_AND_FACTOR, len(weak_form.mean))], int)
        self._mean, self._precision = weak_form.mean[self._free], weak_form.std[self._free] ** -2

    def unknowns(self, free: Floats) -> Floats:
        """Return all unknowns, shape (unknowns,), from the free ones, shape (f,)."""
        unknowns = self._start.copy()
        unknowns[self._free] = free
        return unknowns

    def first(self) -> _Iterate:
        """Return the iterate at the start."""
        return self._evaluate_at(self._start[self._free])

    def covariance(self, iterate: _Iterate) -> Floats:
        """Return the covariance of the free unknowns, shape (f, f)."""
        return np.asarray(np.linalg.inv(self._normal_matrix(iterate, 0.0)), np.float64)

    def step(self, iterate: _Iterate, damping: float) -> DampedStep[_Iterate]:
        """Solve for a step, as in `LeastSquares.step`; the damping is in units of the priors' precision."""
        matrix = self._normal_matrix(iterate, damping)
        # Negative gradient of half the cost.
        descent = -iterate.jacobian.T @ iterate.errors + self._precision * (self._mean - iterate.free)
        move = np.linalg.solve(matrix, descent)
        std = np.sqrt(np.diag(np.linalg.inv(matrix)))
        predicted_reduction = float(move @ (2.0 * descent - matrix @ move))
        return DampedStep(move, std, predicted_reduction, lambda: self._evaluate_at(iterate.free + move))

    def with_states_refined(self, iterate: _Iterate) -> None:
        """Return None, because this problem has no further unknowns."""

    def is_out_of_budget(self) -> bool:
        """Return False, because the number of steps is the only limit."""
        return False

    def _normal_matrix(self, iterate: _Iterate, damping: float) -> Floats:
        """Normal matrix of a damped step, shape (f, f), priors included."""
        return iterate.jacobian.T @ iterate.jacobian + np.diag((1.0 + damping) * self._precision)

    def _evaluate_at(self, free: Floats) -> _Iterate:
        """Compute residuals, derivatives and cost for the free unknowns, shape (f,)."""
        residuals, jacobians = self._weak_form.residuals(self.unknowns(free))
        errors = np.concatenate([values / std for values, std in zip(residuals, self._noise, strict=True)])
        rows = [values[:, self._free] / std for values, std in zip(jacobians, self._noise, strict=True)]
        prior_cost = self._precision @ (free - self._mean) ** 2
        return _Iterate(free, residuals, errors, np.vstack(rows), float(errors @ errors + prior_cost))


@dataclass(frozen=True)
class _Fit:
    """Result of a fit."""

    unknowns: Floats  # (unknowns,): All unknowns, as in `FlightInWeakForm`
    covariance: Floats  # (f, f): Covariance of the free unknowns
    cost: float  # Sum of squares, priors included
    residuals: list[Floats]  # (k,): Residuals of each axis [rad/s^2]
    converged: bool  # Whether a further step would change the unknowns noticeably


@dataclass(frozen=True)
class Explanation:
    """Something other than an encoder's scale that explains a flight."""

    name: str  # ``supply_V``, or the id of an effect of the catalogue
    nats: float  # Log-likelihood ratio to the rig's model without it, nats
    factor: float = 1.0  # Factor on the voltages, if it is a wrong supply; otherwise 1


def scales_of(flight: Flight, rig: Rig, model: Model) -> tuple[ScaleEstimate, ...]:
    """Estimate the scale of each encoder, as if the other two encoders were correct."""
    return ScaleTest(FlightInWeakForm(flight, rig, model)).estimates


class ScaleTest:
    """Test of a flight for encoders with wrong scales, and for what else explains the same."""

    def __init__(self, weak_form: FlightInWeakForm) -> None:
        self._weak_form = weak_form
        self.estimates: tuple[ScaleEstimate, ...] = ()
        if weak_form.seconds < _MIN_s:
            return  # without estimates, no scale counts as wrong
        self._noise, free_scales_fit = _noise_of_axes(weak_form)
        self._unit_scales_fit = _fit_scales(weak_form, self._noise, axes=(), start=weak_form.mean)
        self.estimates = tuple(
            _estimate_scale_of_axis(weak_form, self._noise, axis, free_scales_fit, self._unit_scales_fit)
            for axis in range(len(AXES))
        )

    def explanations(self, kinds: Iterable[EffectSpec]) -> list[Explanation]:
        """Fit a wrong supply, and the most likely of the effects `kinds`, in the place of a wrong scale."""
        # Effects with states, such as a lag, are left out: the lag of the thrust is always fitted. A first
        # step of a fit predicts which effects are likely.
        effects = [
            _EffectFit(kind, self._weak_form, self._unit_scales_fit) for kind in kinds if _is_static(kind)
        ]
        effects.sort(key=lambda effect: -effect.predicted_nats(self._noise))
        fitted = [self._supply(), *(effect.explanation(self._noise) for effect in effects[:_FITTED_EFFECTS])]
        return sorted(fitted, key=lambda explanation: -explanation.nats)

    def _supply(self) -> Explanation:
        """Fit a factor on the voltages, from several start values."""
        fits = []
        for factor in (0.5, 1.0, 2.0):
            start = self._unit_scales_fit.unknowns.copy()
            start[VOLTAGE_FACTOR] = np.log(factor)
            fits.append(_fit_scales(self._weak_form, self._noise, axes=(VOLTAGE_FACTOR,), start=start))
        best = min(fits, key=lambda fit: fit.cost)
        return Explanation(_WRONG_SUPPLY, self._nats(best), float(np.exp(best.unknowns[VOLTAGE_FACTOR])))

    def _nats(self, fit: _Fit) -> float:
        """Log-likelihood ratio of a fit to the fit of the rig's model, nats; 0 if it is not a number."""
        nats = 0.5 * (self._unit_scales_fit.cost - fit.cost)
        return nats if np.isfinite(nats) else 0.0


class _EffectFit:
    """An effect of the catalogue in the place of a wrong scale."""

    def __init__(self, kind: EffectSpec, weak_form: FlightInWeakForm, unit_scales_fit: _Fit) -> None:
        self._kind, self._effect, self._unit_scales_fit = kind, kind.make(), unit_scales_fit
        self._weak_form = weak_form.with_effect(self._effect)
        # Parameters of the model are the last unknowns.
        self._first = len(unit_scales_fit.unknowns) - len(weak_form.names)
        self._common = self._weak_form.mean.copy()
        self._common[: self._first] = unit_scales_fit.unknowns[: self._first]
        names = self._weak_form.names
        for name, value in zip(weak_form.names, unit_scales_fit.unknowns[self._first :], strict=True):
            self._common[self._first + names.index(name)] = value

    def _starts(self) -> Iterator[Floats]:
        """Yield start values: its typical size with either sign, at several moments if it has one."""
        kind, moment, names = self._kind, self._effect.moment, self._weak_form.names
        moments_s = [self._weak_form.end_s - share * self._weak_form.duration_s for share in _MOMENTS]
        signs = (1.0,) if kind.is_one_sided else (1.0, -1.0)
        for sign, moment_s in itertools.product(signs, moments_s if moment else (0.0,)):
            start = self._common.copy()
            for name in kind.priors:
                value = moment_s if name == moment else kind.typical[name]
                start[self._first + names.index(name)] = sign * value if name in kind.size else value
            yield start

    def predicted_nats(self, noise: Floats) -> float:
        """Predict the log-likelihood ratio from the first undamped step of a fit, nats."""
        best = 0.0
        for start in self._starts():
            problem = _ScaleProblem(self._weak_form, noise, (), start)
            first = problem.first()
            cost = first.cost - problem.step(first, 0.0).promised
            best = max(best, 0.5 * (self._unit_scales_fit.cost - cost))
        return best

    def explanation(self, noise: Floats) -> Explanation:
        """Fit the effect; a fit whose size is outside its bounds explains nothing."""
        kind, best_nats = self._kind, 0.0
        for start in self._starts():
            fit = _fit_scales(self._weak_form, noise, axes=(), start=start, max_steps=_EFFECT_STEPS)
            values = dict(zip(self._weak_form.names, fit.unknowns[self._first :], strict=True))
            is_possible = all(
                kind.priors[name].low <= values[name] <= kind.priors[name].high for name in kind.size
            )
            nats = 0.5 * (self._unit_scales_fit.cost - fit.cost)
            if is_possible and np.isfinite(nats):
                best_nats = max(best_nats, nats)
        return Explanation(kind.id, best_nats)


def _is_static(kind: EffectSpec) -> bool:
    """Whether an effect acts without states and without noise, and adds to the model."""
    return not (kind.states or kind.noise_inputs or kind.baseline)


def _estimate_scale_of_axis(
    weak_form: FlightInWeakForm, noise: Floats, axis: int, free_scales_fit: _Fit, unit_scales_fit: _Fit
) -> ScaleEstimate:
    """Estimate the scale of one axis, with the other two scales fixed at 1. Shapes: `noise` (3,)."""
    start = free_scales_fit.unknowns.copy()
    start[[other for other in range(3) if other != axis]] = 0.0
    fits = [
        _fit_scales(weak_form, noise, axes=(axis,), start=values)
        for values in (start, unit_scales_fit.unknowns)
    ]
    best = min(fits, key=lambda fit: fit.cost)
    scale = float(np.exp(best.unknowns[axis]))
    standard_error = scale * float(np.sqrt(best.covariance[0, 0]))
    nats = 0.5 * (unit_scales_fit.cost - best.cost)
    return ScaleEstimate(
        AXES[axis], scale, standard_error, nats, best.converged and unit_scales_fit.converged
    )


def _noise_of_axes(weak_form: FlightInWeakForm) -> tuple[Floats, _Fit]:
    """Estimate the noise of each axis from the residuals of a fit in which all scales are free. Returns shape
    `noise` (3,).
    """
    # A wrong scale does then not count as noise.
    noise, unknowns = np.full(3, _FIRST_rad_s2), weak_form.mean
    for _ in range(_NOISE_ROUNDS):
        fit = _fit_scales(weak_form, noise, axes=range(3), start=unknowns)
        unknowns = fit.unknowns
        for axis, residual in enumerate(fit.residuals):
            # Neighbouring residuals are correlated. As for a first-order autoregression, their long-run
            # variance is the variance times (1 + rho) / (1 - rho), with the correlation rho of neighbours.
            variance = float(np.mean(residual**2))
            rho = float(np.mean(residual[1:] * residual[:-1])) / max(variance, 1e-30)
            rho = min(max(rho, 0.0), _MAX_CORRELATION)
            noise[axis] = max(np.sqrt(variance * (1.0 + rho) / (1.0 - rho)), _MIN_rad_s2)
    for axis, residual in enumerate(fit.residuals):
        predicted = weak_form.measured_accelerations(axis) - residual
        # Least squares assume that the voltages are independent of the disturbances, but a control law
        # responds to disturbances (Ljung, chapter 13). This gives the scale a relative error of the order of
        # r, the power of the residuals divided by that of the predicted accelerations. In a hover, for
        # example, the scale of travel is estimated at a quarter of its true value. From n independent
        # residuals alone, the standard error would be sqrt(r / n). The noise is therefore multiplied by
        # sqrt(1 + (c r)^2 n / r), with c = `_FEEDBACK`.
        ratio = float(np.mean(residual**2)) / max(float(np.mean(predicted**2)), 1e-12)
        noise[axis] *= np.sqrt(1.0 + _FEEDBACK**2 * ratio * len(residual))
        # If only disturbances move an axis, a small scale explains its angles as well as any other scale, and
        # makes its residuals small. If the scale is below 1, the residuals are therefore divided by it.
        scale = float(np.exp(unknowns[axis]))
        noise[axis] /= min(1.0, scale)
    return noise, fit


def _fit_scales(
    weak_form: FlightInWeakForm,
    noise: Floats,
    axes: Sequence[int],
    start: Floats,
    max_steps: int = _MAX_STEPS,
) -> _Fit:
    """Fit the scales of the given `axes` together with all other unknowns, from the values `start` on."""
    problem = _ScaleProblem(weak_form, noise, axes, start)
    minimum = minimise(problem, problem.first(), damping=_FIRST_DAMPING, max_steps=max_steps)
    best = minimum.iterate
    covariance = problem.covariance(best)
    return _Fit(problem.unknowns(best.free), covariance, best.cost, best.residuals, minimum.converged)


MAX_SIGMAS: Final = 3.0
"""Distance of a scale from 1, in standard errors, above which there is a warning."""
_MAX_NATS: Final = 0.5 * MAX_SIGMAS**2
"""The same threshold as a log-likelihood ratio. Both must be exceeded: far from 1, a standard error may
be small although a scale of 1 fits as well."""


_LEAD_NATS: Final = _MAX_NATS
"""Log-likelihood ratio by which the scale of an encoder must be more likely than everything else that
explains the flight, nats: what the scale adds to another explanation must be significant by itself. Lower:
healthy encoders are named in the place of a supply that sags. Higher: wrong encoders are not named."""
_MAX_NAMES: Final = 4
"""Most explanations that a text lists."""


def wrong_scale(estimates: Sequence[ScaleEstimate]) -> ScaleEstimate | None:
    """Return the encoder scale that differs from 1 most clearly; None if no difference is significant."""
    significant = [
        estimate
        for estimate in estimates
        if estimate.converged and estimate.sigmas > MAX_SIGMAS and estimate.nats > _MAX_NATS
    ]
    return max(significant, key=lambda estimate: estimate.nats, default=None)


def finding_of(wrong: ScaleEstimate, explanations: Sequence[Explanation]) -> FlightFinding:
    """Return the finding for an encoder that counts otherwise than the rig's model predicts."""
    best_nats = max([wrong.nats, *(other.nats for other in explanations)])
    # What is not significant by itself explains nothing, even if the scale is hardly significant either.
    others = [other for other in explanations if other.nats > max(best_nats - _LEAD_NATS, _MAX_NATS)]
    is_encoder_likely = wrong.nats > best_nats - _LEAD_NATS
    if not others:
        name = f"{wrong.axis}_encoder_scale"
        return FlightFinding(name, wrong.scale, wrong.standard_error, warning_text(wrong))
    text = _common_text(wrong, others, is_encoder_likely)
    return FlightFinding(f"{wrong.axis}_motion", wrong.scale, wrong.standard_error, text)


def warning_text(estimate: ScaleEstimate) -> str:
    """Return the warning that an encoder counts wrong, as a text for readers."""
    return (
        f"{estimate.axis} encoder: it counts {_ratio_text(estimate)} times what the rig's model predicts; "
        f"check {estimate.axis}_counts_per_rev and the rig's file"
    )


def _common_text(wrong: ScaleEstimate, others: Sequence[Explanation], is_encoder_likely: bool) -> str:
    """Return the warning that a flight does not fit its rig, for a reason that may be no encoder."""
    names = [_explanation_text(other) for other in others]
    if len(names) > _MAX_NAMES:
        names = [*names[: _MAX_NAMES - 1], f"{len(names) - _MAX_NAMES + 1} other effects of the catalogue"]
    if is_encoder_likely:
        names.append(f"{wrong.axis}_counts_per_rev")
    reasons = f"{', '.join(names[:-1])} or {names[-1]}" if len(names) > 1 else names[0]
    certainty = "this flight does not show which" if len(names) > 1 else "no encoder explains it as well"
    has_supply = any(other.name == _WRONG_SUPPLY for other in others)
    remedy = "check supply_V and the rig's file" if has_supply else "find the cause with heli-host diagnose"
    return (
        f"{wrong.axis} moves {_ratio_text(wrong)} times as far as the rig's model predicts, probably because "
        f"of {reasons}: {certainty}; {remedy}"
    )


def _explanation_text(explanation: Explanation) -> str:
    """Name an explanation: an effect by its id, a supply with the factor on the voltages."""
    if explanation.name == _WRONG_SUPPLY:
        return f"a wrong supply_V (the motors act as if they had {explanation.factor:.2g} times the voltage)"
    return explanation.name


def _ratio_text(estimate: ScaleEstimate) -> str:
    """Write a scale with its standard error."""
    digits = max(2, min(4, -math.floor(math.log10(estimate.standard_error))))
    return f"{estimate.scale:.{digits}f} ± {estimate.standard_error:.{digits}f} (1 standard error)"


def check_flight(flight: Flight, rig: str) -> list[FlightFinding]:
    """Check the scales of all encoders with a finished flight."""
    rig_file = load_rig(rig)
    model = model_named(rig_file.model or "multibody", effects_of(rig_file))
    test = ScaleTest(FlightInWeakForm(flight, rig_file, model))
    wrong = wrong_scale(test.estimates)
    if wrong is None:
        return []  # no scale is wrong
    return [finding_of(wrong, test.explanations(possible_effects(model)))]


def possible_effects(model: Model) -> list[EffectSpec]:
    """Return the effects of the catalogue that a model may have in addition."""
    kinds = catalogue()
    present = {effect.name for effect in model.effects}
    return [
        kind
        for kind in kinds.values()
        if kind.id not in present
        and kind.suits(model)
        and all(kind.compatible_with(kinds[name]) for name in present if name in kinds)
    ]
