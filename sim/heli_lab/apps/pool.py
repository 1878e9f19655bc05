"""Combine diagnoses of several rigs of one type and estimate how their parameters vary.

The parameter of a rig is the mean of the rig type plus a random deviation of variance tau^2. Each rig has an
estimate of its parameter with a standard error, without the prior of the rig file. The method of moments of
DerSimonian and Laird (Controlled Clinical Trials 7, 1986, 177) estimates tau^2 from the scatter of the rigs
in excess of these standard errors.

A test compares the result with that of statsmodels. That package is not a dependency here, because it lacks
the prediction interval and takes a second to import.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_sim.model.effects import EffectSpec, catalogue, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.errors import PoolError

__all__ = [
    "RandomEffects",
    "RigDiagnosis",
    "RigPopulation",
    "Share",
    "der_simonian_laird",
    "pool",
    "read_rig_diagnosis",
    "share",
]


MIN_CAUSE_CONFIDENCE: Final = 0.9
"""Confidence from which on a cause counts as present, 0 to 1; a rig with less is undecided. By definition, at
least nine of ten such causes are right. A lower value counts causes that no rig has, a higher one leaves rigs
undecided that have the cause."""
_MIN_INFORMATION_SHARE: Final = 0.05
"""Smallest precision from the flights over the prior's precision for which a parameter of a rig is used.
Below it, the estimate without the prior is a difference of nearly equal numbers."""


@dataclass(frozen=True)
class ParameterEstimate:
    """Estimate or prior of one parameter of a rig."""

    value: float  # value, std: Value and standard error, in `unit`
    std: float
    unit: str  # Unit as in rig files


@dataclass(frozen=True)
class RigDiagnosis:
    """Diagnosis of one rig: parameter estimates and causes of model errors.

    Parameters
    ----------
    label : str
        Name of the rig in messages.
    rig, model : str
        Names of the rig file that gave the prior, and of the model.
    parameters : Mapping of str to ParameterEstimate
        Estimates from the flights alone, of each parameter about which they are informative.
    priors : Mapping of str to ParameterEstimate
        Prior of each parameter.
    causes : Mapping of str to float
        Diagnosed effects with their confidence, 0 to 1.
    undetectable : tuple of str
        Effects that the flights could not show.
    is_explained : bool
        Whether the model with the causes explains the flights. Otherwise the parameters may be biased.
    """

    label: str
    rig: str
    model: str
    parameters: Mapping[str, ParameterEstimate]
    priors: Mapping[str, ParameterEstimate]
    causes: Mapping[str, float]
    undetectable: tuple[str, ...]
    is_explained: bool


def read_rig_diagnosis(path: Path) -> RigDiagnosis:
    """Read the JSON file that ``heli-host diagnose --json`` wrote to `path`.

    Raises
    ------
    PoolError
        When the file cannot be read, or is not a diagnosis with parameters of a rig.
    """
    remedy = "give files of heli-host diagnose --json"
    try:
        return _rig_diagnosis_of_json(path, json.loads(path.read_bytes()))
    except OSError as error:
        raise PoolError(f"{path}: {error.strerror}", remedy) from None
    except (json.JSONDecodeError, UnicodeDecodeError):
        raise PoolError(f"{path} is not JSON", remedy) from None
    except (KeyError, TypeError, AttributeError, ValueError):
        raise PoolError(
            f"{path} is not a diagnosis with parameters of a rig",
            "give files that this version of heli-host diagnose --json wrote for flights in the air",
        ) from None


def _rig_diagnosis_of_json(path: Path, content: Mapping[str, Any]) -> RigDiagnosis:
    """Convert the `content` of the file at `path`; invalid content raises one of Python's errors."""
    parameters, priors, rig = {}, {}, content["rig"]
    for name, entry in rig["numbers"].items():
        prior_value, prior_std = float(entry["prior"]["value"]), float(entry["prior"]["std"])
        priors[name] = prior = ParameterEstimate(prior_value, prior_std, str(entry["unit"]))
        from_flights = without_prior(float(entry["value"]), float(entry["std"]), prior)
        if from_flights is not None:
            parameters[name] = from_flights
    return RigDiagnosis(
        label=path.stem,
        rig=str(rig["name"]),
        model=str(rig["model"]),
        parameters=parameters,
        priors=priors,
        causes={str(cause["effect"]): float(cause["confidence"]) for cause in content["causes"]},
        undetectable=tuple(map(str, content["undetectable"])),
        is_explained=content["verdict"] != "unexplained",
    )


