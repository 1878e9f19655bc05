"""The extended rig: refitted parameters, and the causes with their sizes, as a rig file that flies."""

from __future__ import annotations

from collections.abc import Mapping

from heli_sim.model.effects import EffectSpec, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.diagnose.discover import ProposedTerm
from heli_lab.diagnose.evaluate import CauseParameter
from heli_lab.identify import Fit
from heli_lab.identify.results import Identification


def extended_rig(
    name: str,
    fit: Fit,
    kinds: Mapping[str, EffectSpec],
    causes: Mapping[str, Mapping[str, CauseParameter]],
    term: ProposedTerm | None,
) -> Rig:
    """Make a rig of fitted parameters and effects.

    Parameters
    ----------
    name : str
        Name of the rig.
    fit : Fit
        The model with the effects on the fitted flights.
    causes : Mapping of str to Mapping
        Parameters of each effect by full name, by effect id.
    term : ProposedTerm or None
        An equation to add; it flies together with its effect file.
    """
    rig = Identification(fit, (), (), (), ()).rig(name)
    labels = ", ".join(record.label for record in fit.problem.records)
    source = f"found by heli-host diagnose from {labels}"
    effects: dict[str, Mapping[str, Number]] = dict(rig.effects)
    for id_, numbers in causes.items():
        effects[id_] = effect_numbers(
            kinds[id_],
            {key: number.value for key, number in numbers.items()},
            # A tolerance in a rig file is two standard deviations.
            {key: 2.0 * number.std for key, number in numbers.items()},
            source,
        )
    if term is not None:
        effects[term.discovery.effect.name] = {
            what: Number(value, unit, 2.0 * error, source)
            for what, (value, error, unit) in term.discovery.values.items()
        }
    return Rig(rig.name, rig.description, rig.numbers, effects, rig.model)
