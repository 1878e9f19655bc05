"""Candidate terms for methods that regress accelerations: what each cause adds to the nominal model.

Accelerations come from measured angles by a smoothing filter; the model and all terms pass the same filter. A
term is the derivative of the model's accelerations by the size of a cause, from the catalogue of `heli_sim`.
Causes in an encoder or with a state of their own have no such term. The lag and the delay of the thrust have
one: the derivative of the voltages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Model
from heli_sim.model.effects import catalogue
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig
from scipy.signal import savgol_coeffs

from heli_benchmark.task import UNLISTED, BenchmarkCase, Estimate

GRID_s: Final = 0.1
"""Step of the regression. The disturbances are correlated over 0.3 s and more."""
_WINDOW_s: Final = 0.4
"""Length of the smoothing filter. Shorter: the counts of the encoders dominate at 100 Hz. Longer: it removes
the excitation, which ends at 4 Hz. By judgement, not tuned."""
_MOMENTS: Final = (15.0, 17.0, 19.0, 21.0, 23.0, 25.0, 27.0)
_FREQUENCIES_Hz: Final = tuple(np.arange(0.3, 2.51, 0.1))
_SAME_SHAPE: Final = 0.98
"""Correlation from which two terms are the same. The torque of a spring, for example, is proportional to an
angle, as one of the shapes is."""
_LATE: Final = {"rotor_lag": "rotor_lag_s", "input_delay": "input_delay_s"}


@dataclass(frozen=True)
class Term:
    """A candidate.

    Parameters
    ----------
    cause : str
        Name of the cause.
    parameters : tuple of str
        Parameters whose estimates are the coefficients; empty for a term of an unlisted cause.
    columns : ndarray (n, k)
        Changes of the accelerations per unit of each parameter, whitened.
    """

    cause: str
    parameters: tuple[str, ...]
    columns: Floats


@dataclass(frozen=True)
class ResidualRegression:
    """Residual accelerations of the nominal model, scaled and whitened, and the terms that may explain them.

    Parameters
    ----------
    target : ndarray (n,)
        Residuals, over flights, axes and moments.
    nuisance : ndarray (n, m)
        Changes by one standard deviation of each parameter of the rig that has a tolerance.
    rig_priors : Mapping[str, Estimate]
        Nominal value and standard deviation of each of these parameters.
    terms : list of Term
        Candidates; a cause with an unknown moment or frequency has several.
    residuals : ndarray (k, 3)
        Residuals after a fit of the nuisance parameters, before they are whitened, by axis.
    features : ndarray (k, 8)
        Angles, rates and voltages at the same moments, each with mean 0 and variance 1.
    """

    target: Floats
    nuisance: Floats
    terms: list[Term]
    residuals: Floats
    features: Floats
    rig_priors: Mapping[str, Estimate]

    def parameters(self, terms: Sequence[Term]) -> dict[str, Estimate]:
        """Estimate the parameters of the rig and of some terms together.

        Parameters
        ----------
        terms : sequence of Term
            Terms of the fit.
        """
        _, solution, stds = self._solved(terms)
        count = len(self.rig_priors)
        rig = {
            name: Estimate(float(prior.value + shift * prior.std), float(error * prior.std))
            for (name, prior), shift, error in zip(self.rig_priors.items(), solution, stds, strict=False)
        }
        names = [name for term in terms for name in term.parameters or ("",) * term.columns.shape[1]]
        sizes = {
            name: Estimate(float(value), float(std))
            for name, value, std in zip(names, solution[count:], stds[count:], strict=True)
            if name and std > 0.0
        }
        return {name: of for name, of in rig.items() if of.std > 0.0} | sizes

    def best_term(self, cause: str) -> Term:
        """Return the term of a `cause` that lowers the criterion most alone."""
        terms = [term for term in self.terms if term.cause == cause]
        return min(terms, key=lambda term: self.fit([term])[0])

    def fit(self, terms: Sequence[Term]) -> tuple[float, Floats, Floats]:
        """Fit some terms and all nuisance parameters.

        Parameters
        ----------
        terms : sequence of Term
            Terms of the fit.

        Returns
        -------
        tuple of float, ndarray and ndarray
            Bayesian information criterion, coefficients of the terms, and their standard errors.
        """
        bic, solution, stds = self._solved(terms)
        m = self.nuisance.shape[1]
        return bic, solution[m:], stds[m:]

    def _solved(self, terms: Sequence[Term]) -> tuple[float, Floats, Floats]:
        columns = [self.nuisance, *(term.columns for term in terms)]
        design = np.column_stack(columns)
        n, m = len(self.target), self.nuisance.shape[1]
        # Priors of the nuisance parameters are further rows: standard deviation 1.
        prior = np.eye(m, design.shape[1])
        normal = design.T @ design + prior.T @ prior
        inverse = np.linalg.pinv(normal)
        solution = inverse @ (design.T @ self.target)
        rest = self.target - design @ solution
        squares = float(rest @ rest + solution[:m] @ solution[:m])
        count = design.shape[1] - m
        stds = np.sqrt(np.diag(inverse) * squares / n)
        return n * np.log(squares / n) + count * np.log(n), solution, stds


def residual_regression(case: BenchmarkCase, weak_form: bool = False) -> ResidualRegression:
    """Build the regression of a case from its training flights.

    Parameters
    ----------
    weak_form : bool
        Whether integrals with test functions replace smoothed accelerations.
    """
    rig = case.rig
    smooth = [_Smoothed(flight, weak_form) for flight in case.training]
    plain = _Model(MultibodyModel(), rig)
    nuisance_names = [name for name in plain.names if name in rig and rig[name].tolerance]
    target = _stack([motion.acceleration - motion.filtered(plain.acceleration(motion)) for motion in smooth])
    stds = np.array([0.5 * rig[name].tolerance for name in nuisance_names])
    nuisance = _stack([motion.filtered(plain.jacobian(motion, nuisance_names) * stds) for motion in smooth])
    drafts = [*_listed(case, smooth), *_late(case, smooth, plain), *_generic(smooth, plain)]
    # Scale each axis to its noise and whiten, from the residuals of a fit of the nuisance parameters alone.
    fitted = np.stack([_fitted(target[:, i], nuisance[:, i]) for i in range(3)], axis=1)
    lag = min(max(_correlation(fitted), 0.0), 0.95)
    scale = 1.0 / (fitted.std(axis=0) * np.sqrt(1.0 - lag**2))

    def white(values: Floats) -> Floats:
        scaled = (values.swapaxes(1, -1) * scale).swapaxes(1, -1)
        return np.asarray((scaled[1:] - lag * scaled[:-1]).reshape(-1, *values.shape[2:]))

    terms = [Term(cause, names, white(columns)) for cause, names, columns in drafts]
    useful = [term for term in terms if np.isfinite(term.columns).all() and term.columns.std() > 1e-9]
    listed = [term for term in useful if term.parameters]
    useful = listed + [term for term in useful if not term.parameters and not _is_listed(term, listed)]
    features = np.concatenate([motion.features for motion in smooth])
    features = (features - features.mean(axis=0)) / features.std(axis=0)
    priors = {name: Estimate(rig[name].value, 0.5 * rig[name].tolerance) for name in nuisance_names}
    residuals = fitted / fitted.std(axis=0)
    return ResidualRegression(white(target), white(nuisance), useful, residuals, features, priors)


class _Smoothed:
    """A flight, smoothed, with all times on the grid of the regression."""

    def __init__(self, flight: Flight, weak_form: bool) -> None:
        step_s = float(flight.t_s[-1] - flight.t_s[0]) / (len(flight) - 1)
        half = round(_WINDOW_s / 2.0 / step_s)
        self._kernels = _weak_kernels(half, step_s) if weak_form else _smoothing_kernels(half, step_s)
        self.angles_rad = _through(flight.angles_rad, _smoothing_kernels(half, step_s)[0])
        self.rates_rad_s = _through(flight.angles_rad, _smoothing_kernels(half, step_s)[1])
        self.volts_V = flight.voltages_V[half : len(flight) - half]
        self.t_s = flight.t_s[half : len(flight) - half] - flight.t_s[0]
        self._pick = slice(half, len(self.t_s) - half, max(1, round(GRID_s / step_s)))
        self._half = half
        self.volt_rates_V_s = np.gradient(self.volts_V, step_s, axis=0)
        self.acceleration = _through(flight.angles_rad, self._kernels[2])[self._pick]
        self.features = np.hstack([self.angles_rad, self.rates_rad_s, self.volts_V])[self._pick]

    def filtered(self, values: Floats) -> Floats:
        """Pass values along the flight through the filter of the accelerations."""
        flat = values.reshape(len(values), -1)
        padded = np.pad(_through(flat, self._kernels[0]), ((self._half, self._half), (0, 0)))
        return padded[self._pick].reshape(-1, *values.shape[1:])


class _Model:
    """Accelerations of a model along a flight, and their derivatives by parameters."""

    def __init__(self, model: Model, rig: Rig) -> None:
        self.names = model.parameter_names
        self._values = np.array(model.parameter_values(rig))
        self._states = len(model.states)
        x, u = ca.SX.sym("x", self._states), ca.SX.sym("u", 2)
        self._p, t = ca.SX.sym("p", len(self.names)), ca.SX.sym("t")
        self._out = model.dynamics(x, u, self._p, t)[3:6]
        self._arguments, self._u = [x, u, self._p, t], u
        self._functions: dict[tuple[str, ...], ca.Function] = {}

    def acceleration(self, flight: _Smoothed) -> Floats:
        return self._evaluated(flight, ("acceleration",), self._out)[:, :, 0]

    def jacobian(
        self, flight: _Smoothed, names: Sequence[str], place: Mapping[str, float] | None = None
    ) -> Floats:
        """Return the derivatives by parameters at the parameters in `place`, shape (n, 3, names)."""
        by = ca.vertcat(*(self._p[self.names.index(name)] for name in names))
        return self._evaluated(flight, tuple(names), ca.jacobian(self._out, by), place)

    def by_volts(self, flight: _Smoothed) -> Floats:
        return self._evaluated(flight, ("volts",), ca.jacobian(self._out, self._u))

    def _evaluated(
        self,
        flight: _Smoothed,
        key: tuple[str, ...],
        expression: ca.SX,
        place: Mapping[str, float] | None = None,
    ) -> Floats:
        if key not in self._functions:
            self._functions[key] = ca.Function("f", self._arguments, [ca.densify(expression)])
        n, values = len(flight.t_s), self._values.copy()
        for name, value in (place or {}).items():
            values[self.names.index(name)] = value
        states = np.zeros((self._states, n))
        states[:3], states[3:6] = flight.angles_rad.T, flight.rates_rad_s.T
        result = self._functions[key](states, flight.volts_V.T, values, flight.t_s[None])
        return np.asarray(result).reshape(3, n, -1).transpose(1, 0, 2)


Draft = tuple[str, tuple[str, ...], Floats]


def _listed(case: BenchmarkCase, smooth: Sequence[_Smoothed]) -> list[Draft]:
    """Terms of the causes of the catalogue that act as forces without a state of their own."""
    kinds, drafts = catalogue(), []
    for cause in case.causes.listed:
        spec = kinds[cause]
        if spec.states or spec.acts_on.startswith("measurement") or not spec.suits(MultibodyModel()):
            continue
        names = [parameter.name for parameter in spec.parameters]
        sizes = tuple(spec.size) or (names[0],)
        places: list[dict[str, float]] = [{}]
        if f"{spec.prefix}_at_s" in names:
            places = [{f"{spec.prefix}_at_s": at_s} for at_s in _MOMENTS]
        elif f"{spec.prefix}_Hz" in names:
            places = [{f"{spec.prefix}_Hz": float(Hz)} for Hz in _FREQUENCIES_Hz]
        of = _Model(MultibodyModel((spec.make(),)), case.rig)
        for place in places:
            columns = [motion.filtered(of.jacobian(motion, sizes, place)) for motion in smooth]
            drafts.append((cause, sizes, _stack(columns)))
    return drafts


def _late(case: BenchmarkCase, smooth: Sequence[_Smoothed], plain: _Model) -> list[Draft]:
    """Terms of a lag or a delay: thrust is late by a time that multiplies the voltages' derivative."""
    late = [
        motion.filtered(-np.einsum("nij,nj->ni", plain.by_volts(motion), motion.volt_rates_V_s)[:, :, None])
        for motion in smooth
    ]
    return [(cause, (name,), _stack(late)) for cause, name in _LATE.items() if cause in case.causes.listed]


