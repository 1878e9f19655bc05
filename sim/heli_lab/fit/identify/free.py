"""Choose the parameters of a model that are estimated from flights, and their priors."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Prior, Rig
from heli_sim.rig.schema import ENCODER_COUNTS, UNSTATED

from heli_lab.errors import IdentifyError
from heli_lab.fit.estimation.parameter_vector import FreeParameter
from heli_lab.fit.estimation.parameter_vector import Prior as AnyPrior
from heli_lab.fit.identify.thresholds import MIN_OF_PRIOR

NOT_FREE: Final = frozenset({"g", *ENCODER_COUNTS})
"""Rig parameters that are never estimated by default, even if they have a tolerance: gravity is known better
than any of the masses, and an encoder has a whole number of counts."""

PER_FLIGHT: Final = ("offset_elevation", "offset_pitch")
"""Parameters that differ from flight to flight, because encoders are zeroed each time the board starts."""

FLIGHT_TORQUES: Final = tuple(f"torque_{axis}" for axis in AXES)
"""Constant torque about each axis during one flight, in which cables lie differently than in others."""

FLIGHT_CONSTANTS: Final = (*PER_FLIGHT, *FLIGHT_TORQUES)
"""All parameters that differ from flight to flight."""


def free_parameters(
    model: Model, rig: Rig, free: Sequence[str] | None, priors: Mapping[str, AnyPrior]
) -> tuple[FreeParameter, ...]:
    """Choose the free parameters of a model, in the order of `free`, or otherwise of the model."""
    known = {quantity.name: quantity for quantity in model.parameters}
    all_priors: dict[str, AnyPrior] = {
        name: prior for effect in model.effects for name, prior in effect.priors.items()
    }
    all_priors |= priors
    if free is None:
        free = [
            name
            for name in known
            if name in all_priors or (name in rig and rig[name].tolerance > 0 and name not in NOT_FREE)
        ]
    parameters = []
    for name in dict.fromkeys(free):
        if name not in known:
            raise _unknown_parameter_error(model, name)
        if name not in all_priors and (name not in rig or rig[name].tolerance == 0):
            raise IdentifyError(
                f"parameter '{name}' has no prior", "give it a tolerance in the rig file, or fix it"
            )
        parameters.append(
            FreeParameter(name, known[name].unit, all_priors.get(name) or rig_prior(rig, name), name)
        )
    return tuple(parameters)


def parameter_values(model: Model, rig: Rig, values: Mapping[str, float]) -> Floats:
    """Return all parameters of a model, shape (p,): those of the rig, some of them replaced by `values`."""
    result = model.parameter_values(rig)
    for name, value in values.items():
        if name not in model.parameter_names:
            raise _unknown_parameter_error(model, name)
        result[model.parameter_names.index(name)] = value
    return result


def estimated_names(model: Model, rig: Rig, free: Sequence[str] | None, fixed: Sequence[str]) -> list[str]:
    """Return the names of the free parameters without the fixed ones."""
    for name in fixed:
        if name not in model.parameter_names:
            raise _unknown_parameter_error(model, name)
        if name in (free or ()):
            raise IdentifyError(f"'{name}' is in both --free and --fix", "leave one of them out")
    names = [
        parameter.quantity
        for parameter in free_parameters(model, rig, free, {})
        if parameter.quantity not in fixed
    ]
    if not names:
        raise IdentifyError("every parameter is fixed", "estimate at least one with --free")
    return names


def flight_constants(model: Model, rig: Rig, about: Mapping[str, float] | None = None) -> dict[str, Prior]:
    """Return the priors of `FLIGHT_CONSTANTS`, the parameters that differ from flight to flight.

    The priors are weak: a few seconds of flight outweigh them. The standard deviation of an encoder zero is
    half its tolerance in the rig file. The standard deviation of a torque is half its tolerance too, where
    cables add a tolerance of their own, `UNSTATED`: 0.05, 0.02 and 0.1 N m about elevation, pitch and travel.
    """
    known = {**{name: rig[name].value for name in FLIGHT_CONSTANTS}, **(about or {})}
    priors = {}
    for name in model.parameter_names:
        if name not in FLIGHT_CONSTANTS:
            continue
        tolerance = rig[name].tolerance
        if name in FLIGHT_TORQUES:
            cable_tolerance = UNSTATED[name].tolerance
            tolerance = cable_tolerance if about is not None else max(tolerance, cable_tolerance)
        if tolerance > 0:
            priors[name] = Prior(known[name], 0.5 * tolerance)
    return priors


def _unknown_parameter_error(model: Model, name: str) -> IdentifyError:
    """Describe the error that a model has no parameter `name`; suggest a similar name."""
    known = model.parameter_names
    close = difflib.get_close_matches(name, known, n=1)
    hint = f"did you mean {close[0]}? " if close else ""
    return IdentifyError(
        f"the model '{model.name}' has no parameter '{name}'", f"{hint}choose from {', '.join(known)}"
    )


def rig_prior(rig: Rig, name: str) -> Prior:
    """Return the prior of the rig parameter `name`: normal, with half the tolerance as standard deviation.

    If the parameter cannot be negative, the prior is bounded slightly above 0, because a length or a gain of
    0 is impossible.
    """
    number = rig[name]
    low = -np.inf if rig.may_be_negative(name) else MIN_OF_PRIOR * abs(number.value)
    return Prior(number.value, 0.5 * number.tolerance, low)