def without_prior(value: float, std: float, prior: ParameterEstimate) -> ParameterEstimate | None:
    """Remove the prior from an estimate, because all rigs of a type share this prior."""
    # The posterior density is the product of the prior and the marginal likelihood of the flights. For normal
    # densities, the precision of the flights is the posterior precision minus the prior precision.
    posterior_precision, prior_precision = std**-2.0, prior.std**-2.0
    precision = posterior_precision - prior_precision
    if precision < _MIN_INFORMATION_SHARE * prior_precision:
        return None
    value_from_flights = (value * posterior_precision - prior.value * prior_precision) / precision
    return ParameterEstimate(value_from_flights, precision**-0.5, prior.unit)


CONFIDENCE: Final = 0.95
"""Coverage of all intervals."""


@dataclass(frozen=True)
class RandomEffects:
    """Mean of a parameter over a rig type, and its variation between rigs; all in the parameter's unit.

    Parameters
    ----------
    mean, std : float
        Mean over the rig type and its standard error.
    tau : float
        Standard deviation between rigs; 0 if they scatter no more than their standard errors.
    q : float
        Cochran's Q: sum of squared deviations in standard errors; about k - 1 for k rigs if tau is 0.
    i2 : float
        Share of the scatter that is due to differences between rigs, 0 to 1.
    interval : (float, float)
        95 % confidence interval of the mean by Student's t, never narrower than the standard errors allow
        (Hartung and Knapp, Statistics in Medicine 20, 2001, 3875).
    prediction : (float, float) or None
        95 % prediction interval for another rig (Higgins, Thompson and Spiegelhalter, J. R. Statist. Soc. A
        172, 2009, 137); None for fewer than three rigs.
    machines : int
        Number of rigs.
    """

    mean: float
    std: float
    tau: float
    q: float
    i2: float
    interval: tuple[float, float]
    prediction: tuple[float, float] | None
    machines: int


def der_simonian_laird(values: Sequence[float], stds: Sequence[float]) -> RandomEffects:
    """Estimate mean and variation of one parameter over a rig type, by the method of moments.

    Parameters
    ----------
    values, stds : sequence of float
        Estimate of each rig and its standard error, above 0, all in the same unit.
    """
    from scipy.stats import norm, t

    estimates, variances = np.array(values, float), np.array(stds, float) ** 2
    rig_count, fixed_weights = len(estimates), 1.0 / variances
    fixed_effect_mean = float(fixed_weights @ estimates / fixed_weights.sum())
    q = float(fixed_weights @ (estimates - fixed_effect_mean) ** 2)
    # The expectation of Q is rig_count - 1 + tau^2 times this factor.
    factor = float(fixed_weights.sum() - fixed_weights @ fixed_weights / fixed_weights.sum())
    tau2 = max(0.0, (q - (rig_count - 1)) / factor) if rig_count > 1 else 0.0
    weights = 1.0 / (variances + tau2)
    mean, std = float(weights @ estimates / weights.sum()), float(weights.sum() ** -0.5)
    probability = 0.5 + CONFIDENCE / 2.0  # of the upper end of a two-sided interval
    quantile = float(norm.ppf(probability))
    if rig_count > 1:
        # tau is an estimate too: with the normal quantile, the interval covers the mean of twelve rigs in 89
        # % of cases only. The correction of Hartung and Knapp makes it wider: Student's t, times the scatter
        # of the rigs in units of the one that the weights predict. A factor below 1 would make it narrower
        # whenever few rigs agree by chance.
        relative_variance = float(weights @ (estimates - mean) ** 2) / (rig_count - 1)
        quantile = float(t.ppf(probability, rig_count - 1)) * max(1.0, relative_variance**0.5)
    half_width = quantile * std
    prediction = None
    if rig_count > 2:  # Student's t has rig_count - 2 degrees of freedom
        prediction_half_width = float(t.ppf(probability, rig_count - 2)) * (tau2 + std**2) ** 0.5
        prediction = (mean - prediction_half_width, mean + prediction_half_width)
    return RandomEffects(
        mean=mean,
        std=std,
        tau=tau2**0.5,
        q=q,
        i2=max(0.0, 1.0 - (rig_count - 1) / q) if q > 0.0 else 0.0,
        interval=(mean - half_width, mean + half_width),
        prediction=prediction,
        machines=rig_count,
    )


