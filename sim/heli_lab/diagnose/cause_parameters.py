"""The parameters of a cause as the final fit has them, with standard errors."""

from __future__ import annotations

import math
from dataclasses import dataclass

from heli_sim.model.effects import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose.candidate import Candidate
from heli_lab.diagnose.thresholds import LEAST_COUNTS, LEAST_STD_SHARE, WITHIN_STEP_STD
from heli_lab.identify import Fit


@dataclass(frozen=True)
class CauseParameter:
    """An estimated parameter of a cause.

    Parameters
    ----------
    value, std : float
        Estimate and standard error, in `unit`.
    unit : str
        SI unit; ``1`` where the parameter has none.
    """

    value: float
    std: float
    unit: str


def cause_parameters(candidate: Candidate, kind: EffectKind, fit: Fit) -> dict[str, CauseParameter]:
    """Parameters of a candidate by full name, as the final `fit` has them.

    Parameters
    ----------
    candidate : Candidate
        The effect in the final model; a parameter that was not fitted keeps its value there.
    kind : EffectKind
        Its entry in the catalogue.
    """
    std = reported_std(fit, kind)
    return {
        quantity.name: CauseParameter(
            fit.values.get(quantity.name, candidate.effect.values[quantity.name]),
            std.get(quantity.name, 0.0),
            quantity.unit,
        )
        for quantity in kind.parameters
    }


def reported_std(fit: Fit, kind: EffectKind) -> dict[str, float]:
    """Standard errors by name of the numbers of a `kind`, none finer than what flights resolve.

    Voltages are held over a sample: a time constant or a delay is uncertain by a part of it, whichever way
    board and simulator count it, and of what a controller answers within a step. What acts within a step is
    blurred, so no size is finer than a share of itself; and what lies between an axis and its encoder is
    shown in whole counts.
    """
    record = fit.problem.records[0]
    part, _, axis = kind.acts_on.partition(".")
    errors = {}
    for parameter in fit.problem.free:
        least = 0.0
        if parameter.unit == "s":
            least = 0.5 * record.step_s
        elif parameter.unit == "rad" and part == "measurement" and axis in AXES:
            least = LEAST_COUNTS * float(record.count_rad[AXES.index(axis)])
        std = fit.std[parameter.name] * (WITHIN_STEP_STD if parameter.unit == "s" else 1.0)
        blurred = LEAST_STD_SHARE * fit.values[parameter.name] if parameter.name in kind.size else 0.0
        errors[parameter.name] = math.hypot(std, least, blurred)
    return errors
