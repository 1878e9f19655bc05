"""Population of rigs of one type: shared parameters and causes, and the prior for another rig."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from heli_sim.model.effects import catalogue, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.errors import PoolError
from heli_lab.pool.random_effects import RandomEffects, Share, der_simonian_laird, share
from heli_lab.pool.rig_diagnosis import MIN_CAUSE_CONFIDENCE, ParameterEstimate, RigDiagnosis

PRIOR_SPREAD: Final = 0.5
"""Prior standard deviation between rigs of one type, over that of the rig file; it counts as one rig. Set by
judgement: a file's tolerance also covers wrong estimates. A smaller value predicts that the second rig
equals the first, with a larger one a single rig has no influence."""
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
        """Predict a parameter of another rig of this type.

        Parameters
        ----------
        name : str
            The parameter.
        prior : ParameterEstimate
            Its value in the rig file.
        spread : float
            Prior standard deviation between rigs.

        Returns
        -------
        tuple of (float, float)
            Mean and standard deviation, in the parameter's unit.
        """
        measured = [
            diagnosis.parameters[name] for diagnosis in self.diagnoses if name in diagnosis.parameters
        ]
        if not measured:
            return prior.value, prior.std
        k = len(measured)
        tau2 = ((k - 1) * self.parameters[name].tau ** 2 + spread**2) / k
        weights = [1.0 / (estimate.std**2 + tau2) for estimate in measured]
        total = sum(weights)
        mean = sum(w * estimate.value for w, estimate in zip(weights, measured, strict=True)) / total
        # The rig file is one more estimate of the mean.
        precision = total + prior.std**-2.0
        centre = (mean * total + prior.value * prior.std**-2.0) / precision
        return centre, (tau2 + 1.0 / precision) ** 0.5

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
        for quantity, known in base.numbers.items():
            if quantity not in self.parameters or known.tolerance == 0.0:
                continue
            before = ParameterEstimate(known.value, 0.5 * known.tolerance, known.unit)
            value, std = self.predict_parameter(quantity, before, PRIOR_SPREAD * before.std)
            text = f"{source}; before: {known.value:g} +- {known.tolerance:g}"
            numbers[quantity] = replace(known, value=value, tolerance=2.0 * std, source=text)
        effects: dict[str, Mapping[str, Number]] = dict(base.effects)
        kinds = catalogue()
        for id_, cause_share in self.causes.items():
            kind = kinds.get(id_)
            if kind is None or kind.baseline or cause_share.share < MIN_COMMON_SHARE:
                continue
            names = [quantity.name for quantity in kind.parameters if quantity.name in self.parameters]
            priors = {
                n: diagnosis.priors[n] for diagnosis in self.diagnoses for n in names if n in diagnosis.priors
            }
            predictions = {
                n: self.predict_parameter(n, priors[n], _EFFECT_PRIOR_SPREAD * abs(self.parameters[n].mean))
                for n in names
            }
            bounds = kind.priors
            effects[id_] = effect_numbers(
                kind,
                {n: min(max(value, bounds[n].low), bounds[n].high) for n, (value, _) in predictions.items()},
                {n: 2.0 * std for n, (_, std) in predictions.items()},
                source,
            )
        text = f"{base.name}, pooled from {len(self.diagnoses)} rigs of this type"
        return Rig(name, text, numbers, effects, base.model or self.diagnoses[0].model)


def pool(diagnoses: Sequence[RigDiagnosis]) -> RigPopulation:
    """Pool the diagnoses of several rigs of one type.

    Raises
    ------
    PoolError
        When there is no diagnosis, two have the same label or content, or their rig files or models differ.
    """
    if not diagnoses:
        raise PoolError("there is no diagnosis to pool", "give one diagnosis per rig")
    labels = [diagnosis.label for diagnosis in diagnoses]
    twice = sorted({label for label in labels if labels.count(label) > 1})
    if twice:
        raise PoolError(f"two diagnoses have the name {', '.join(twice)}", "rename their files")
    for first, other in itertools.combinations(diagnoses, 2):
        if replace(first, label=other.label) == other:
            raise PoolError(
                f"{first.label} and {other.label} are the same diagnosis", "give one diagnosis per rig"
            )
    known = {(diagnosis.rig, diagnosis.model) for diagnosis in diagnoses}
    if len(known) > 1:
        list_ = "; ".join(
            f"{diagnosis.label}: rig {diagnosis.rig}, model {diagnosis.model}" for diagnosis in diagnoses
        )
        raise PoolError(
            f"the rigs are not of one type: {list_}", "diagnose all rigs with the same --rig and --model"
        )
    names = dict.fromkeys(name for diagnosis in diagnoses for name in diagnosis.parameters)
    parameters = {}
    for name in names:
        measured = [diagnosis.parameters[name] for diagnosis in diagnoses if name in diagnosis.parameters]
        parameters[name] = der_simonian_laird(
            [estimate.value for estimate in measured], [estimate.std for estimate in measured]
        )
    causes = {}
    for id_ in dict.fromkeys(id_ for diagnosis in diagnoses for id_ in diagnosis.causes):
        present = [
            diagnosis for diagnosis in diagnoses if diagnosis.causes.get(id_, 0.0) >= MIN_CAUSE_CONFIDENCE
        ]
        detectable = [
            diagnosis for diagnosis in diagnoses if diagnosis in present or id_ not in diagnosis.undetectable
        ]
        if detectable:
            causes[id_] = share(len(present), len(detectable))
    ordered = dict(sorted(causes.items(), key=lambda item: -item[1].share))
    return RigPopulation(tuple(diagnoses), parameters, ordered)
