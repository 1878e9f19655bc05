"""The extended rig: refitted parameters, and the causes with their sizes, as a rig file that flies."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from heli_sim.model.effects import EffectSpec, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.explain.discover.proposal import ProposedTerm
from heli_lab.explain.evaluate.reported import CauseParameter
from heli_lab.fit.identification import Identification
from heli_lab.fit.problem import PER_FLIGHT, Fit


def extended_rig(
    name: str,
    fit: Fit,
    kinds: Mapping[str, EffectSpec],
    causes: Mapping[str, Mapping[str, CauseParameter]],
    term: ProposedTerm | None,
) -> Rig:
    """Make a rig of fitted parameters and effects."""
    # The other fields of an identification are for its report.
    rig = Identification(fit, (), (), (), ()).rig(name)
    labels = ", ".join(record.label for record in fit.problem.records)
    source = f"found by heli-host diagnose from {labels}"
    effects: dict[str, Mapping[str, Number]] = dict(rig.effects)
    for id_, numbers in causes.items():
        effects[id_] = effect_numbers(
            kinds[id_],
            {parameter: number.value for parameter, number in numbers.items()},
            # A tolerance in a rig file is two standard deviations.
            {parameter: 2.0 * number.std for parameter, number in numbers.items()},
            source,
        )
    if term is not None:
        effects[term.discovery.effect.name] = {
            parameter: Number(value, unit, 2.0 * std, source)
            for parameter, (value, std, unit) in term.discovery.values.items()
        }
    return Rig(rig.name, rig.description, {**rig.numbers, **_mean_zeros(fit)}, effects, rig.model)


def _mean_zeros(fit: Fit) -> dict[str, Number]:
    """Return the means of the encoder zeros of several flights, by name; empty for a single flight, whose
    zeros the rig has.

    Zeros and constant torques of a flight compensate each other, so the mean of the torques predicts worse
    without the mean of the zeros. The tolerance is at least that of the rig file, because encoders are zeroed
    again before the next flight.
    """
    problem, zeros = fit.problem, dict[str, list[float]]()
    if len(problem.records) == 1:
        return {}
    for parameter, value in zip(problem.free, fit.theta, strict=True):
        if parameter.quantity in PER_FLIGHT:
            zeros.setdefault(parameter.quantity, []).append(float(value))
    labels = ", ".join(record.label for record in problem.records)
    numbers = {}
    for name, values in zeros.items():
        before = problem.rig[name]
        tolerance = max(before.tolerance, 2.0 * float(np.std(values, ddof=1)))
        source = f"mean of {labels}; before: {before.value:g} +- {before.tolerance:g}"
        numbers[name] = Number(float(np.mean(values)), before.unit, tolerance, source)
    return numbers
