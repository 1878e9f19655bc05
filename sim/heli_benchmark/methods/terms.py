"""Offers what methods share that regress accelerations: smoothed flights, candidate terms, torques."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig
from scipy.signal import fftconvolve, savgol_coeffs

from heli_benchmark.task import UNLISTED, AxisSeries, BenchmarkCase, Estimate, flight_name, series_content

GRID_s: Final = 0.1
"""Step of the regression. The disturbances are correlated over 0.3 s and more."""
_WINDOW_s: Final = 0.4
"""Length of the smoothing filter. Shorter: the counts of the encoders dominate at 100 Hz. Longer: it removes
the excitation, which ends at 4 Hz. By judgement, not tuned."""


class SmoothedFlight:
    """Angles, rates and accelerations of a flight, smoothed by a Savitzky-Golay filter.

    Shapes: `t_s` (n,), `signals` (n, 8): angles, rates and voltages; at the k rows of the regression,
    `acceleration` (k, 3) and `features` (k, 8), which are the signals there.
    """

    def __init__(self, flight: Flight, weak_form: bool = False) -> None:
        # The filter loses half a window at each end. The regression loses a further one, because
        # `filtered` passes signals through the filter a second time.
        step_s = float(flight.t_s[-1] - flight.t_s[0]) / (len(flight) - 1)
        half = round(_WINDOW_s / 2.0 / step_s)
        smooth, first, second = _smoothing_kernels(half, step_s)
        self.angles_rad = _convolve(flight.angles_rad, smooth)
        self.rates_rad_s = _convolve(flight.angles_rad, first)
        self._kernel = smooth
        if weak_form:
            self._kernel, second = _weak_kernels(half, step_s)
        self.volts_V = flight.voltages_V[half : len(flight) - half]
        self.t_s = flight.t_s[half : len(flight) - half] - flight.t_s[0]
        self._grid_rows = slice(half, len(self.t_s) - half, max(1, round(GRID_s / step_s)))
        self._half_window = half
        self.volt_rates_V_s = np.gradient(self.volts_V, step_s, axis=0)
        self.acceleration = _convolve(flight.angles_rad, second)[self._grid_rows]
        self.signals = np.hstack([self.angles_rad, self.rates_rad_s, self.volts_V])
        self.features = self.signals[self._grid_rows]

    def filtered(self, values: Floats) -> Floats:
        """Pass values along the flight through the filter of the accelerations. Shapes: `values` (n, ...);
        returns (k, ...).
        """
        flat = values.reshape(len(values), -1)
        padded = np.pad(_convolve(flat, self._kernel), ((self._half_window, self._half_window), (0, 0)))
        return padded[self._grid_rows].reshape(-1, *values.shape[1:])


class AccelerationModel:
    """Accelerations of a model along a flight, and their derivatives by parameters."""

    def __init__(self, model: Model, rig: Rig) -> None:
        self.names = model.parameter_names
        self._values = np.array(model.parameter_values(rig))
        self._states = len(model.states)
        x, u = ca.SX.sym("x", self._states), ca.SX.sym("u", 2)
        self._p, t = ca.SX.sym("p", len(self.names)), ca.SX.sym("t")
        self._accelerations = model.dynamics(x, u, self._p, t)[3:6]
        self._arguments, self._u = [x, u, self._p, t], u
        self._functions: dict[tuple[str, ...], ca.Function] = {}

    def acceleration(self, flight: SmoothedFlight) -> Floats:
        """Return the accelerations of the three axes along a `flight`, rad/s2, shape (n, 3)."""
        return self._evaluate_along(flight, ("acceleration",), self._accelerations)[:, :, 0]

    def jacobian(
        self, flight: SmoothedFlight, names: Sequence[str], changed_values: Mapping[str, float] | None = None
    ) -> Floats:
        """Return the derivatives of the accelerations by some parameters, shape (n, 3, names);
        `changed_values` replace those of the rig.
        """
        parameters = ca.vertcat(*(self._p[self.names.index(name)] for name in names))
        derivatives = ca.jacobian(self._accelerations, parameters)
        return self._evaluate_along(flight, tuple(names), derivatives, changed_values)

    def by_torques(self, flight: SmoothedFlight) -> Floats:
        """Return the derivatives along a `flight` by torques about the three axes, shape (n, 3, 3)."""
        return self.jacobian(flight, [f"torque_{axis}" for axis in AXES])

    def by_volts(self, flight: SmoothedFlight) -> Floats:
        """Return the derivatives along a `flight` by the two voltages, shape (n, 3, 2)."""
        return self._evaluate_along(flight, ("volts",), ca.jacobian(self._accelerations, self._u))

    def _evaluate_along(
        self,
        flight: SmoothedFlight,
        key: tuple[str, ...],
        expression: ca.SX,
        changed_values: Mapping[str, float] | None = None,
    ) -> Floats:
        """Evaluate an `expression` of shape (3, m) along a flight, shape (n, 3, m)."""
        if key not in self._functions:
            self._functions[key] = ca.Function("f", self._arguments, [ca.densify(expression)])
        n, values = len(flight.t_s), self._values.copy()
        for name, value in (changed_values or {}).items():
            values[self.names.index(name)] = value
        states = np.zeros((self._states, n))
        states[:3], states[3:6] = flight.angles_rad.T, flight.rates_rad_s.T
        # CasADi evaluates all n columns in one call, and puts the n results of shape (3, m) side by side.
        result = self._functions[key](states, flight.volts_V.T, values, flight.t_s[None])
        return np.asarray(result).reshape(3, n, -1).transpose(1, 0, 2)


def _smoothing_kernels(half_window: int, step_s: float) -> tuple[Floats, Floats, Floats]:
    """Return the filters that give a smoothed signal and its first and second derivative."""
    # They fit a polynomial of degree 3 to the 2 `half_window` + 1 samples around each sample.
    window = 2 * half_window + 1
    smooth, first, second = (savgol_coeffs(window, 3, deriv=order, delta=step_s) for order in range(3))
    return smooth, first, second


def _weak_kernels(half_window: int, step_s: float) -> tuple[Floats, Floats]:
    """Return the test function (1 - x^2)^4, and its second derivative."""
    # In the weak form, a signal is averaged with the test function as its weight. Integrating by parts twice
    # moves the second derivative from the angles, which are noisy, to the test function.
    x = np.arange(-half_window, half_window + 1) / (half_window + 1.0)
    x_per_s = 1.0 / ((half_window + 1.0) * step_s)
    test = (1.0 - x**2) ** 4
    second = 8.0 * (1.0 - x**2) ** 2 * (7.0 * x**2 - 1.0)
    total = test.sum()
    return test / total, second * x_per_s**2 / total


def _convolve(values: Floats, kernel: Floats) -> Floats:
    """Pass each column of `values`, shape (n, columns), through a filter; the incomplete ends are lost."""
    return np.asarray(fftconvolve(values, kernel[:, None], mode="valid", axes=0))


_MOMENTS_s: Final = (15.0, 17.0, 19.0, 21.0, 23.0, 25.0, 27.0)
_FREQUENCIES_Hz: Final = tuple(np.arange(0.3, 2.51, 0.1))
_SAME_SHAPE: Final = 0.98
"""Correlation from which two terms are the same. The torque of a spring, for example, is proportional to an
angle, as one of the shapes is."""
_LAG_PARAMETERS: Final = {"rotor_lag": "rotor_lag_s", "input_delay": "input_delay_s"}


@dataclass(frozen=True)
class Term:
    """A candidate for the regression: the accelerations that a cause of size 1 adds to the nominal model."""

    cause: str  # Name of the cause
    parameters: tuple[str, ...]
    """Parameters whose estimates are the coefficients; empty for a term of an unlisted cause."""
    columns: Floats
    """(n, k): Changes of the accelerations per unit of each parameter, whitened; rows as in
    `ResidualRegression.target`."""
    axis: str = ""
    """axis, shape: Axis and shape of the torque of an unlisted cause; its coefficient is in N m."""
    shape: str = ""


@dataclass(frozen=True)
class Standardisation:
    """Scales of residuals and features."""

    residual_std: Floats  # (3,): Standard deviations of the residuals by axis, rad/s2
    feature_mean: Floats  # feature_mean, feature_std: (8,): Means and standard deviations of the features
    feature_std: Floats


@dataclass(frozen=True)
class RegressionFit:
    """Least-squares fit of some terms."""

    bic: float  # Bayesian information criterion; lower is better
    coefficients: Floats
    """coefficients, stds: (k,): Coefficients, and their standard errors: one per column of each term, in the
    order of the terms."""
    stds: Floats


@dataclass(frozen=True)
class ResidualRegression:
    """Residual accelerations of the nominal model, scaled and whitened, and the terms that may explain
    them.
    """

    target: Floats  # (n,): Residuals, over flights, axes and moments
    nuisance: Floats
    """(n, m): Changes by one standard deviation of each parameter of the rig that has a tolerance."""
    terms: list[Term]  # Candidates; a cause with an unknown moment or frequency has several
    residuals: Floats
    """(k, 3): Residuals after a fit of the nuisance parameters, before they are whitened, by axis."""
    features: Floats
    """(k, 8): Angles, rates and voltages at the same moments, each with mean 0 and variance 1."""
    rig_priors: Mapping[str, Estimate]  # Nominal value and standard deviation of each of these parameters
    standardisation: Standardisation  # How `residuals` and `features` were scaled

    def parameters(self, terms: Sequence[Term]) -> dict[str, Estimate]:
        """Estimate the parameters of the rig and of some terms together."""
        fit = self._fit_all(terms)
        count = len(self.rig_priors)
        # Coefficients of the nuisance parameters are in standard deviations of their priors.
        rig = {
            name: Estimate(float(prior.value + shift * prior.std), float(error * prior.std))
            for (name, prior), shift, error in zip(
                self.rig_priors.items(), fit.coefficients, fit.stds, strict=False
            )
        }
        # A term of an unlisted cause has no parameter: its coefficients get no name.
        names = [name for term in terms for name in term.parameters or ("",) * term.columns.shape[1]]
        sizes = {
            name: Estimate(float(value), float(std))
            for name, value, std in zip(names, fit.coefficients[count:], fit.stds[count:], strict=True)
            if name and std > 0.0
        }
        return {name: estimate for name, estimate in rig.items() if estimate.std > 0.0} | sizes

    def best_term(self, cause: str) -> Term:
        """Return the term of a `cause` whose fit, without other terms, has the lowest criterion."""
        terms = [term for term in self.terms if term.cause == cause]
        return min(terms, key=lambda term: self.fit([term]).bic)

    def fit(self, terms: Sequence[Term]) -> RegressionFit:
        """Fit some terms and all nuisance parameters, and return the coefficients of the terms."""
        fit, count = self._fit_all(terms), self.nuisance.shape[1]
        return RegressionFit(fit.bic, fit.coefficients[count:], fit.stds[count:])

    def _fit_all(self, terms: Sequence[Term]) -> RegressionFit:
        """Fit as `fit`; the coefficients of the nuisance parameters come first."""
        design = np.column_stack([self.nuisance, *(term.columns for term in terms)])
        n, nuisance_count = len(self.target), self.nuisance.shape[1]
        term_column_count = design.shape[1] - nuisance_count
        # The prior of a nuisance parameter, mean 0 and standard deviation 1, is one more row with target 0.
        prior_rows = np.eye(nuisance_count, design.shape[1])
        inverse = np.linalg.pinv(design.T @ design + prior_rows.T @ prior_rows)
        coefficients = inverse @ (design.T @ self.target)
        residual = self.target - design @ coefficients
        prior_residual = coefficients[:nuisance_count]
        squares = float(residual @ residual + prior_residual @ prior_residual)
        return RegressionFit(
            # Nuisance parameters are in every fit, so they add nothing to the difference of two fits.
            bic=n * np.log(squares / n) + term_column_count * np.log(n),
            coefficients=coefficients,
            stds=np.sqrt(np.diag(inverse) * squares / n),
        )


def residual_regression(case: BenchmarkCase, weak_form: bool = False) -> ResidualRegression:
    """Build the regression of a case from its training flights."""
    rig = case.rig
    smooth = [SmoothedFlight(flight, weak_form) for flight in case.training]
    nominal = AccelerationModel(MultibodyModel(), rig)
    nuisance_names = [name for name in nominal.names if name in rig and rig[name].tolerance]
    # For least squares: target, nuisance and terms. The target is the measured minus the nominal
    # accelerations, shape (k, 3); a tolerance is two standard deviations.
    target = np.concatenate(
        [motion.acceleration - motion.filtered(nominal.acceleration(motion)) for motion in smooth]
    )
    stds = np.array([0.5 * rig[name].tolerance for name in nuisance_names])
    nuisance = np.concatenate(
        [motion.filtered(nominal.jacobian(motion, nuisance_names) * stds) for motion in smooth]
    )
    drafts = [
        *_listed_terms(case, smooth),
        *_lag_terms(case, smooth, nominal),
        *_unlisted_terms(smooth, nominal),
    ]
    # Scale each axis to its noise and whiten, from the residuals of a fit of the nuisance parameters alone.
    fitted = np.stack([_residual_after_fit(target[:, i], nuisance[:, i]) for i in range(3)], axis=1)
    correlation = min(max(_step_correlation(fitted), 0.0), 0.95)  # at 1, whitening would remove all
    scale = 1.0 / (fitted.std(axis=0) * np.sqrt(1.0 - correlation**2))

    def white(values: Floats) -> Floats:
        """Scale axis 1 of `values`, shape (k, 3, ...), and subtract the predictable part of each row."""
        scaled = (values.swapaxes(1, -1) * scale).swapaxes(1, -1)
        return np.asarray((scaled[1:] - correlation * scaled[:-1]).reshape(-1, *values.shape[2:]))

    terms = [replace(term, columns=white(term.columns)) for term in drafts]
    # For learned methods: residuals and features with a standard deviation of 1.
    features = np.concatenate([motion.features for motion in smooth])
    scales = Standardisation(fitted.std(axis=0), features.mean(axis=0), features.std(axis=0))
    features = (features - scales.feature_mean) / scales.feature_std
    priors = {name: Estimate(rig[name].value, 0.5 * rig[name].tolerance) for name in nuisance_names}
    residuals = fitted / scales.residual_std
    return ResidualRegression(
        white(target),
        white(nuisance),
        terms=_useful_terms(terms),
        residuals=residuals,
        features=features,
        rig_priors=priors,
        standardisation=scales,
    )


def _useful_terms(terms: Sequence[Term]) -> list[Term]:
    """Return the terms that are not constant: first the listed ones, then those that no listed one equals."""
    varying = [term for term in terms if np.isfinite(term.columns).all() and term.columns.std() > 1e-9]
    listed = [term for term in varying if term.parameters]
    return listed + [term for term in varying if not term.parameters and not _is_listed(term, listed)]


def _listed_terms(case: BenchmarkCase, smooth: Sequence[SmoothedFlight]) -> list[Term]:
    """Return the terms of the causes in the catalogue that act as forces and add no state to the model."""
    kinds = catalogue()
    drafts: list[Term] = []
    for cause in case.causes.listed:
        spec = kinds[cause]
        if spec.states or spec.acts_on.startswith("measurement") or not spec.suits(MultibodyModel()):
            continue
        names = [parameter.name for parameter in spec.parameters]
        sizes = tuple(spec.size) or (names[0],)
        # An unknown moment or frequency is not linear: each trial value gives a term.
        trial_values: list[dict[str, float]] = [{}]
        if f"{spec.prefix}_at_s" in names:
            trial_values = [{f"{spec.prefix}_at_s": at_s} for at_s in _MOMENTS_s]
        elif f"{spec.prefix}_Hz" in names:
            trial_values = [{f"{spec.prefix}_Hz": float(Hz)} for Hz in _FREQUENCIES_Hz]
        with_effect = AccelerationModel(MultibodyModel((spec.make(),)), case.rig)
        for changed_values in trial_values:
            columns = [
                motion.filtered(with_effect.jacobian(motion, sizes, changed_values)) for motion in smooth
            ]
            drafts.append(Term(cause, sizes, np.concatenate(columns)))
    return drafts


def _lag_terms(
    case: BenchmarkCase, smooth: Sequence[SmoothedFlight], nominal: AccelerationModel
) -> list[Term]:
    """Return the terms of the lag and of the delay of the thrust."""
    # Voltages that act T seconds late differ, to first order, by -T times their derivative.
    by_lag = [
        motion.filtered(-np.einsum("nij,nj->ni", nominal.by_volts(motion), motion.volt_rates_V_s)[:, :, None])
        for motion in smooth
    ]
    return [
        Term(cause, (name,), np.concatenate(by_lag))
        for cause, name in _LAG_PARAMETERS.items()
        if cause in case.causes.listed
    ]


def _unlisted_terms(smooth: Sequence[SmoothedFlight], nominal: AccelerationModel) -> list[Term]:
    """Return terms that an unlisted cause may have: torques that are products of angles and rates."""
    terms: list[Term] = []
    by_torques = [nominal.by_torques(motion) for motion in smooth]
    shapes_by_flight = [shapes_of(motion) for motion in smooth]
    for i, axis in enumerate(AXES):
        for shape in shapes_by_flight[0]:
            columns = [
                motion.filtered(by_torque[:, :, [i]] * shapes[shape][:, None, None])
                for motion, by_torque, shapes in zip(smooth, by_torques, shapes_by_flight, strict=True)
            ]
            terms.append(Term(UNLISTED, (), np.concatenate(columns), axis, shape))
    return terms


def shapes_of(flight: SmoothedFlight) -> dict[str, Floats]:
    """Return products of angles and rates along a flight by their text, each of shape (n,)."""
    signals = dict(zip(AXES, flight.angles_rad.T, strict=True)) | {
        f"{axis}_rate": rate for axis, rate in zip(AXES, flight.rates_rad_s.T, strict=True)
    }
    rates = [name for name in signals if name not in AXES]
    pairs = (("elevation", "pitch"), ("elevation", "travel_rate"), ("pitch", "elevation_rate"))
    return {
        **signals,
        **{f"sin(2 {axis})": np.sin(2.0 * signals[axis]) for axis in AXES},
        **{f"{rate} |{rate}|": signals[rate] * np.abs(signals[rate]) for rate in rates},
        **{f"{name}^2": values**2 for name, values in signals.items()},
        **{f"{first} {second}": signals[first] * signals[second] for first, second in pairs},
    }


def _is_listed(term: Term, listed: Sequence[Term]) -> bool:
    """Whether a listed cause has the same shape, so that the term is no evidence for an unlisted cause."""
    column = term.columns[:, 0] / np.linalg.norm(term.columns)
    return any(
        abs(column @ other / np.linalg.norm(other)) > _SAME_SHAPE
        for cause in listed
        for other in cause.columns.T
    )


def _residual_after_fit(target: Floats, nuisance: Floats) -> Floats:
    """Return what remains of `target` after a least-squares fit of the `nuisance` columns."""
    solution = np.linalg.lstsq(nuisance, target, rcond=1e-6)[0]
    return np.asarray(target - nuisance @ solution)


def _step_correlation(residuals: Floats) -> float:
    """Return the correlation of residuals with those one step later, over all axes."""
    before, after = residuals[:-1], residuals[1:]
    return float((before * after).sum() / (before * before).sum())


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
        return {}  # all terms are those of listed causes

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
