"""Candidate terms for methods that regress accelerations: what each cause adds to the nominal model.

Accelerations come from measured angles by a smoothing filter; the model and all terms pass the same filter. A
term is the derivative of the model's accelerations by the size of a cause, from the catalogue of `heli_sim`.
Causes in an encoder or with a state of their own have no such term. The lag and the delay of the thrust have
one: the derivative of the voltages.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.model.parts import AXES

from heli_benchmark.methods.motion import AccelerationModel, SmoothedFlight
from heli_benchmark.task import UNLISTED, BenchmarkCase, Estimate

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
    axis, shape : str
        Axis and shape of the torque of an unlisted cause; its coefficient is in N m.
    """

    cause: str
    parameters: tuple[str, ...]
    columns: Floats
    axis: str = ""
    shape: str = ""


@dataclass(frozen=True)
class Standardisation:
    """Scales of residuals and features.

    Parameters
    ----------
    residual_std : ndarray (3,)
        Standard deviations of the residuals by axis, rad/s2.
    feature_mean, feature_std : ndarray (8,)
        Means and standard deviations of the features.
    """

    residual_std: Floats
    feature_mean: Floats
    feature_std: Floats


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
    standardisation : Standardisation
        How `residuals` and `features` were scaled.
    """

    target: Floats
    nuisance: Floats
    terms: list[Term]
    residuals: Floats
    features: Floats
    rig_priors: Mapping[str, Estimate]
    standardisation: Standardisation

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
    smooth = [SmoothedFlight(flight, weak_form) for flight in case.training]
    plain = AccelerationModel(MultibodyModel(), rig)
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

    terms = [replace(term, columns=white(term.columns)) for term in drafts]
    useful = [term for term in terms if np.isfinite(term.columns).all() and term.columns.std() > 1e-9]
    listed = [term for term in useful if term.parameters]
    useful = listed + [term for term in useful if not term.parameters and not _is_listed(term, listed)]
    features = np.concatenate([motion.features for motion in smooth])
    scales = Standardisation(fitted.std(axis=0), features.mean(axis=0), features.std(axis=0))
    features = (features - scales.feature_mean) / scales.feature_std
    priors = {name: Estimate(rig[name].value, 0.5 * rig[name].tolerance) for name in nuisance_names}
    residuals = fitted / scales.residual_std
    return ResidualRegression(white(target), white(nuisance), useful, residuals, features, priors, scales)


def _listed(case: BenchmarkCase, smooth: Sequence[SmoothedFlight]) -> list[Term]:
    """Terms of the causes of the catalogue that act as forces without a state of their own."""
    kinds = catalogue()
    drafts: list[Term] = []
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
        of = AccelerationModel(MultibodyModel((spec.make(),)), case.rig)
        for place in places:
            columns = [motion.filtered(of.jacobian(motion, sizes, place)) for motion in smooth]
            drafts.append(Term(cause, sizes, _stack(columns)))
    return drafts


def _late(case: BenchmarkCase, smooth: Sequence[SmoothedFlight], plain: AccelerationModel) -> list[Term]:
    """Terms of a lag or a delay: thrust is late by a time that multiplies the voltages' derivative."""
    late = [
        motion.filtered(-np.einsum("nij,nj->ni", plain.by_volts(motion), motion.volt_rates_V_s)[:, :, None])
        for motion in smooth
    ]
    return [
        Term(cause, (name,), _stack(late)) for cause, name in _LATE.items() if cause in case.causes.listed
    ]


def _generic(smooth: Sequence[SmoothedFlight], plain: AccelerationModel) -> list[Term]:
    """Torques that are products of angles and rates: what an unlisted cause may look like."""
    terms: list[Term] = []
    pushes, shapes = [plain.by_torques(motion) for motion in smooth], [shapes_of(motion) for motion in smooth]
    for i, axis in enumerate(AXES):
        for shape in shapes[0]:
            columns = [
                motion.filtered(push[:, :, [i]] * of[shape][:, None, None])
                for motion, push, of in zip(smooth, pushes, shapes, strict=True)
            ]
            terms.append(Term(UNLISTED, (), _stack(columns), axis, shape))
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
    """Whether a listed cause has the same shape, so that the term says nothing of an unlisted one."""
    column = term.columns[:, 0] / np.linalg.norm(term.columns)
    return any(
        abs(column @ other / np.linalg.norm(other)) > _SAME_SHAPE
        for cause in listed
        for other in cause.columns.T
    )


def _stack(parts: Sequence[Floats]) -> Floats:
    return np.concatenate(parts)


def _fitted(target: Floats, nuisance: Floats) -> Floats:
    solution = np.linalg.lstsq(nuisance, target, rcond=1e-6)[0]
    return np.asarray(target - nuisance @ solution)


def _correlation(residuals: Floats) -> float:
    before, after = residuals[:-1], residuals[1:]
    return float((before * after).sum() / (before * before).sum())