@dataclass(frozen=True)
class Share:
    """Share of rigs of a type that have a cause.

    Parameters
    ----------
    present, detectable : int
        Number of rigs with the cause, and of all decided rigs whose flights could show it.
    undecided : int
        Number of further rigs on which the cause was named with a confidence below `MIN_CAUSE_CONFIDENCE`.
    share : float
        Ratio of `present` to `detectable`; 0 if no rig is decided.
    interval : (float, float)
        Exact 95 % confidence interval of the share among all rigs of the type (Clopper and Pearson,
        Biometrika 26, 1934, 404).
    """

    present: int
    detectable: int
    undecided: int
    share: float
    interval: tuple[float, float]


def share(present: int, detectable: int, undecided: int = 0) -> Share:
    """Estimate the share of rigs with a cause: `present` of `detectable` rigs have it, and `undecided` others
    are not counted.
    """
    from scipy.stats import binomtest

    if not detectable:
        return Share(0, 0, undecided, 0.0, (0.0, 1.0))
    interval = binomtest(present, detectable).proportion_ci(CONFIDENCE, method="exact")
    low_high = (float(interval.low), float(interval.high))
    return Share(present, detectable, undecided, present / detectable, low_high)


PRIOR_SPREAD: Final = 0.5
"""Prior standard deviation between rigs of one type, as a share of the rig file's standard deviation; it
counts as one rig. Set by judgement: a file's tolerance also covers wrong estimates. With a smaller value,
the second rig is predicted to equal the first; with a larger one, a single rig has no influence."""
_EFFECT_PRIOR_SPREAD: Final = 0.3
"""The same for an effect's parameter, over its pooled value: catalogue priors cover all rig types."""
MIN_COMMON_SHARE: Final = 0.5
"""Share of rigs from which on an effect belongs to the rig type, so that the prior contains it."""


@dataclass(frozen=True)
class RigPopulation:
    """Pooled diagnoses of rigs of one type.

    Parameters
    ----------
    diagnoses : tuple of RigDiagnosis
        One per rig.
    parameters : Mapping of str to RandomEffects
        Each parameter of the rig and of effects about which flights are informative.
    causes : Mapping of str to Share
        Share of rigs with each cause, among those whose flights decide on it; the most frequent first.
    """

    diagnoses: tuple[RigDiagnosis, ...]
    parameters: Mapping[str, RandomEffects]
    causes: Mapping[str, Share]

    @property
    def cautions(self) -> tuple[str, ...]:
        """Reasons why the result is less reliable, a sentence each."""
        unexplained = [diagnosis.label for diagnosis in self.diagnoses if not diagnosis.is_explained]
        if not unexplained:
            return ()
        return (f"unexplained, so their parameters may be biased: {', '.join(unexplained)}",)

    def predict_parameter(self, name: str, prior: ParameterEstimate, spread: float) -> tuple[float, float]:
        """Predict a parameter of another rig of this type, by the random-effects model.

        Parameters
        ----------
        name : str
            The parameter.
        prior : ParameterEstimate
            Its value in the rig file.
        spread : float
            Prior standard deviation between rigs, in the parameter's unit; it counts as one rig.

        Returns
        -------
        value : float
            Prediction, in the parameter's unit.
        std : float
            Its standard deviation.
        """
        estimates = _estimates_of_parameter(self.diagnoses, name)
        if not estimates:
            return prior.value, prior.std
        count = len(estimates)
        variance_between_rigs = ((count - 1) * self.parameters[name].tau ** 2 + spread**2) / count
        weights = [1.0 / (estimate.std**2 + variance_between_rigs) for estimate in estimates]
        weight = sum(weights)
        mean = sum(w * estimate.value for w, estimate in zip(weights, estimates, strict=True)) / weight
        # The rig file is one more estimate of the mean.
        prior_weight = prior.std**-2.0
        value = (mean * weight + prior.value * prior_weight) / (weight + prior_weight)
        variance_of_mean = 1.0 / (weight + prior_weight)
        return value, (variance_between_rigs + variance_of_mean) ** 0.5

    def prior_rig(self, base: Rig, name: str) -> Rig:
        """Return a rig whose parameters and tolerances are the prior for another rig of this type.

        Parameters
        ----------
        base : Rig
            Rig file of the diagnoses. Parameters about which no flight is informative keep its values.
        name : str
            Name of the new rig in its file and in messages.
        """
        source = f"pooled from {', '.join(diagnosis.label for diagnosis in self.diagnoses)}"
        numbers = dict(base.numbers)
        for quantity, base_number in base.numbers.items():
            if quantity not in self.parameters or base_number.tolerance == 0.0:
                continue  # not estimated, or exact by the rig file
            prior = ParameterEstimate(base_number.value, 0.5 * base_number.tolerance, base_number.unit)
            value, std = self.predict_parameter(quantity, prior, PRIOR_SPREAD * prior.std)
            text = f"{source}; before: {base_number.value:g} +- {base_number.tolerance:g}"
            numbers[quantity] = replace(base_number, value=value, tolerance=2.0 * std, source=text)
        effects: dict[str, Mapping[str, Number]] = dict(base.effects)
        kinds = catalogue()
        for id_, cause_share in self.causes.items():
            kind = kinds.get(id_)
            if kind is not None and not kind.baseline and cause_share.share >= MIN_COMMON_SHARE:
                effects[id_] = self._prior_effect(kind, source)
        text = f"{base.name}, pooled from {len(self.diagnoses)} rigs of this type"
        return Rig(name, text, numbers, effects, base.model or self.diagnoses[0].model)

    def _prior_effect(self, kind: EffectSpec, source: str) -> Mapping[str, Number]:
        """Predict the parameters of an effect for another rig, within their bounds."""
        values, tolerances = {}, {}
        for name in (quantity.name for quantity in kind.parameters if quantity.name in self.parameters):
            # All diagnoses have the catalogue's prior.
            priors = [diagnosis.priors[name] for diagnosis in self.diagnoses if name in diagnosis.priors]
            spread = _EFFECT_PRIOR_SPREAD * abs(self.parameters[name].mean)
            value, std = self.predict_parameter(name, priors[-1], spread)
            values[name] = min(max(value, kind.priors[name].low), kind.priors[name].high)
            tolerances[name] = 2.0 * std
        return effect_numbers(kind, values, tolerances, source)