def _generic(smooth: Sequence[_Smoothed], plain: _Model) -> list[Draft]:
    """Torques that are products of angles and rates: what an unlisted cause may look like."""
    drafts: list[Draft] = []
    pushes = [plain.jacobian(motion, [f"torque_{axis}" for axis in AXES]) for motion in smooth]
    for i in range(3):
        for shapes in zip(*(_shapes(motion) for motion in smooth), strict=True):
            parts = [push[:, :, i] * shape[:, None] for push, shape in zip(pushes, shapes, strict=True)]
            columns = [motion.filtered(part[:, :, None]) for motion, part in zip(smooth, parts, strict=True)]
            drafts.append((UNLISTED, (), _stack(columns)))
    return drafts


def _shapes(flight: _Smoothed) -> list[Floats]:
    q, w = flight.angles_rad.T, flight.rates_rad_s.T
    singles = [*q, *w, *(np.sin(2.0 * x) for x in q), *(x * np.abs(x) for x in w)]
    return [*singles, *(x**2 for x in (*q, *w)), q[0] * q[1], q[0] * w[2], q[1] * w[0]]


def _is_listed(term: Term, listed: Sequence[Term]) -> bool:
    """Whether a listed cause has the same shape, so that the term says nothing of an unlisted one."""
    column = term.columns[:, 0] / np.linalg.norm(term.columns)
    return any(
        abs(column @ other / np.linalg.norm(other)) > _SAME_SHAPE
        for cause in listed
        for other in cause.columns.T
    )


