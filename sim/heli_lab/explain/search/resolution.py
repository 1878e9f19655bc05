"""Standard errors of an effect's parameters that are not smaller than the resolution of the flights."""

from __future__ import annotations

import math
from collections.abc import Mapping

from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.parts import AXES

from heli_lab.explain import thresholds
from heli_lab.fit.records import Record


def limited_std(
    kind: EffectSpec, values: Mapping[str, float], std: Mapping[str, float], record: Record
) -> dict[str, float]:
    """Return standard errors that are not smaller than the resolution of the flights.

    Three limits apply. A time constant or delay is uncertain by a part of a sample, because voltages are held
    over a sample. A size is uncertain by a share of itself, because the model averages over its steps. An
    effect between an axis and its encoder is uncertain by a part of a count.
    """
    channel, _, axis = kind.acts_on.partition(".")
    std_by_name = {}
    for parameter in kind.parameters:
        if parameter.name not in std:
            continue
        parameter_std, resolution = std[parameter.name], 0.0
        if parameter.unit == "s":
            parameter_std = time_std_s(parameter_std, record.step_s)
        elif parameter.unit == "rad" and channel == "measurement" and axis in AXES:
            resolution = thresholds.MIN_STD_COUNTS * float(record.count_rad[AXES.index(axis)])
        size_error = thresholds.MIN_STD_SHARE * values[parameter.name] if parameter.name in kind.size else 0.0
        std_by_name[parameter.name] = math.hypot(parameter_std, resolution, size_error)
    return std_by_name


def time_std_s(std_s: float, step_s: float) -> float:
    """Return the standard error of a time constant or delay that the flights support [s].

    Voltages are held over a step, so a time is uncertain by a part of it, and by what a controller answers
    within it.
    """
    return math.hypot(thresholds.TIME_STD_FACTOR * std_s, 0.5 * step_s)