def pool(diagnoses: Sequence[RigDiagnosis]) -> RigPopulation:
    """Pool the diagnoses of several rigs of one type.

    Each parameter gets a mean and a variation between rigs, each cause the share of rigs that have it.

    Parameters
    ----------
    diagnoses : sequence of RigDiagnosis
        One per rig.

    Raises
    ------
    PoolError
        When there is no diagnosis, two have the same label or content, or their rig files or models differ.
    """
    _check_diagnoses(diagnoses)
    parameters = {}
    for name in dict.fromkeys(name for diagnosis in diagnoses for name in diagnosis.parameters):
        estimates = _estimates_of_parameter(diagnoses, name)
        values, stds = [each.value for each in estimates], [each.std for each in estimates]
        parameters[name] = der_simonian_laird(values, stds)
    causes = {}
    for id_ in dict.fromkeys(id_ for diagnosis in diagnoses for id_ in diagnosis.causes):
        confidences = [diagnosis.causes[id_] for diagnosis in diagnoses if id_ in diagnosis.causes]
        present_count = sum(confidence >= MIN_CAUSE_CONFIDENCE for confidence in confidences)
        absent_count = sum(
            id_ not in diagnosis.causes and id_ not in diagnosis.undetectable for diagnosis in diagnoses
        )
        causes[id_] = share(
            present_count, present_count + absent_count, undecided=len(confidences) - present_count
        )
    ordered = dict(sorted(causes.items(), key=lambda item: -item[1].share))
    return RigPopulation(tuple(diagnoses), parameters, ordered)


def _estimates_of_parameter(diagnoses: Sequence[RigDiagnosis], name: str) -> list[ParameterEstimate]:
    """List the estimates of the parameter `name`, one for each rig whose flights are informative about it."""
    return [diagnosis.parameters[name] for diagnosis in diagnoses if name in diagnosis.parameters]


def _check_diagnoses(diagnoses: Sequence[RigDiagnosis]) -> None:
    """Raise a PoolError unless the diagnoses are of different rigs of one type."""
    if not diagnoses:
        raise PoolError("there is no diagnosis to pool", "give one diagnosis per rig")
    labels = [diagnosis.label for diagnosis in diagnoses]
    repeated = sorted({label for label in labels if labels.count(label) > 1})
    if repeated:
        raise PoolError(f"two diagnoses have the name {', '.join(repeated)}", "rename their files")
    for first, other in itertools.combinations(diagnoses, 2):
        if replace(first, label=other.label) == other:
            raise PoolError(
                f"{first.label} and {other.label} are the same diagnosis", "give one diagnosis per rig"
            )
    types = {(diagnosis.rig, diagnosis.model) for diagnosis in diagnoses}
    if len(types) > 1:
        rigs = "; ".join(f"{each.label}: rig {each.rig}, model {each.model}" for each in diagnoses)
        raise PoolError(
            f"the rigs are not of one type: {rigs}", "diagnose all rigs with the same --rig and --model"
        )
