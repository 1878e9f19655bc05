"""The extended rig: refitted parameters, and the causes with their sizes, as a rig file that flies."""

from __future__ import annotations

import math
from collections.abc import Mapping

from heli_sim.model.effects import EffectKind, effect_numbers
from heli_sim.model.parts import AXES
from heli_sim.rig import Number, Rig

from heli_lab.diagnose.discover import ProposedTerm
from heli_lab.diagnose.thresholds import MIN_STD_COUNTS, MIN_STD_SHARE, TIME_STD_FACTOR
from heli_lab.identify import Fit
from heli_lab.identify.result import Identification

Values = Mapping[str, tuple[float, float, str]]
"""Parameters of an effect by full name: value, standard error and unit."""


def extended_rig(
    name: str,
    fit: Fit,
    kinds: Mapping[str, EffectKind],
    causes: Mapping[str, Values],
    term: ProposedTerm | None,
) -> Rig:
    """Make a rig of fitted parameters and effects.

    Parameters
    ----------
    name : str
        Name of the rig.
    fit : Fit
        The model with the effects on the fitted flights.
    causes : Mapping[str, Values]
        Parameters of each effect, by effect id.
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
            {key: value for key, (value, _, _) in numbers.items()},
            # A tolerance in a rig file is two standard deviations.
            {key: 2.0 * std for key, (_, std, _) in numbers.items()},
            source,
        )
    if term is not None:
        effects[term.discovery.effect.name] = {
            what: Number(value, unit, 2.0 * error, source)
            for what, (value, error, unit) in term.discovery.values.items()
        }
    return Rig(rig.name, rig.description, rig.numbers, effects, rig.model)


def effect_values(fit: Fit, kind: EffectKind, start: Mapping[str, float]) -> Values:
    """Parameters of an effect as they are reported.

    Parameters
    ----------
    fit : Fit
        The model with the effect.
    start : Mapping[str, float]
        Values of parameters that were not estimated, by full name.
    """
    std = reported_std(fit, kind)
    return {
        q.name: (fit.values.get(q.name, start[q.name]), std.get(q.name, 0.0), q.unit) for q in kind.parameters
    }


def reported_std(fit: Fit, kind: EffectKind) -> dict[str, float]:
    """Compute standard errors that are not finer than what flights resolve.

    Voltages are held over a sample, so a time constant or delay is uncertain by a part of a sample, and by
    what a controller answers within a step. Steps blur what acts within them, so a size is uncertain by a
    share of itself. What lies between an axis and its encoder is seen in whole counts only.

    Parameters
    ----------
    fit : Fit
        Estimates with standard errors.
    kind : EffectKind
        The effect; it determines which parameters are sizes, and on what they act.

    Returns
    -------
    dict
        Standard error by parameter name.
    """
    record = fit.problem.records[0]
    part, _, axis = kind.acts_on.partition(".")
    errors = {}
    for parameter in fit.problem.free:
        least = 0.0
        if parameter.unit == "s":
            least = 0.5 * record.step_s
        elif parameter.unit == "rad" and part == "measurement" and axis in AXES:
            least = MIN_STD_COUNTS * float(record.count_rad[AXES.index(axis)])
        std = fit.std[parameter.name] * (TIME_STD_FACTOR if parameter.unit == "s" else 1.0)
        blurred = MIN_STD_SHARE * fit.values[parameter.name] if parameter.name in kind.size else 0.0
        errors[parameter.name] = math.hypot(std, least, blurred)
    return errors
