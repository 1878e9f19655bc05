"""Combine the diagnoses of several rigs of one type into a population, and into the prior for another rig."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from heli_sim.model.effects import EffectSpec, catalogue, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.apps.pool.random_effects import RandomEffects, Share, der_simonian_laird, share
from heli_lab.apps.pool.rig_diagnosis import MIN_CAUSE_CONFIDENCE, ParameterEstimate, RigDiagnosis
from heli_lab.errors import PoolError

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
        Share of rigs with each cause, among those whose flights could show it; the most frequent first.
    """

    diagnoses: tuple[RigDiagnosis, ...]
    parameters: Mapping[str, RandomEffects]
    causes: Mapping[str, Share]

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
        k = len(estimates)
        variance_between_rigs = ((k - 1) * self.parameters[name].tau ** 2 + spread**2) / k
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
                continue
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
        has_cause = [diagnosis.causes.get(id_, 0.0) >= MIN_CAUSE_CONFIDENCE for diagnosis in diagnoses]
        detectable_count = sum(
            is_present or id_ not in diagnosis.undetectable
            for is_present, diagnosis in zip(has_cause, diagnoses, strict=True)
        )
        if detectable_count:
            causes[id_] = share(sum(has_cause), detectable_count)
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