def _stack(parts: Sequence[Floats]) -> Floats:
    return np.concatenate(parts)


def _smoothing_kernels(half: int, step_s: float) -> tuple[Floats, Floats, Floats]:
    window = 2 * half + 1
    zero, first, second = (savgol_coeffs(window, 3, deriv=d, delta=step_s) for d in range(3))
    return zero, first, second


def _weak_kernels(half: int, step_s: float) -> tuple[Floats, Floats, Floats]:
    """Test function, and its derivatives, which take the place of derivatives of the angles."""
    place = np.arange(-half, half + 1) / (half + 1.0)
    unit = 1.0 / ((half + 1.0) * step_s)
    test = (1.0 - place**2) ** 4
    second = 8.0 * (1.0 - place**2) ** 2 * (7.0 * place**2 - 1.0)
    total = test.sum()
    return test / total, np.zeros_like(test), second * unit**2 / total


def _through(values: Floats, kernel: Floats) -> Floats:
    from scipy.signal import fftconvolve

    return np.asarray(fftconvolve(values, kernel[:, None], mode="valid", axes=0))


def _fitted(target: Floats, nuisance: Floats) -> Floats:
    solution = np.linalg.lstsq(nuisance, target, rcond=1e-6)[0]
    return np.asarray(target - nuisance @ solution)


def _correlation(residuals: Floats) -> float:
    before, after = residuals[:-1], residuals[1:]
    return float((before * after).sum() / (before * before).sum())
